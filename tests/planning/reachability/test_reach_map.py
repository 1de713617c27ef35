"""The reachability map, on a coarse map of a library robot."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.core.compiled.entries import ENTRIES
from momapos.core.errors import RobotError
from momapos.core.geometry.transforms import invert, pose_planar
from momapos.model.collision.arm_collision import FREE, check_states
from momapos.model.kinematics.chain import chain_arrays
from momapos.model.robots.robot import Robot
from momapos.planning.reachability import construct, map_store
from momapos.planning.reachability.construct import build_map, default_config
from momapos.planning.reachability.grid import oct_decode, turns_of
from momapos.planning.reachability.map_store import (
    ArmLength,
    decode,
    encode,
    evaluate,
    load_reach,
    load_reach_map,
    map_key,
    random_poses,
)
from momapos.planning.reachability.reach_map import SPACING, YAWS, ReachConfig, ReachMap

COARSE = ReachConfig(cell=0.08, directions=13, azimuths=32, spins=4)
TINY = ReachConfig(cell=0.25, directions=5, azimuths=8, spins=1)


@pytest.fixture(scope="module")
def reach(husky: Robot) -> ReachMap:
    return build_map(husky, COARSE)


def test_building_a_map_compiles_no_entry_for_other_types(reach: ReachMap) -> None:
    """Arguments of the annotated types run stored machine code, without a dispatcher of numba."""
    assert reach.reach > 0.0
    others = [one.name for one in ENTRIES.values() if ".reachability." in one.name]
    assert others
    assert not [name for name in others if "dispatcher" in vars(ENTRIES[name])]


def _free_states(robot: Robot, rng: np.random.Generator, count: int) -> np.ndarray:
    chain = robot.chain
    q = rng.uniform(np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi), (count, 6))
    boxes = (np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0, bool))
    codes = check_states(
        q, np.zeros(3), chain_arrays(chain), robot.spheres.arrays, boxes, False, 0.0
    )
    return q[codes == FREE]


def test_every_sampled_tool_pose_is_marked_reachable(husky: Robot, reach: ReachMap) -> None:
    q = _free_states(husky, np.random.default_rng(0), 12_000)[:4_000]
    marked = reach.score(husky.chain.tool_poses(q)) > 0
    # 0.99 at the default resolution, see docs/results/reachability.md.
    assert marked.mean() >= 0.97


def test_the_map_agrees_with_exact_inverse_kinematics(husky: Robot, reach: ReachMap) -> None:
    found = evaluate(reach, husky, np.random.default_rng(1), 4_000)
    assert found.accuracy > 0.97
    assert found.false_positives < 0.05
    assert found.misses < 0.04


def test_poses_beyond_reach_score_zero(husky: Robot, reach: ReachMap) -> None:
    rng = np.random.default_rng(2)
    Ts = random_poses(husky, rng, 500)
    Ts[:, :2, 3] += 4.0 * np.sign(Ts[:, :2, 3])
    assert (reach.score(Ts) == 0).all()
    Ts = random_poses(husky, rng, 500)
    Ts[:, 2, 3] += 3.0
    assert (reach.score(Ts) == 0).all()


def test_scores_lie_between_zero_and_one_and_grow_inwards(husky: Robot, reach: ReachMap) -> None:
    Ts = random_poses(husky, np.random.default_rng(3), 3_000)
    score = reach.score(Ts)
    assert score.min() == 0.0
    assert 0.2 < score.max() <= 1.0
    nudged = Ts.copy()
    nudged[:, :3, 3] += 0.01
    # A step of 1 cm is at most a quarter of a cell along each axis, or 1/16 of the score range.
    assert np.abs(reach.score(nudged) - score).max() < 0.2


def test_turning_the_tool_about_the_last_axis_changes_nothing(
    husky: Robot, reach: ReachMap
) -> None:
    chain = husky.chain
    q = _free_states(husky, np.random.default_rng(4), 500)
    turned = q.copy()
    turned[:, -1] += 1.0
    np.testing.assert_allclose(
        reach.score(chain.tool_poses(q)), reach.score(chain.tool_poses(turned)), atol=1e-4
    )


def test_without_the_azimuth_a_turn_of_the_base_changes_nothing(husky: Robot) -> None:
    flat = build_map(husky, replace(TINY, azimuths=1))
    Ts = random_poses(husky, np.random.default_rng(5), 300)
    x, y = flat.axis_xy
    for yaw in (0.3, 2.0, -1.2):
        turned = _turned(Ts, x, y, yaw)
        np.testing.assert_allclose(flat.score(turned), flat.score(Ts), atol=1e-4)


def test_min_score_is_the_minimum_of_the_scores(husky: Robot, reach: ReachMap) -> None:
    rng = np.random.default_rng(6)
    Ts = random_poses(husky, rng, 5)[:, None].repeat(4, 1)
    Ts[..., :3, 3] += rng.uniform(-0.05, 0.05, (5, 4, 3))
    bases = np.column_stack([rng.uniform(-0.5, 0.5, (40, 2)), rng.uniform(-np.pi, np.pi, 40)])
    Ts_base = np.array([invert(pose_planar(base)) for base in bases])
    expected = reach.score(Ts_base[:, None, None] @ Ts).min(-1)
    np.testing.assert_allclose(reach.min_score(bases, Ts), expected, atol=1e-3)
    assert (expected > 0).any()


def test_base_scores_are_the_best_over_yaws(husky: Robot, reach: ReachMap) -> None:
    xs, ys = np.linspace(-1, 1.3, 33), np.linspace(-0.8, 1, 21)
    yaws = 2 * np.pi / YAWS * np.arange(YAWS)
    grid = np.stack(np.broadcast_arrays(xs[:, None], ys[:, None, None], yaws), -1).reshape(-1, 3)
    # Cells larger than the lattice, equal to it and smaller; with an arm above the base's origin.
    for cell, axis in ((0.08, reach.axis_xy), (SPACING, reach.axis_xy), (0.03, np.zeros(2))):
        moved, highest = replace(reach, cell=cell, axis_xy=axis), 0.0
        for T in random_poses(husky, np.random.default_rng(7), 6):
            found = moved.base_scores(T, xs, ys)
            best = moved.min_score(grid, T[None, None]).reshape(21, 33, YAWS).max(-1)
            # The score changes by 1/4 per cell, which bounds the smoothing.
            assert np.abs(found - best).max() < 0.25 * max(1.0, SPACING / cell)
            assert np.abs(found - best).mean() < 0.01
            highest = max(highest, best.max())
        assert highest > 0.05


def test_base_scores_are_exact_where_the_axis_is_on_the_lattice(
    husky: Robot, reach: ReachMap
) -> None:
    central = replace(
        reach, cell=SPACING, axis_xy=np.zeros(2), values=reach.values.max(-1, keepdims=True)
    )
    steps = SPACING * np.arange(-25, 26)
    for T in random_poses(husky, np.random.default_rng(8), 5):
        point = central.lines(T)
        xs, ys = point[0] + steps, point[1] + steps
        bases = np.stack(np.broadcast_arrays(xs, ys[:, None], 0.0), -1).reshape(-1, 3)
        expected = central.min_score(bases, T[None, None]).reshape(51, 51)
        np.testing.assert_allclose(central.base_scores(T, xs, ys), expected, atol=1e-3)


def test_a_second_load_does_not_rebuild(
    husky: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shares: list[float] = []
    first = load_reach_map(husky, tmp_path, shares.append, config=TINY)
    assert 0.0 < min(shares) <= max(shares) <= 1.0
    monkeypatch.setattr(map_store, "build_map", lambda *_, **__: pytest.fail("built again"))
    second = load_reach_map(husky, tmp_path, config=TINY)
    np.testing.assert_array_equal(first.values, second.values)
    np.testing.assert_array_equal(first.line_tool, second.line_tool)
    assert (first.low, first.cell, first.key) == (second.low, second.cell, second.key)


def test_a_map_that_took_too_long_is_not_tried_again_within_the_same_time(
    husky: Robot, reach: ReachMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = replace(husky, tool_link="wrist_3_link")
    shares: list[float] = []
    fallback = load_reach(other, tmp_path, shares.append, limit=0.01)
    assert isinstance(fallback, ArmLength)
    assert "momapos reach build" in fallback.note
    assert "slower" in fallback.note
    assert max(shares, default=0.0) < 1.0
    with monkeypatch.context() as patch:
        patch.setattr(map_store, "build_map", lambda *_, **__: pytest.fail("built again"))
        again = load_reach(other, tmp_path, limit=0.01)
        assert isinstance(again, ArmLength)
        assert again.note == fallback.note
    # A longer limit tries again.
    monkeypatch.setattr(map_store, "build_true_map", lambda *_, **__: reach)
    assert load_reach(other, tmp_path, limit=60.0) is reach
    assert isinstance(load_reach(other, tmp_path, limit=0.01), ReachMap)


def test_a_map_that_an_earlier_build_version_cached_is_rebuilt(
    husky: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load_reach_map(husky, tmp_path, config=TINY)
    (path,) = tmp_path.iterdir()
    monkeypatch.setattr(map_store, "_BUILD", map_store._BUILD + 1)
    load_reach_map(husky, tmp_path, config=TINY)
    cached = sorted(file.name for file in tmp_path.iterdir())
    assert len(cached) == 2
    assert path.name in cached
    # Maps from before build versions have no version in their name.
    assert path.name != f"reach-{map_key(husky, TINY)}"


@pytest.mark.parametrize("damage", ["flip", "cut", "foreign", "empty"])
def test_a_damaged_file_is_rebuilt(husky: Robot, tmp_path: Path, damage: str) -> None:
    first = load_reach_map(husky, tmp_path, config=TINY)
    (path,) = tmp_path.iterdir()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    damaged = {
        "flip": bytes(data),
        "cut": path.read_bytes()[:-20],
        "foreign": b"PK\x03\x04",
        "empty": b"",
    }
    path.write_bytes(damaged[damage])
    np.testing.assert_array_equal(load_reach_map(husky, tmp_path, config=TINY).values, first.values)
    assert decode(encode(first)).key == first.key
    assert path.read_bytes() not in damaged.values()


def test_the_key_depends_on_everything_that_a_map_is_built_from(
    husky: Robot, segway: Robot
) -> None:
    keys = {
        map_key(husky, TINY),
        map_key(husky, COARSE),
        map_key(segway, TINY),
        map_key(replace(husky, tool_link="wrist_3_link"), TINY),
        map_key(replace(husky, disabled=frozenset()), TINY),
    }
    assert len(keys) == 5
    assert map_key(husky, TINY) in keys


def test_a_map_that_is_too_large_gets_larger_cells(
    husky: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = 2_000_000
    for module in (construct, map_store):
        monkeypatch.setattr(module, "MAX_VALUES", limit)
    built = build_map(husky)
    assert limit / 2 < built.values.size <= limit
    np.testing.assert_array_equal(decode(encode(built)).values, built.values)
    with pytest.raises(RobotError, match="choose larger cells"):
        build_map(husky, replace(default_config(husky), cell=built.cell / 2))


def test_a_limited_first_joint_excludes_azimuths(husky: Robot) -> None:
    limited = _with_first_joint_between(husky, -0.5, 0.5)
    reach = build_map(limited, replace(COARSE, cell=0.12, spins=1))
    ahead = husky.chain.tool_poses(np.array([[0.0, -1.0, 1.2, 0.0, 1.0, 0.0]]))[0]
    x, y = reach.axis_xy
    yaws = np.array([0.0, 0.3, -0.3, np.pi, 2.5, -2.5])
    turned = np.array([_turned(ahead, x, y, yaw) for yaw in yaws])
    np.testing.assert_array_equal(reach.score(turned) > 0, [True, True, True, False, False, False])


def _turned(Ts: np.ndarray, x: float, y: float, yaw: float) -> np.ndarray:
    """Turn poses about the vertical axis through (x, y)."""
    there, turn, back = pose_planar(np.array([[x, y, 0.0], [0.0, 0.0, yaw], [-x, -y, 0.0]]))
    return there @ turn @ back @ Ts


def _with_first_joint_between(robot: Robot, lower: float, upper: float) -> Robot:
    chain, segments = robot._parts
    low, high = chain.lower.copy(), chain.upper.copy()
    low[0], high[0] = lower, upper
    # With the shoulder's other side the arm would reach behind.
    low[1], high[1] = -np.pi / 2, 0.0
    changed = replace(robot)
    changed.__dict__["_parts"] = (replace(chain, lower=low, upper=high), segments)
    return changed


def test_octahedral_points_are_unit_vectors_and_turns_approximate_arctan2() -> None:
    rng = np.random.default_rng(8)
    for u, v in rng.uniform(-1, 1, (200, 2)):
        x, y, z = oct_decode(u, v)
        assert abs(x * x + y * y + z * z - 1) < 1e-12
        assert abs((turns_of(y, x) - np.arctan2(y, x) / (2 * np.pi) + 0.5) % 1 - 0.5) < 5e-5


def test_two_that_need_a_map_at_once_build_it_once(
    husky: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = []
    build = map_store.build_map

    def counted(*words: object, **options: object) -> ReachMap:
        built.append(1)
        return build(*words, **options)

    monkeypatch.setattr(map_store, "build_map", counted)
    with ThreadPoolExecutor(2) as pool:
        maps = list(pool.map(lambda _: load_reach_map(husky, tmp_path, config=TINY), range(2)))
    assert len(built) == 1
    assert maps[0].key == maps[1].key
    assert not [file for file in tmp_path.iterdir() if file.name.endswith("-lock")]
