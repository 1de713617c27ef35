"""What the wheels of a base can do, checked on base paths."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from door_case import make_case
from jaxtyping import Float

from momapos.core.errors import FileFormatError
from momapos.core.geometry.transforms import wrap_angle
from momapos.model.plan_files.plan_format import plan_to_dict, read_plan, write_plan
from momapos.model.records.plans import PlacementPlan
from momapos.verification.path_checks import MAX_BASE_STEP, wheel_checks
from momapos.verification.plan_check import verify_files

SIDEWAYS, TIGHT = (
    "base path moves sideways, which its drive cannot",
    "base path turns tighter than its drive can",
)


def driven(
    pieces: list[tuple[float, float]], *, step: float = 0.02, offset: float = 0.0
) -> Float[np.ndarray, "n 3"]:
    """Return the poses along arcs of signed lengths [m] and curvatures [1/m].

    Args:
        pieces: The arcs.
        step: Distance between poses [m].
        offset: Distance of the reported point ahead of the one that does not move sideways [m].
    """
    ds, k = (
        np.concatenate([np.full(max(1, round(abs(s) / step)), one) for s, one in pairs])
        for pairs in ([(s, np.sign(s) * step) for s, _ in pieces], pieces)
    )
    yaw = np.concatenate([[0.7], 0.7 + np.cumsum(ds * k)])
    half = (yaw[1:] + yaw[:-1]) / 2
    chord = ds * np.sinc(ds * k / 2 / np.pi)
    x, y = (np.concatenate([[0.0], np.cumsum(chord * f(half))]) for f in (np.cos, np.sin))
    return np.stack([x + offset * np.cos(yaw), y + offset * np.sin(yaw), wrap_angle(yaw)], -1)


def failed(way: Float[np.ndarray, "n 3"], drive: str | None, radius: float | None) -> set[str]:
    return {check.name for check in wheel_checks(way, drive, radius) if not check.ok}


@pytest.mark.parametrize("step", [0.001, 0.02, MAX_BASE_STEP])
def test_arcs_of_the_turning_radius_forwards_and_backwards_pass(step: float) -> None:
    way = driven([(1.0, 1.0), (-0.8, -1.0), (0.5, 0.0), (-2.0, 0.6), (4.0, -1.0)], step=step)
    assert failed(way, "car", 1.0) == set()


@pytest.mark.parametrize("step", [0.0005, 0.02, MAX_BASE_STEP])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_arc_that_is_tighter_fails_however_small_its_steps(step: float, sign: float) -> None:
    way = driven([(0.5, 0.3), (sign * 0.5, 1.1), (0.5, 0.0)], step=step)
    assert failed(way, "car", 1.0) == {TIGHT}
    assert failed(way, "car", 0.9) == set()
    assert failed(way, "differential", None) == set()


@pytest.mark.parametrize("count", [1, 10, 1000])
def test_a_turn_on_the_spot_fails_for_a_car_only(count: int) -> None:
    turn = np.tile([1.0, 2.0, 0.0], (count + 1, 1))
    turn[:, 2] = np.linspace(0.0, 0.09, count + 1)
    assert failed(turn, "car", 0.5) == {TIGHT}
    assert failed(turn, "differential", None) == failed(turn, "omni", None) == set()


def test_a_step_sideways_fails_unless_the_base_is_omnidirectional() -> None:
    way = driven([(1.0, 0.0)])
    way[25:, :2] += [[-0.002, 0.002]]
    for drive, names in (("car", {SIDEWAYS}), ("differential", {SIDEWAYS}), ("omni", set())):
        assert failed(way, drive, 1.0) == names


def test_a_base_link_away_from_the_fixed_axle_moves_sideways_in_turns() -> None:
    assert failed(driven([(1.0, 1.0)], offset=0.02), "car", 1.0) == set()
    assert failed(driven([(1.0, 1.0)], offset=0.2), "car", 1.0) == {SIDEWAYS}
    assert failed(driven([(1.0, 0.0)], offset=0.2), "car", 1.0) == set()


def test_an_older_plan_without_a_drive_is_checked_as_before() -> None:
    assert failed(driven([(1.0, 5.0)]), None, None) == set()


@pytest.fixture
def plan(tmp_path: Path) -> PlacementPlan:
    return read_plan(make_case().write(tmp_path))


def with_path(plan: PlacementPlan, way: Float[np.ndarray, "n 3"]) -> PlacementPlan:
    """Return a plan of a car-like base with a path that is moved to end at its base pose."""
    assert plan.base_pose is not None
    x, y, yaw = plan.base_pose
    turn = yaw - way[-1, 2]
    c, s = np.cos(turn), np.sin(turn)
    away = way[:, :2] - way[-1, :2]
    xy = np.stack([x + c * away[:, 0] - s * away[:, 1], y + s * away[:, 0] + c * away[:, 1]], -1)
    path = np.column_stack([xy, wrap_angle(way[:, 2] + turn)])
    start = (float(path[0, 0]), float(path[0, 1]), float(path[0, 2]))
    return replace(
        plan, robot_drive="car", robot_min_turning_radius=0.8, start=start, base_path=path
    )


def test_a_plan_file_states_drive_and_radius_and_is_verified_with_them(
    plan: PlacementPlan, tmp_path: Path
) -> None:
    names = {}
    for name, curvature in (("wide", 1.2), ("tight", 1.4)):
        car = with_path(plan, driven([(0.2, curvature), (-0.2, 0.0)]))
        write_plan(car, tmp_path / f"{name}.json")
        again = read_plan(tmp_path / f"{name}.json")
        assert again == car
        assert plan_to_dict(again)["robot"]["drive"] == "car"
        assert plan_to_dict(again)["robot"]["min_turning_radius"] == 0.8
        names[name] = {c.name: c.ok for c in verify_files(tmp_path / f"{name}.json").checks}
    assert names["wide"][TIGHT]
    assert not names["tight"][TIGHT]
    assert SIDEWAYS in names["wide"]


def test_a_plan_of_a_car_without_its_radius_is_refused(plan: PlacementPlan, tmp_path: Path) -> None:
    car = replace(plan, robot_drive="car")
    write_plan(car, tmp_path / "car.json")
    with pytest.raises(FileFormatError, match=r"robot\.min_turning_radius is missing"):
        read_plan(tmp_path / "car.json")
    for wrong in ("0", "-1", '"wide"'):
        text = (tmp_path / "car.json").read_text()
        text = text.replace('"drive": "car"', f'"drive": "car", "min_turning_radius": {wrong}')
        (tmp_path / "wrong.json").write_text(text)
        with pytest.raises(FileFormatError, match="min_turning_radius"):
            read_plan(tmp_path / "wrong.json")
