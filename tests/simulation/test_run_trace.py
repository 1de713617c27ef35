"""A run trace contains all poses in order."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from tests.simulation.toy import Toy, toy
from tests.verification.door_case import BASE, JOINTS, OPEN

from momapos.core.geometry.transforms import pose_planar
from momapos.simulation.base_drive import base_pose_of, initial_base_pose
from momapos.simulation.config import Stage
from momapos.simulation.run_record import DRIVE, RunMotion
from momapos.simulation.run_trace import RunTrace

X, Y, YAW = BASE
WAY = np.array([[X - 1.0, Y - 0.5, 0.3], [X - 0.5, Y, YAW + 0.2], [X, Y, YAW]])
TIMES = np.array([0.0, 2.0, 4.0])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Toy:
    return toy(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="module")
def twice(run: Toy) -> RunTrace:
    """Trace a drive and a motion, twice."""
    trace = RunTrace()
    for _ in range(2):
        trace.drive(TIMES, WAY)
        run.run(watch=trace)
    return trace


def test_the_base_in_the_world_is_at_its_driven_poses(twice: RunTrace) -> None:
    act = twice.acts[0]
    world = act.world
    np.testing.assert_allclose(initial_base_pose(world), BASE, atol=1e-9)
    for pose in WAY:
        world.data.qpos[:] = act.standing_at(pose)
        mujoco.mj_forward(world.model, world.data)
        base, T = world.data.body("base"), pose_planar(pose)
        np.testing.assert_allclose(base.xpos, T[:3, 3], atol=1e-6)
        np.testing.assert_allclose(base.xmat.reshape(3, 3), T[:3, :3], atol=1e-6)
        np.testing.assert_allclose(base_pose_of(world, world.data.qpos), pose, atol=1e-9)


def test_a_second_attempt_is_traced_after_the_first(twice: RunTrace) -> None:
    assert len(twice.acts) == 2
    motion = twice.motion()
    assert np.all(np.diff(motion.times) >= 0)
    whole = sum(act.duration for act in twice.acts)
    assert motion.times[-1] == pytest.approx(whole, abs=0.002)
    changes = [s for s, before in zip(motion.stages, ("", *motion.stages), strict=False)
               if s != before]  # fmt: skip
    assert changes.count(DRIVE) == 2
    assert changes[0] == DRIVE
    assert changes.index(Stage.MANIPULATE) < changes.index(DRIVE, 1)


def test_a_motion_contains_the_opening_of_the_part_and_the_force_during_the_grasp(
    run: Toy, twice: RunTrace
) -> None:
    motion = twice.motion()
    assert set(motion.joints) == set(JOINTS)
    assert motion.part[0] == pytest.approx(0.0, abs=1e-3)
    assert motion.part[-1] == pytest.approx(OPEN, rel=0.05)
    np.testing.assert_allclose(motion.bases[0], WAY[0], atol=1e-4)
    np.testing.assert_allclose(
        [values[0] for values in motion.joints.values()], run.motion.approach[0], atol=0.02
    )
    force = np.linalg.norm(motion.forces, axis=1)
    stages = np.array(motion.stages)
    assert force[stages == Stage.MANIPULATE].max() > 1.0
    assert force[(stages == DRIVE) | (stages == Stage.APPROACH)].max() == 0.0


def test_a_run_that_never_reached_the_object_has_its_drives_only() -> None:
    trace = RunTrace()
    trace.drive(TIMES, WAY)
    motion = trace.motion()
    assert set(motion.stages) == {DRIVE}
    assert motion.joints == {}
    assert len(motion.bases) == len(motion.part) == len(motion.times)
    assert trace.played == []


@pytest.mark.parametrize(
    "damaged",
    [
        {"bases": ()},
        {"part": (0.0,)},
        {"times": (1.0, 0.0)},
        {"poses": ((0.0,) * 6,) * 2, "part": ()},
    ],
)
def test_a_motion_with_inconsistent_lists_is_refused(damaged: dict[str, tuple[float, ...]]) -> None:
    good = {
        "times": (0.0, 1.0), "stages": (DRIVE, DRIVE), "bases": ((0.0, 0.0, 0.0),) * 2,
        "part": (0.0, 0.5),
    }  # fmt: skip
    RunMotion(**good)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="motion"):
        RunMotion(**{**good, **damaged})  # type: ignore[arg-type]
