"""A closing arm stops where the part stops, and presses no harder than needed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.simulation.toy import Toy, toy
from tests.verification.door_case import OPEN, Case, make_case

from momapos.model.records.plans import Motion, Task
from momapos.simulation.arm_control import sense_forces
from momapos.simulation.config import STOP_FORCE, Ending, ExecutionConfig, FurnitureConfig
from momapos.simulation.simulation import Simulation

FLUSH = (
    '<collision><origin xyz="-0.2 0.14 0"/><geometry><box size="0.02 0.2 0.5"/></geometry>'
    "</collision>"
)
"""Element of the cupboard that overlaps the closed door, as in imported furniture."""


def closing(folder: Path, case: Case) -> Toy:
    """Return the opening motion reversed, for a door that stands open."""
    case.scene["objects"][0]["joints"]["hinge"] = OPEN
    opening = toy(folder, case)
    m = opening.motion
    motion = Motion(
        approach=m.q[-1:], q=m.q[::-1], object_q=m.object_q[::-1],
        Ts_world_tool=m.Ts_world_tool[::-1],
    )  # fmt: skip
    task = Task("close", "cupboard", "hinge", 0.0)
    return replace(opening, motion=motion, task=task)


def test_a_door_is_closed(tmp_path: Path) -> None:
    done = closing(tmp_path, make_case()).run()
    assert done.success, done.reason
    assert done.reached == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("stop", [pytest.param(0.02, marks=pytest.mark.slow), 0.04])
def test_at_an_early_stop_the_arm_stops_and_the_grasp_holds(stop: float, tmp_path: Path) -> None:
    case = make_case()
    case.cupboard = case.cupboard.replace('lower="0"', f'lower="{stop}"')
    done = closing(tmp_path, case).run()
    assert done.success, done.reason
    assert done.reached == pytest.approx(stop, abs=0.003)
    assert done.load.force < 60


@pytest.mark.parametrize("thickness", [pytest.param(0.002, marks=pytest.mark.slow), 0.004])
def test_the_force_on_a_strip_near_the_hinge_is_bounded_by_the_stop_force_and_its_lever(
    thickness: float, tmp_path: Path
) -> None:
    case = make_case()
    inner = 0.195  # x of the closed door's inner face; the strip is 15 cm from the hinge
    case.obstacle([0.005, 0.04, 0.2], [inner - thickness + 0.0025, -0.14, 0.8])
    done = closing(tmp_path, case).run()
    assert done.success, done.reason
    hardest = max(hit.force for hit in done.collisions)
    lever = 0.54 / 0.13
    assert 0 < hardest < 60 * lever


def test_a_collision_above_the_force_limit_fails_even_if_the_door_closes(tmp_path: Path) -> None:
    case = make_case()
    case.obstacle([0.005, 0.04, 0.2], [0.1935, -0.14, 0.8])
    door = closing(tmp_path, case)
    loose = door.run()
    assert loose.success, loose.reason
    hit = loose.collisions[0]
    strict = door.run(config=ExecutionConfig(touch_force=0.5 * hit.force))
    assert not strict.success
    assert strict.reason.startswith(f"hit: {hit.one} ")
    assert f" mm in {hit.other} with " in strict.reason


def test_an_element_that_overlaps_the_closed_door_does_not_hold_it_open(tmp_path: Path) -> None:
    case = make_case()
    case.cupboard = case.cupboard.replace("</collision></link>", f"</collision>{FLUSH}</link>", 1)
    done = closing(tmp_path, case).run()
    assert done.success, done.reason
    assert done.collisions == ()
    assert any("cupboard/body" in note for note in done.notes)


def test_a_stopped_arm_does_not_press(tmp_path: Path) -> None:
    case = make_case()
    case.cupboard = case.cupboard.replace('lower="0"', 'lower="0.03"')
    forces: list[float] = []

    def watch(world: Simulation, _: float, stage: str) -> None:
        if stage == "dwell":
            forces.append(sense_forces(world).size[0])

    assert closing(tmp_path, case).run(watch=watch).success
    assert np.mean(forces[-20:]) < STOP_FORCE


def test_a_door_with_constant_friction_is_moved_to_its_end(tmp_path: Path) -> None:
    stiff = ExecutionConfig(furniture=FurnitureConfig(hinge_friction=30.0))
    done = closing(tmp_path, make_case()).run(config=stiff)
    assert done.success, done.reason
    assert done.load.force > STOP_FORCE
    assert done.reached == pytest.approx(0.0, abs=0.02)
    assert done.ending == Ending.DONE
