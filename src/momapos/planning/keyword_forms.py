"""Planners with keyword arguments: each builds a `PlacementQuery` and answers it.

Every function also takes a `PlacementQuery` in place of scene, robot and task. The keywords are
those of `PlacementQuery.of`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Unpack, overload

from momapos.core import InputError, TaskError, expect
from momapos.model.records import Attempt, ReachScorer, Task, Tolerance, ToolPath, ToolPose
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.baselines import plan_with_method
from momapos.planning.grasps import make_task

from .base_pose_check import check_pose
from .chains import plan_chain
from .follow_path import plan_path_stops
from .iterate import placements
from .plan import plan_placement
from .query import PlacementQuery, QueryOptions, as_query
from .reach_poses import plan_pose_stops
from .result import PlacementResult
from .tolerance import SAMPLES, tolerance_at
from .tour import MAX_TASKS, Request, Tour, expanded

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    BasePose = Sequence[float] | Float[np.ndarray, "3"]


@overload
def plan_base_placement(query: PlacementQuery, /) -> PlacementResult: ...
@overload
def plan_base_placement(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer | None = None,
    **options: Unpack[QueryOptions],
) -> PlacementResult: ...
def plan_base_placement(scene: Any, *rest: Any, **options: Any) -> PlacementResult:
    """Return where the robot must stand, and how it moves, to do a task.

    Important objects get a kinematic model, all others are boxes. A box that a plan comes near is
    modeled, and the plan is checked again. "Infeasible" is returned only with every object modeled.

    For a task that requests the maximum, the answer is for the largest value that works, to a
    degree or a centimeter, and the plan's task names it. If the time runs out before all larger
    values are excluded, the plan's task does not claim that it is the largest.

    Args:
        scene: The scene; or a `PlacementQuery` and nothing else.
        rest: Robot, task, and its reachability map, which is loaded by default.
        options: Keywords of `PlacementQuery.of`.

    Raises:
        InputError: An argument is wrong, or the configuration names a method that only
            `plan_by_method` knows.
        SceneError: The robot collides at its start pose.
        TaskError: The gripper cannot hold the object.
    """
    return plan_placement(as_query(scene, rest, options))


@overload
def plan_by_method(query: PlacementQuery, /) -> PlacementResult: ...
@overload
def plan_by_method(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer | None = None,
    **options: Unpack[QueryOptions],
) -> PlacementResult: ...
def plan_by_method(scene: Any, *rest: Any, **options: Any) -> PlacementResult:
    """Answer as `plan_base_placement` does, by the method that `config.place.method` names.

    The method decides in which order base poses are tried; the same check judges each of them and
    returns the motion. "Infeasible" from a method other than ours means that it gave up.

    Args:
        scene: The scene; or a `PlacementQuery` and nothing else.
        rest: Robot, task, and its reachability map, which is loaded by default.
        options: Keywords of `PlacementQuery.of`.

    Raises:
        InputError: An argument is wrong.
        SceneError: The robot collides at its start pose.
        TaskError: The gripper cannot hold the object.
    """
    return plan_with_method(as_query(scene, rest, options))


@overload
def iter_placements(query: PlacementQuery, /) -> Iterator[PlacementResult]: ...
@overload
def iter_placements(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer | None = None,
    **options: Unpack[QueryOptions],
) -> Iterator[PlacementResult]: ...
def iter_placements(scene: Any, *rest: Any, **options: Any) -> Iterator[PlacementResult]:
    """Yield one answer after the other: where the robot may stand, and how it moves.

    The first answer is that of `plan_base_placement`. The others come in rounds, each ordered by
    driving length; all objects are modeled for them, and each does the task with one grasp. The
    iteration ends if no base pose is left or after `config.timeout`; the time that the caller
    spends between two answers does not count.

    Args:
        scene: The scene; or a `PlacementQuery` and nothing else.
        rest: Robot, task, and its reachability map, which is loaded by default.
        options: Keywords of `PlacementQuery.of`.

    Yields:
        Solved answers; none if the task is infeasible.

    Raises:
        InputError: An argument is wrong, or the task requests the maximum.
        SceneError: The robot collides at its start pose.
        TaskError: The gripper cannot hold the object.
    """
    return placements(as_query(scene, rest, options))


@overload
def check_base_pose(
    query: PlacementQuery, base_pose: BasePose, /, *, how_far: bool = True
) -> Attempt: ...
@overload
def check_base_pose(
    scene: Scene,
    robot: Robot,
    task: Task,
    base_pose: BasePose,
    reach: ReachScorer | None = None,
    *,
    how_far: bool = True,
    **options: Unpack[QueryOptions],
) -> Attempt: ...
def check_base_pose(scene: Any, *rest: Any, how_far: bool = True, **options: Any) -> Attempt:
    """Plan the arm's motion at one base pose, or return why there is none and how far it goes.

    All grasps are tried, and every object of the scene is modeled. Driving there is not checked.

    Args:
        scene: The scene; or a `PlacementQuery`.
        rest: Robot, task, base pose x [m], y [m], yaw [rad], and the reachability map, which is
            loaded by default; after a query, the base pose alone.
        how_far: Whether to find the largest joint value that works, to a degree or a centimeter,
            if the task's value does not.
        options: Keywords of `PlacementQuery.of`.

    Returns:
        A motion that passes the exact check, or why there is none; and the largest value that
        works. A task that requests the maximum gets the motion to that value.

    Raises:
        InputError: An argument is wrong, such as a base pose that is not three finite numbers.
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
    """
    query, base_pose = _with_pose(scene, rest, options)
    return check_pose(query, base_pose, how_far=how_far)


@overload
def placement_tolerance(
    query: PlacementQuery, base_pose: BasePose, /, *, samples: int = SAMPLES
) -> Tolerance: ...
@overload
def placement_tolerance(
    scene: Scene,
    robot: Robot,
    task: Task,
    base_pose: BasePose,
    reach: ReachScorer | None = None,
    *,
    samples: int = SAMPLES,
    **options: Unpack[QueryOptions],
) -> Tolerance: ...
def placement_tolerance(
    scene: Any, *rest: Any, samples: int = SAMPLES, **options: Any
) -> Tolerance:
    """Find the largest disc and turn around a base pose in which replanning succeeds.

    Replanning is tried from poses drawn evenly in a disc, turned by at most 0.6 deg per cm of its
    radius. A disc of 5 mm to 15 cm counts if replanning succeeds from all of them, and each motion
    passes the exact check.

    Args:
        scene: The scene; or a `PlacementQuery`.
        rest: As of `check_base_pose`.
        samples: Number of poses in a disc [-].
        options: Keywords of `PlacementQuery.of`.

    Raises:
        InputError: An argument is wrong.
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
    """
    query, base_pose = _with_pose(scene, rest, options)
    return tolerance_at(query, base_pose, samples=samples)


def plan_tour(
    scene: Scene,
    robot: Robot,
    requests: Sequence[Request],
    reach: ReachScorer | None = None,
    **options: Unpack[QueryOptions],
) -> Tour:
    """Return where the robot must stand to do several tasks one after the other.

    Each task begins in the scene as the one before has left it, with the arm at home: after each
    task but the last the hand lets go, draws back, and the arm goes home. As many tasks as one base
    pose serves are done from it, then as many of the rest: the fewest stops that the search finds.

    A picked object stays in the model where it was, so that later tasks keep clear of it, and the
    hand counts as free: see `Tour.assumed`.

    Args:
        scene: The scene.
        robot: The mobile manipulator.
        requests: The tasks, each to a value, not as far as possible.
        reach: The robot's reachability map; None to load it, or to build it at first use.
        options: Keywords of `PlacementQuery.of`; `config.timeout` is for the whole tour.

    Raises:
        InputError: An argument is wrong.
        TaskError: A request makes no sense in the scene at its turn, or there are too many.
        SceneError: The robot collides at its start pose.
        UnknownNameError: There is no such object or joint.
    """
    expect("scene", scene, Scene, "load_scene reads one")
    if isinstance(requests, str) or not isinstance(requests, Sequence):
        raise InputError("requests must be a sequence of Request(verb, object, joint, to)")
    tasks = [_request(one) for one in requests]
    if not tasks:
        raise TaskError(f"a tour has 1 to {MAX_TASKS} tasks, not 0")
    first = make_task(scene, *expanded(tasks, scene)[0])
    return plan_chain(as_query(scene, (robot, first, reach), options), tasks)


def plan_reach(
    scene: Scene,
    robot: Robot,
    poses: Sequence[ToolPose],
    reach: ReachScorer | None = None,
    *,
    in_order: bool = False,
    **options: Unpack[QueryOptions],
) -> Tour:
    """Return where the robot must stand to bring its tool to a set of poses, and how it moves.

    The fewest stops that the search finds, of these with a short drive, and an order of the poses
    at each with little motion of the arm.

    Args:
        scene: The scene.
        robot: The mobile manipulator.
        poses: The poses, see `load_poses`.
        reach: The robot's reachability map; None to load it, or to build it at first use.
        in_order: Whether the poses must be reached in this order.
        options: Keywords of `PlacementQuery.of`; `config.timeout` is for the whole answer.

    Returns:
        One answer for each stop, whose task has the poses that are reached there, in their order.
        A last one without a plan has the poses that no base pose serves.

    Raises:
        InputError: An argument is wrong.
        RobotError: The arm has fewer than six joints.
        SceneError: The robot collides at its start pose.
        UnknownNameError: A pose touches an object that does not exist.
        OutOfTimeError: The time was over.
    """
    expect("scene", scene, Scene, "load_scene reads one")
    if isinstance(poses, str) or not isinstance(poses, Sequence) or not poses:
        raise InputError("poses must be a sequence of ToolPose; load_poses reads one from a file")
    for k, one in enumerate(poses):
        expect(f"poses[{k}]", one, ToolPose)
    task = Task("reach", "", poses=tuple(poses))
    return plan_pose_stops(as_query(scene, (robot, task, reach), options), in_order=in_order)


def plan_follow(
    scene: Scene,
    robot: Robot,
    path: ToolPath,
    reach: ReachScorer | None = None,
    **options: Unpack[QueryOptions],
) -> Tour:
    """Return where the robot must stand to move its tool along a path, and how it moves.

    From one base pose if one serves the whole path, else from few that each serve a stretch between
    two breaks of the path, else while the base moves, if `config.base` allows that.

    Args:
        scene: The scene.
        robot: The mobile manipulator.
        path: The path, see `load_path`.
        reach: The robot's reachability map; None to load it, or to build it at first use.
        options: Keywords of `PlacementQuery.of`; `config.timeout` is for the whole answer.

    Returns:
        One answer for each stretch; a last one without a plan is for the first stretch that no base
        pose serves.

    Raises:
        InputError: An argument is wrong, or the path jumps.
        SceneError: The robot collides at its start pose.
        UnknownNameError: The path touches an object that does not exist.
        OutOfTimeError: The time was over.
    """
    expect("scene", scene, Scene, "load_scene reads one")
    expect("path", path, ToolPath, "load_path reads one")
    task = Task("follow", "", poses=path.poses, speed=path.speed)
    return plan_path_stops(as_query(scene, (robot, task, reach), options), path.breaks)


def _request(value: object) -> Request:
    if not isinstance(value, tuple) or not 2 <= len(value) <= 4:
        raise InputError(f"requests must hold Request(verb, object, joint, to), not {value!r:.60}")
    request = Request(*value)
    expect("Request.verb", request.verb, str)
    return request


def _with_pose(scene: Any, rest: tuple[Any, ...], options: Any) -> tuple[PlacementQuery, Any]:
    """Return the query, and the base pose among its parts."""
    options = dict(options)
    at = 0 if isinstance(scene, PlacementQuery) else 2
    if "base_pose" in options:
        base_pose = options.pop("base_pose")
    elif len(rest) > at:
        base_pose, rest = rest[at], rest[:at] + rest[at + 1 :]
    else:
        raise InputError("base_pose is needed: x [m], y [m], yaw [rad]")
    return as_query(scene, rest, options), base_pose
