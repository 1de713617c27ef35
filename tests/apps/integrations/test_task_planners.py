"""Laws of the adapters for task planners; stand-ins replace the planners."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
from tests.rooms import Everywhere

from momapos.apps.integrations.pddlstream import STREAM, GenFn, placement_stream
from momapos.apps.integrations.pycram import PlacementBackend
from momapos.core.errors import InputError, SceneError, TaskError, UnknownNameError
from momapos.model.records.plans import BaseRegion, Verb
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import GraspConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import iter_placements
from momapos.planning.placement.config import PlaceConfig
from momapos.verification.exact_check import PlanVerifier

CONFIG = PipelineConfig(place=PlaceConfig(count=256, rounds=1, grid=False), timeout=300.0)
DRAWER = "cabinet_right/drawer_middle_slide"


# PDDLStream


def from_gen_fn(gen_fn: Callable[..., Iterator[Any]]) -> Callable[..., Iterator[Sequence[Any]]]:
    """Mimic PDDLStream: a value becomes a list of one, None an empty list."""
    return lambda *inputs: ([] if out is None else [out] for out in gen_fn(*inputs))


def stream(scene: Scene, robot: Robot, verb: Verb = "open", to: str | None = None) -> GenFn:
    return placement_stream(scene, robot, verb, to=to, reach=Everywhere(), config=CONFIG)


def test_a_stream_yields_a_list_of_one_output_tuple_for_the_declared_outputs(
    kitchen: Scene, segway: Robot
) -> None:
    declared = STREAM.split(":outputs (")[1].split(")")[0].split()
    outputs = list(islice(from_gen_fn(stream(kitchen, segway))(DRAWER, None, None), 3))
    assert len(outputs) == 3
    for output in outputs:
        (values,) = output
        assert isinstance(values, Sequence)
        assert len(values) == len(declared) == 2
        hash(values)  # PDDLStream hashes values
    poses = [output[0][0] for output in outputs]
    assert len(set(poses)) == 3


def test_the_exact_check_accepts_what_a_stream_certifies(kitchen: Scene, segway: Robot) -> None:
    task = make_task(kitchen, "open", *DRAWER.split("/"))
    verifier = PlanVerifier(kitchen, segway, task)
    for q, t in islice(stream(kitchen, segway)(DRAWER, None, None), 2):
        assert t.plan.base_pose == q
        assert verifier.check(q, t.plan.motion).valid
    assert t.timed.positions.shape[1] == len(segway.moved_joints)
    assert t.timed is t.timed


def test_the_pose_of_a_part_is_its_initial_joint_value(kitchen: Scene, segway: Robot) -> None:
    _, half = next(stream(kitchen, segway)(DRAWER, 0.2, None))
    assert half.plan.motion.object_q[0] == pytest.approx(0.2)
    with pytest.raises(InputError, match="one number"):
        next(stream(kitchen, segway)(DRAWER, np.eye(4), None))
    with pytest.raises(SceneError, match="outside its limits"):
        next(stream(kitchen, segway)(DRAWER, 7.0, None))


def test_a_movable_object_is_picked_at_its_given_pose(kitchen: Scene, segway: Robot) -> None:
    T = kitchen.object("cereal_box").T_world_object.copy()
    T[:3, 3] += 0.05, 0.0, 0.0
    picks = stream(kitchen, segway, "pick")
    _, moved = next(picks("cereal_box", T, None))
    item = kitchen.object("cereal_box")
    there = replace(
        kitchen,
        objects=tuple(
            replace(o, T_world_object=T) if o is item else o for o in kitchen.objects
        ),
    )  # fmt: skip
    verifier = PlanVerifier(there, segway, make_task(there, "pick", "cereal_box"))
    assert verifier.check(moved.plan.base_pose, moved.plan.motion).valid
    assert moved.plan.scene == "kitchen_small with cereal_box moved"
    with pytest.raises(InputError, match="4 x 4"):
        next(picks("cereal_box", 1.0, None))
    with pytest.raises(InputError, match="cereal_box: the pose is not a rigid transform"):
        next(picks("cereal_box", 2.0 * T, None))


def test_a_grasp_selects_the_grasp_families(kitchen: Scene, segway: Robot) -> None:
    given = stream(kitchen, segway)
    _, pinched = next(given(DRAWER, None, GraspConfig(families=("pinch",))))
    assert {hold.family for hold in pinched.plan.motion.holds} == {"pinch"}
    # An infeasible grasp ends the stream.
    assert list(given(DRAWER, None, GraspConfig(families=("suction",)))) == []


def test_a_stream_refuses_an_invalid_task(kitchen: Scene, segway: Robot) -> None:
    with pytest.raises(UnknownNameError):
        next(stream(kitchen, segway)("cabinet_rihgt/drawer_middle_slide", None, None))
    with pytest.raises(TaskError):
        next(stream(kitchen, segway, "pick")("fridge", None, None))


# pycram


@dataclass
class Pose:
    """A pose of the robot's base in its world."""

    xyz: tuple[float, float, float]
    yaw: float
    frame: str


@dataclass
class Location:
    """Mimic pycram: poses of a back-end that all validators accept."""

    generator: PlacementBackend[Pose]
    validators: Sequence[Callable[[Pose], bool]] = ()

    def __iter__(self) -> Iterator[Pose]:
        return (p for p in self.generator if all(accepts(p) for accepts in self.validators))

    def ground(self) -> Pose:
        return next(iter(self))


def test_a_location_yields_the_placements_in_their_order(kitchen: Scene, segway: Robot) -> None:
    task = make_task(kitchen, "open", *DRAWER.split("/"))
    reach = Everywhere()
    backend = PlacementBackend(
        kitchen, segway, task, lambda x, y, yaw: Pose((x, y, 0.0), yaw, "map"), reach, config=CONFIG
    )
    plans = [
        a.plan for a in islice(iter_placements(kitchen, segway, task, reach, config=CONFIG), 3)
    ]
    poses = list(islice(Location(backend), 3))
    assert [(p.xyz[0], p.xyz[1], p.yaw) for p in poses] == [plan.base_pose for plan in plans]
    assert {(p.xyz[2], p.frame) for p in poses} == {(0.0, "map")}
    assert Location(backend).ground() == poses[0]
    first = poses[0]
    assert Location(backend, [lambda pose: pose != first]).ground() == poses[1]


def test_a_location_without_a_placement_is_empty(kitchen: Scene, segway: Robot) -> None:
    task = make_task(kitchen, "open", *DRAWER.split("/"))
    nowhere = BaseRegion(most_driving=0.0)
    backend = PlacementBackend(
        kitchen, segway, task, lambda x, y, yaw: (x, y, yaw), Everywhere(),
        region=nowhere, config=CONFIG,
    )  # fmt: skip
    assert list(backend) == []
