"""A PDDLStream stream of base configurations and arm trajectories.

Garrett, Lozano-Perez and Kaelbling, "PDDLStream: Integrating Symbolic Planners and Blackbox
Samplers via Optimistic Adaptive Planning", ICAPS 2020. Its `from_gen_fn` takes a function from the
values of a stream's inputs to an iterator over tuples of values of its outputs.
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
"""Declaration for a domain's stream file, with the predicates of PDDLStream's examples of mobile
manipulators."""

BaseConf: TypeAlias = tuple[float, float, float]
"""Value of ?q: x [m], y [m], yaw [rad] of the base on the floor."""
ObjectPose: TypeAlias = "Float[np.ndarray, '4 4'] | float | None"
"""Value of ?p: T_world_object of a movable object, the joint value of a part [rad] or [m], or None
for the pose in the scene."""


@dataclass(frozen=True, eq=False)
class ArmTrajectory:
    """Value of ?t: the motion of the arm at ?q; compared by identity."""

    plan: PlacementPlan
    robot: Robot

    @cached_property
    def timed(self) -> TimedTrajectory:
        """The timed motion.

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
    """Make the generator function of a stream (?o, ?p, ?g) -> (?q, ?t), see `STREAM`.

    Pass it to `from_gen_fn` of PDDLStream. It takes an object, its pose and a grasp, and yields
    base configurations with arm trajectories in the order of `iter_placements`, until there are no
    more or `config.timeout` is over. Plans whose base moves in the manipulation are left out,
    because ?q is one pose. Objects are named as on the command line: "cup", or
    "fridge/door_hinge" for a part. A grasp is a `GraspConfig`, the allowed grasp families; None
    for those of `config`.

    Args:
        scene: The scene; the stream moves its object to the given pose.
        robot: The mobile manipulator.
        verb: open, close, press, pick or place.
        to: Joint value to reach, see `make_task`.
        reach: The robot's reachability map; None to load it.
        start: Initial base pose x [m], y [m], yaw [rad]; the scene's start by default.
        region: Region of allowed base poses.
        config: Configuration of the search.
        seed: Same seed, same stream.

    Raises:
        MomaposError: While iterating: see `make_task` and `iter_placements`, or the pose has the
            wrong form for the object.
    """

    def gen_fn(
        name: str, pose: ObjectPose = None, grasp: GraspConfig | None = None
    ) -> Iterator[tuple[BaseConf, ArmTrajectory]]:
        item, _, joint = name.partition("/")
        room = scene if pose is None else _moved(scene, item, joint, pose)
        task = make_task(room, verb, item, joint or None, to)
        settings = config
        if grasp is not None:
            settings = replace(config, motion=replace(config.motion, grasps=grasp))
        answers = iter_placements(
            room, robot, task, reach, start=start, region=region, config=settings, seed=seed
        )
        with closing(answers):  # type: ignore[type-var]
            for answer in answers:
                if answer.plan.moves_base:
                    continue
                assert answer.plan.base_pose is not None
                yield answer.plan.base_pose, ArmTrajectory(answer.plan, answer.prepared.robot)

    return gen_fn


def _moved(scene: Scene, name: str, joint: str, pose: Float[np.ndarray, "4 4"] | float) -> Scene:
    """Return the scene with a part at a joint value, or with a movable object at a pose."""
    if joint:
        if np.ndim(pose):
            raise InputError(f"{name}/{joint}: the pose of a part must be one number [rad] or [m]")
        return scene.with_joints({name: {joint: float(pose)}})
    T = np.array(pose, float)
    if T.shape != (4, 4):
        raise InputError(f"{name}: the pose of an object must be a 4 x 4 matrix, not {T.shape}")
    try:
        T = rigid_pose(T)
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None
    target = scene.object(name)
    objects = (replace(o, T_world_object=T) if o is target else o for o in scene.objects)
    name = f"{scene.name} with {name} moved"
    return replace(scene, name=name, objects=tuple(objects), path=None)
