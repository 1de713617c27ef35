"""Collision checks of an object in the hand, and the boxes near a motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import apply, halton, invert
from momapos.model.collision import (
    FREE,
    CollisionWorld,
    Spheres,
    Upright,
    base_hits,
    box_spheres,
    build_motions,
    build_world,
    carry,
    check,
    place_segments,
)
from momapos.model.kinematics import chain_arrays
from momapos.model.records import Motion
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes, MovingBoxes
from momapos.planning.grasps import TaskMotion

from .arm_planner import UPRIGHT_SHARE, level_states
from .ik_layers import TaskLoads

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


SAMPLES = 2048
"""Number of arm states among which those that can carry an object are sought [-]."""
LEVEL_RADII = (0.3, 0.6, 1.0, 2.0, 3.0)
"""Largest differences of joints from home among which such a state is sought [rad] or [m]."""
MAX_HOMES, HOME_SPREAD = 6, 1.0
"""Number of states other than home in which an object is carried [-], and how far some joint of one
is from that of another [rad] or [m]."""
LEVEL_SHARE = 0.95
"""Share of the allowed tilt that plans use: between states of a path it may be larger [-]."""
WRIST = 3
"""Number of the last joints; in half of the samples only these differ from home [-]."""


def with_payload(
    robot: Robot, motion: TaskMotion, T_world_tool: Float[np.ndarray, "4 4"], step: int
) -> Spheres:
    """Return the robot's spheres with the object in its hand.

    Args:
        robot: The robot.
        motion: The task motion.
        T_world_tool: Tool pose at a step at which the hand holds the object.
        step: That step of the motion.
    """
    chain = robot.chain
    center, radius = _object_spheres(motion, step)
    in_tool = apply(invert(T_world_tool), center)
    return carry(
        robot.spheres.by_hulls,
        chain.last,
        chain.tool_offset + in_tool @ chain.tool_rotation.T,
        radius,
    )


def _object_spheres(
    motion: TaskMotion, step: int
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """Return the moved object's spheres in the world at a step of the motion [m]."""
    return box_spheres(motion.moving.at(int(motion.value[step])))


def payload_hits_at_home(robot: Robot, motion: TaskMotion) -> Int[np.ndarray, " g"]:
    """Find what an object in the hand touches on the robot with its arm at home, for each grasp.

    Returns:
        An index of a group of the robot's spheres, the number of groups for the base, or -1.
    """
    chain, spheres, step = robot.chain, robot.spheres, motion.grasp_step
    center, radius = _object_spheres(motion, step)
    in_tool = np.linalg.inv(motion.Ts_world_tool[:, step])
    Ts = chain.tool_poses(robot.home[None])[0] @ in_tool
    points = np.einsum("gij,kj->gki", Ts[:, :3, :3], center) + Ts[:, None, :3, 3]
    touched = np.full(len(points), -1)
    R, p = np.empty((chain.last + 1, 3, 3)), np.empty((chain.last + 1, 3))
    place_segments(robot.home, np.zeros(3), chain_arrays(chain), R, p)
    for k, segment in enumerate(spheres.segment):
        if segment == chain.last:
            continue
        rows = slice(spheres.start[k], spheres.start[k + 1])
        links = spheres.center[rows] @ R[segment].T + p[segment]
        gap = np.linalg.norm(points[:, :, None] - links, axis=-1) - radius[:, None]
        touched[(gap < spheres.radius[rows]).any((1, 2))] = k
    touched[_meets_base(robot, points, radius)] = len(spheres.segment)
    return touched


def _meets_base(
    robot: Robot, points: Float[np.ndarray, "g k 3"], radius: Float[np.ndarray, " k"]
) -> Bool[np.ndarray, " g"]:
    """Check which sets of spheres at points in the base frame touch the base."""
    base = robot.base
    local = np.abs(np.einsum("bij,gkbi->gkbj", base.rotation, points[:, :, None] - base.center))
    apart = np.linalg.norm(np.maximum(local - base.half, 0.0), axis=-1)
    return np.asarray((apart < radius[:, None]).any((1, 2)))


@owner_cache(64)
def carrying_homes(robot: Robot, motion: TaskMotion, grasp: int) -> Float[np.ndarray, "k n"]:
    """Return the arm states in which a robot drives with an object in a grasp, before or after.

    That is home. Where the object touches the robot there, or must stay level and is not, these are
    states that are free and level, each the nearest to home among those around it: an elbow may
    have to be up in one and down in another to get there.

    Args:
        robot: The robot.
        motion: The task motion, which picks the object up or places it.
        grasp: The grasp.
    """
    upright, home, chain = upright_of(robot, motion, grasp), robot.home, robot.chain
    if upright is None and _free_at_home(robot, motion)[grasp]:
        return home[None]
    low = np.where(np.isfinite(chain.lower), chain.lower, home - np.pi)
    high = np.where(np.isfinite(chain.upper), chain.upper, home + np.pi)
    spread = 2.0 * halton(SAMPLES, chain.size) - 1.0
    reach = np.repeat(LEVEL_RADII, -(-SAMPLES // len(LEVEL_RADII)))[:SAMPLES, None]
    q = np.clip(home + reach * spread, low, high)
    q[0] = home
    step = motion.grasp_step
    spheres = with_payload(robot, motion, motion.Ts_world_tool[grasp, step], step)
    empty = build_world(Boxes.join([]), _NOTHING, np.zeros(0, bool), [], spheres, clearance=0.0)
    if upright is not None:
        straight = build_motions(
            empty, chain, spheres, np.zeros(3), value=0, holding=True, step=1.0, upright=upright
        )
        q = level_states(q, low, high, straight.arrays)
        up = chain.tool_poses(q)[:, 2, :3] @ (chain.tool_rotation.T @ upright.axis)
        q = q[up >= 1.0 - UPRIGHT_SHARE * (1.0 - upright.cosine) - 1e-9]
    q = q[np.argsort(np.linalg.norm(q - home, axis=1), kind="stable")]
    none = np.zeros(len(q), np.int64)
    q = q[check(empty, chain, spheres, q, np.zeros((len(q), 3)), none, none == 0) == FREE]
    center, radius = _object_spheres(motion, step)
    in_tool = apply(invert(motion.Ts_world_tool[grasp, step]), center)
    q = q[~_meets_base(robot, apply(chain.tool_poses(q), in_tool), radius)]
    if len(q):
        q = q[~TaskLoads(robot, motion).free(q, (grasp, step)).refused]
    chosen = q[:0]
    while len(q) and len(chosen) < MAX_HOMES:
        chosen = np.concatenate([chosen, q[:1]])
        q = q[np.abs(q - q[0]).max(1) > HOME_SPREAD]
    return chosen


@owner_cache()
def _free_at_home(robot: Robot, motion: TaskMotion) -> Bool[np.ndarray, " g"]:
    return payload_hits_at_home(robot, motion) < 0


def carried_at_home(robot: Robot, motion: TaskMotion) -> Bool[np.ndarray, " g"]:
    """Return in which grasps the arm can carry an object at home itself."""
    free = _free_at_home(robot, motion)
    if motion.task.level is None:
        return free
    up = motion.Ts_world_tool[:, motion.grasp_step, 2, :3]
    level = up @ robot.chain.tool_poses(robot.home[None])[0, 2, :3]
    return np.asarray(free & (level >= np.cos(LEVEL_SHARE * motion.task.level)))


def upright_of(robot: Robot, motion: TaskMotion, grasp: int) -> Upright | None:
    """Return how upright the hand stays with the object of a task in a grasp; None for any tilt."""
    level = motion.task.level
    if level is None:
        return None
    up = motion.Ts_world_tool[grasp, motion.grasp_step, 2, :3]
    return Upright(robot.chain.tool_rotation @ up, float(np.cos(LEVEL_SHARE * level)))


def carrying_states(
    robot: Robot,
    world: CollisionWorld,
    motion: TaskMotion,
    grasp: int,
    base: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "k n"]:
    """Return sampled arm states in which a robot can carry an object, and begin to drive.

    Robot and object are free of collision with each other and with the scene, and the motors and
    the base bear the object.

    Args:
        robot: The robot.
        world: The scene.
        motion: The task motion, which places the object.
        grasp: The grasp.
        base: Where the robot begins to drive: x [m], y [m], yaw [rad].
    """
    chain = robot.chain
    low = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    high = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    q = low + halton(SAMPLES, chain.size) * (high - low)
    q[1::2, :-WRIST] = robot.home[:-WRIST]
    spheres = with_payload(robot, motion, motion.Ts_world_tool[grasp, 0], 0)
    codes = check(
        world, chain, spheres, q, np.tile(base, (len(q), 1)), np.full(len(q), motion.value[0]),
        np.ones(len(q), bool),
    )  # fmt: skip
    q = q[codes == FREE]
    return q[~TaskLoads(robot, motion).free(q, (grasp, 0)).refused] if len(q) else q


_ORIGIN = np.zeros((1, 3))
_NOTHING = MovingBoxes(np.zeros((1, 0, 3)), np.zeros((1, 0, 3, 3)), np.zeros((1, 0, 3)))


def boxes_near_swept_volume(
    motion: TaskMotion, boxes: Boxes, *, margin: float
) -> Bool[np.ndarray, " b"]:
    """Find the boxes (world frame) within a margin [m] of the moving part, for any robot."""
    sweep = motion.sweep()
    return _every(boxes, lambda left: base_hits(_ORIGIN, sweep, left, clearance=margin))


def boxes_near_base(
    robot: Robot, base: Float[np.ndarray, "3"], boxes: Boxes, *, margin: float
) -> Bool[np.ndarray, " b"]:
    """Find the boxes within a margin [m] of the base at x [m], y [m], yaw [rad]."""
    return _every(boxes, lambda left: base_hits(base[None], robot.base, left, clearance=margin))


def near_boxes(
    robot: Robot,
    motion: TaskMotion,
    base: Float[np.ndarray, "3"],
    found: Motion,
    boxes: Boxes,
    *,
    margin: float,
) -> Bool[np.ndarray, " b"]:
    """Find the boxes near a planned motion; collision spheres stand for the arm.

    Args:
        robot: The robot.
        motion: The task motion.
        base: Base pose x [m], y [m], yaw [rad].
        found: The planned motion.
        boxes: In the world frame.
        margin: Distance up to which a box is near [m].
    """
    home = found.q[:0] if found.home is None else found.home
    q = np.concatenate([found.approach, found.q, home])
    bases, none = np.tile(base, (len(q), 1)), np.zeros(len(q), np.int64)
    spheres = robot.spheres
    if motion.task.verb == "place":
        spheres = with_payload(robot, motion, found.Ts_world_tool[0], motion.grasp_step)

    def arm_hits(left: Boxes) -> Int[np.ndarray, " m"]:
        labels, free = [""] * len(left), np.zeros(0, bool)
        world = build_world(left, _NOTHING, free, labels, spheres, clearance=margin)
        return check(world, robot.chain, spheres, q, bases, none, none > 0)

    return (
        boxes_near_base(robot, base, boxes, margin=margin)
        | boxes_near_swept_volume(motion, boxes, margin=margin)
        | _every(boxes, arm_hits)
    )


def _every(
    boxes: Boxes, first_hits: Callable[[Boxes], Int[np.ndarray, " m"]]
) -> Bool[np.ndarray, " b"]:
    """Find all boxes that are hit, using a check that reports only the first hit."""
    left = np.arange(len(boxes))
    while len(left):
        codes = first_hits(boxes.take(left))
        hit = np.unique(codes[codes >= 0])
        if not len(hit):
            break
        left = np.delete(left, hit)
    return ~np.isin(np.arange(len(boxes)), left)
