"""Laws of how far beside a base pose the robot may stand."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import Everywhere

from momapos import tolerance
from momapos.base_pose import BasePoseChecks, check_base_pose
from momapos.cli.main import main
from momapos.errors import InputError
from momapos.manipulation.tasks import make_task
from momapos.outcomes import PoseOutcome, PoseStatus
from momapos.plans import read_plan
from momapos.robots.robot import load_robot
from momapos.robust import unit_offsets
from momapos.scene.files import load_scene
from momapos.tolerance import RADII, TURN, placement_tolerance
from momapos.types import Attempt, Motion

MOTION = Motion(np.zeros((1, 6)), np.zeros((1, 6)), np.zeros(1), np.eye(4)[None])
WORKS = Attempt(MOTION, PoseOutcome(PoseStatus.FEASIBLE))
FAILS = Attempt(None, PoseOutcome(PoseStatus.OUT_OF_REACH))
BASE = np.array([1.3, -1.2, 0.4])


def test_offsets_fill_the_unit_disc_evenly() -> None:
    offsets = unit_offsets(4000, np.random.default_rng(0))
    radius = np.hypot(offsets[:, 0], offsets[:, 1])
    assert radius.max() <= 1.0
    assert np.abs(offsets[:, 2]).max() <= 1.0
    assert (radius < 0.5).mean() == pytest.approx(0.25, abs=0.03)
    np.testing.assert_allclose(offsets.mean(0), 0.0, atol=0.05)


@pytest.fixture
def limit(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Lets the check accept what is that near to `BASE` [m], [rad]."""
    limits = [0.0, np.inf]

    def near(_: BasePoseChecks, base: np.ndarray) -> Attempt:
        away, turn = np.hypot(*(base - BASE)[:2]), abs(base[2] - BASE[2])
        return WORKS if away <= limits[0] and turn <= limits[1] else FAILS

    monkeypatch.setattr(BasePoseChecks, "__init__", lambda *_: None)
    monkeypatch.setattr(BasePoseChecks, "__call__", near)
    return limits


@pytest.mark.parametrize("radius", [0.0, 0.012, 0.03, 0.2])
def test_the_disc_is_the_largest_that_holds(radius: float, limit: list[float]) -> None:
    scene, robot = load_scene("kitchen_small"), load_robot("segway_ur5e")
    task = make_task(scene, "open", "cabinet_right", "drawer_middle_slide")
    limit[0] = radius
    found = placement_tolerance(scene, robot, task, BASE, Everywhere(), samples=400)
    inside = [one for one in RADII if one <= radius]
    # Of so many samples some lie in the outermost hundredth.
    assert found.radius in (max(inside, default=0.0), *(r for r in RADII if 0 < r - radius < 1e-3))
    assert found.turn == pytest.approx(found.radius * TURN)
    assert found.at_least == pytest.approx(0.9925, abs=1e-4)
    limit[:] = [np.inf, 0.02 * TURN]
    assert placement_tolerance(scene, robot, task, BASE, Everywhere()).radius == 0.02


def test_from_other_poses_in_the_disc_the_drawer_opens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tolerance, "RADII", (0.01, 0.02, 0.2))
    monkeypatch.setattr(tolerance, "placement_tolerance", partial(placement_tolerance, samples=12))
    out = tmp_path / "plan.json"
    question = ["kitchen_small", "cabinet_right/drawer_middle_slide", "--robot", "segway_ur5e"]
    assert main(["place", "open", *question, "--tolerance", "--out", str(out)]) == 0
    assert "cm and" in capsys.readouterr().out
    plan = read_plan(out)
    assert plan.tolerance is not None
    assert plan.tolerance.samples == 12
    assert plan.tolerance.radius in (0.01, 0.02)
    scene, robot = load_scene("kitchen_small"), load_robot("segway_ur5e")
    size = np.array([plan.tolerance.radius, plan.tolerance.radius, plan.tolerance.turn])
    for offset in unit_offsets(5, np.random.default_rng(7)):
        pose = np.array(plan.base_pose) + offset * size
        found = check_base_pose(scene, robot, plan.task, pose, Everywhere(), how_far=False)
        assert found.motion is not None, found.reason


def test_there_have_to_be_samples() -> None:
    scene, robot = load_scene("kitchen_small"), load_robot("segway_ur5e")
    task = make_task(scene, "open", "cabinet_right", "drawer_middle_slide")
    with pytest.raises(InputError, match="at least 1"):
        placement_tolerance(scene, robot, task, BASE, Everywhere(), samples=0)
