"""Base configurations and arm trajectories as a stream of PDDLStream.

Garrett, Lozano-Perez and Kaelbling, "PDDLStream: Integrating Symbolic Planners and Blackbox
Samplers via Optimistic Adaptive Planning", ICAPS 2020. Its `from_gen_fn` takes a function that
gets the values of a stream's inputs and yields tuples of values for its outputs, until it ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import InputError
from momapos.model import TimedTrajectory, time_plan
from momapos.model.records import ANYWHERE, BaseRegion, PlacementPlan, ReachScorer, Verb
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.perception.recordings import rigid_pose
from momapos.planning import DEFAULT, PipelineConfig, iter_placements
from momapos.planning.grasps import GraspConfig, make_task

if TYPE_CHECKING:
    from jaxtyping import Float

STREAM = """\
(:stream place-base
  :inputs (?o ?p ?g)
  :domain (and (Pose ?o ?p) (Grasp ?o ?g))
  :outputs (?q ?t)
  :certified (and (BConf ?q) (ATraj ?t) (Kin ?o ?p ?g ?q ?t))
)
"""
"""The declaration that goes into a domain's stream file, with the predicates of PDDLStream's own
examples of mobile manipulators."""

BaseConf: TypeAlias = tuple[float, float, float]
"""What ?q stands for: x [m], y [m], yaw [rad] of the base on the floor."""
ObjectPose: TypeAlias = "Float[np.ndarray, '4 4'] | float | None"
"""What ?p stands for: T_world_object of a loose thing, the value of a part's joint [rad] or [m],
or None where the scene has it."""


@dataclass(frozen=True, eq=False)
class ArmTrajectory:
    """What ?t stands for: the arm's motion at ?q; one is equal to itself alone."""

    plan: PlacementPlan
    robot: Robot

    @cached_property
    def timed(self) -> TimedTrajectory:
        """The motion over time.

        Raises:
            InputError: No trajectory keeps the limits of speed and acceleration.
        """
        return time_plan(self.plan, self.robot)


GenFn: TypeAlias = Callable[
    [str, ObjectPose, "GraspConfig | None"], Iterator[tuple[BaseConf, ArmTrajectory]]
]


def placement_stream(
    scene: Scene,
    robot: Robot,
    verb: Verb,
    *,
    to: float | str | None = None,
    reach: ReachScorer | None = None,
    start: Float[np.ndarray, "3"] | None = None,
    region: BaseRegion = ANYWHERE,
    config: PipelineConfig = DEFAULT,
    seed: int = 0,
) -> GenFn:
    """Make the generator of a stream (?o, ?p, ?g) -> (?q, ?t) that certifies kin, see `STREAM`.

    `from_gen_fn` of PDDLStream takes it as it is. Called with an object, its pose and a grasp, it
    yields base configurations with arm trajectories in the order of `iter_placements`, and ends
    where there is no further one, or where the time of `config.timeout` is over. The object is
    named as on the command line: "cup", or "fridge/door_hinge" for a part. A grasp is a
    `GraspConfig`, the ways of holding that may be used; None for those of `config`.

    Args:
        scene: The room; the object asked about is moved in it to its pose.
        robot: The mobile manipulator.
        verb: open, close, pick or place.
        to: Value that a part is moved to, see `make_task`.
        reach: The robot's reachability map; None to load it.
        start: Where the base is at first: x [m], y [m], yaw [rad]; the scene's start by default.
        region: Where the base is allowed to stand.
        config: How to search.
        seed: Same seed, same stream.

    Raises:
        MomaposError: When the generator is advanced: as `make_task` and `iter_placements`, or the
            pose is not of the kind that the object has.
    """

    def gen_fn(
        name: str, pose: ObjectPose = None, grasp: GraspConfig | None = None
    ) -> Iterator[tuple[BaseConf, ArmTrajectory]]:
        item, _, joint = name.partition("/")
        room = scene if pose is None else _moved(scene, item, joint, pose)
        task = make_task(room, verb, item, joint or None, to)
        held = config if grasp is None else _holding(config, grasp)
        answers = iter_placements(
            room, robot, task, reach, start=start, region=region, config=held, seed=seed
        )
        with closing(answers):  # type: ignore[type-var]
            for answer in answers:
                assert answer.plan.base_pose is not None
                yield answer.plan.base_pose, ArmTrajectory(answer.plan, robot)

    return gen_fn


def _holding(config: PipelineConfig, grasp: GraspConfig) -> PipelineConfig:
    return replace(config, motion=replace(config.motion, grasps=grasp))


def _moved(scene: Scene, name: str, joint: str, pose: Float[np.ndarray, "4 4"] | float) -> Scene:
    """The scene with a part at another value, or with a loose thing elsewhere and no file."""
    if joint:
        if np.ndim(pose):
            raise InputError(f"{name}/{joint}: the pose of a part is one number [rad] or [m]")
        return scene.with_joints({name: {joint: float(pose)}})
    T = np.array(pose, float)
    if T.shape != (4, 4):
        raise InputError(f"{name}: the pose of an object is T_world_object, 4 x 4, not {T.shape}")
    try:
        T = rigid_pose(T)
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None
    target = scene.object(name)
    objects = (replace(o, T_world_object=T) if o is target else o for o in scene.objects)
    name = f"{scene.name} with {name} moved"
    return replace(scene, name=name, objects=tuple(objects), path=None)
