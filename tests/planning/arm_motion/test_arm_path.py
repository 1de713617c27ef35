"""Test arm paths over the waypoints and their lazy collision checks."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from momapos.model.collision.arm_collision import FREE
from momapos.model.collision.collision_world import check
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.arm_motion import arm_path
from momapos.planning.arm_motion.arm_path import BROKEN, FOUND, HIT, ArmPath, find_paths
from momapos.planning.arm_motion.hand_clearance import arm_spheres
from momapos.planning.arm_motion.ik_layers import Layers, solve_layers
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.task_setup import PreparedTask, prepare

TASKS = [
    ("fridge", "door_hinge"),
    ("cabinet_right", "drawer_top_slide"),
    ("microwave", "door_hinge"),
]


def _prepared(robot: Robot, name: str, joint: str) -> PreparedTask:
    scene = load_scene("kitchen_small")
    task = make_task(scene, "open", name, joint)
    return prepare(scene, robot, task, PipelineConfig(), clearance=0.0)


def _base_poses(ready: PreparedTask, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return base poses in front of the handle, and a grasp mode for each."""
    rng, motion = np.random.default_rng(0), ready.motion
    handle = motion.Ts_world_tool[0, motion.grasp_step, :2, 3]
    out = motion.Ts_world_tool[0, motion.grasp_step, :2, 3] - motion.Ts_world_tool[0, -1, :2, 3]
    toward = np.arctan2(out[1], out[0]) + rng.uniform(-0.9, 0.9, count)
    distance = rng.uniform(0.6, 1.0, count)[:, None]
    xy = handle - distance * np.column_stack([np.cos(toward), np.sin(toward)])
    yaw = toward + rng.uniform(-0.4, 0.4, count)
    return np.column_stack([xy, yaw]), rng.integers(0, motion.turning.modes, count)


def _only_free(ready: PreparedTask, robot: Robot, bases: np.ndarray, found: Layers) -> Layers:
    """Check all configurations, and keep only the free ones."""
    motion, (jobs, layers) = ready.motion, found.counts.shape
    job, layer = np.divmod(np.repeat(np.arange(jobs * layers), found.counts.ravel()), layers)
    which = np.concatenate([
        np.arange(first, first + count)
        for first, count in zip(found.first.flat, found.counts.flat, strict=True)
    ])  # fmt: skip
    step = motion.waypoint_steps[layer]
    free = FREE == check(  # noqa: SIM300
        ready.world, robot.chain, arm_spheres(robot), found.q[which], bases[job],
        motion.value[step], motion.holding[step],
    )  # fmt: skip
    counts = np.zeros_like(found.counts)
    np.add.at(counts, (job[free], layer[free]), 1)
    assert (found.checked[which] <= free).all()
    assert ((counts > 0) == (found.counts > 0)).all()
    first = (np.cumsum(counts) - counts.ravel()).reshape(counts.shape)
    kept = which[free]
    return found._replace(
        q=found.q[kept], grasps=found.grasps[kept], checked=np.ones(len(kept), bool),
        first=first, counts=counts,
    )  # fmt: skip


@pytest.mark.parametrize(("name", "joint"), TASKS)
def test_lazy_checks_give_the_path_of_complete_checks(
    fetch: Robot, name: str, joint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ready = _prepared(fetch, name, joint)
    bases, modes = _base_poses(ready, 120)
    find = partial(find_paths, fetch, ready.world, ready.motion, bases, modes)
    lazy = find({})

    def checked(*args: object) -> Layers:
        return _only_free(ready, fetch, bases, solve_layers(*args))  # type: ignore[arg-type]

    monkeypatch.setattr(arm_path, "solve_layers", checked)
    for one, other in zip(lazy, find({}), strict=True):
        assert one.status == other.status
        if one.status == FOUND:
            np.testing.assert_array_equal(one.q, other.q)
    assert sum(path.status == FOUND for path in lazy) >= 1


def test_a_path_avoids_configurations_that_collide(
    fetch: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without this test, nobody would notice if the lazy checks were skipped."""
    ready = _prepared(fetch, "microwave", "door_hinge")
    bases, modes = _base_poses(ready, 120)
    find = partial(find_paths, fetch, ready.world, ready.motion, bases, modes)
    paths = find({})

    def unchecked(*args: object) -> Layers:
        found = solve_layers(*args)  # type: ignore[arg-type]
        return found._replace(checked=np.ones(len(found.checked), bool))

    monkeypatch.setattr(arm_path, "solve_layers", unchecked)
    pairs = zip(paths, find({}), strict=True)
    assert any(path.status != HIT == careless.status for path, careless in pairs)
    motion = ready.motion
    for base, path in zip(bases, paths, strict=True):
        if path.q is not None:
            codes = check(
                ready.world, fetch.chain, arm_spheres(fetch), path.q,
                np.tile(base, (len(path.q), 1)), motion.value, motion.holding,
            )  # fmt: skip
            assert (codes == FREE).all()


@pytest.mark.parametrize("moves", [False, True])
def test_a_batch_gives_what_its_jobs_give_alone(fetch: Robot, *, moves: bool) -> None:
    ready = _prepared(fetch, "fridge", "door_hinge")
    bases, modes = _base_poses(ready, 60)
    if moves:
        share = np.linspace(0.0, 0.1, len(ready.motion.value))[:, None]
        bases = bases[:, None] + share * np.array([-1.0, 0.5, 0.0])

    def hits_late(poses: np.ndarray, value: np.ndarray) -> np.ndarray:
        return np.where(value > len(poses) // 2, 0, FREE)

    find = partial(find_paths, fetch, ready.world, ready.motion)
    find = partial(find, stands=hits_late if moves else None)
    every = find(bases, modes, {})
    assert len({path.status for path in every}) > 1
    for j, path in enumerate(every):
        (alone,) = find(bases[j : j + 1], modes[j : j + 1], {})
        assert alone.status == path.status
        np.testing.assert_equal(vars(alone), vars(path))


def test_a_failed_path_reports_waypoint_and_obstacle(fetch: Robot) -> None:
    ready = _prepared(fetch, "fridge", "door_hinge")
    bases, modes = _base_poses(ready, 120)
    paths = find_paths(fetch, ready.world, ready.motion, bases, modes, {})
    failed = [path for path in paths if path.status in (HIT, BROKEN)]
    assert failed
    for path in failed:
        assert path.q is None
        assert 0 <= path.waypoint < len(ready.motion.waypoint_steps)
        assert (path.obstacle == FREE) == (path.status == BROKEN)
    far = bases + np.array([50.0, 0.0, 0.0])
    unreachable = find_paths(fetch, ready.world, ready.motion, far, modes, {})
    wanted = vars(ArmPath(arm_path.UNREACHABLE, 1, 0, FREE))
    assert all(vars(path) == wanted for path in unreachable)
