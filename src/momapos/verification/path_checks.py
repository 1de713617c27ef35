"""Check a motion without collision geometry: numbers, times, joints, base, tool, grasps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert, rotation_about, rotation_angle, wrap_angle
from momapos.model import deviation
from momapos.model.records import Hold, Motion, Task, ToolPose

from .link_bodies import following
from .moved_part import MovedPart
from .report import Check, Limits, at_most, verdict
from .robot_collision_model import RobotCollisionModel

if TYPE_CHECKING:
    from jaxtyping import Float, Int


MAX_STEP_BACK = 1e-6
"""Largest backward step of the object's joint [rad] or [m]."""
MAX_FREE_MOTION = 1e-9
"""Largest motion of the object's joint while nothing holds it [rad] or [m]."""
MAX_MAGNITUDE = 1e6
"""Larger numbers are treated as errors."""
MAX_RIGIDITY_ERROR = 1e-3
"""Largest error of a tool pose as a rigid transform, per matrix entry [-]."""

NOTED_DEVIATION = 0.003
"""By how much the curve that is executed may leave the straight motions between states without a
note; our plans allow a third of it [rad] or [m]."""


@dataclass(frozen=True, eq=False)
class DensePath:
    """A motion, approach first, interpolated so that no step exceeds the limit."""

    q: Float[np.ndarray, "s n"]
    object_q: Float[np.ndarray, " s"]
    at: Float[np.ndarray, " s"]
    """Fractional index of each state in the plan."""
    approach: int
    """Number of states in the approach."""
    latch_q: Float[np.ndarray, " s"] | None = None
    """Value of the latch [rad] or [m]; None if no latch is turned."""
    base: Float[np.ndarray, "s 3"] | None = None
    """x [m], y [m], yaw [rad] of the base at each state; None if it stands still."""

    @property
    def planned(self) -> Int[np.ndarray, " m"]:
        """Return the indices of the manipulation states that are in the plan itself."""
        held = np.arange(self.approach, len(self.at))
        return np.asarray(held[self.at[held] == np.floor(self.at[held])])

    def where(self, state: int) -> str:
        """Describe a state by its index in the plan."""
        part = "approach" if state < self.approach else "manipulation"
        return f"{part} state {self.at[state]:.2f}"


def from_grasp(motion: Motion) -> Float[np.ndarray, "s n"]:
    """Return the arm states of the manipulation and of the path home after it."""
    return motion.q if motion.home is None else np.concatenate([motion.q, motion.home])


def _coordinates(motion: Motion) -> Float[np.ndarray, "s c"]:
    """Return what moves from the grasp on: the arm and, with a moving base, base and part.

    Base and part rest during the path home.
    """
    q = from_grasp(motion)
    if motion.base is None:
        return q
    others = np.column_stack([motion.base, motion.object_q])
    rest = np.tile(others[-1], (len(q) - len(others), 1))
    return np.column_stack([q, np.concatenate([others, rest])])


def home_checks(task: Task, motion: Motion, limits: Limits) -> Iterator[Check]:
    """Check that the path home ends where the approach starts, unless the hand carries an object.

    The arm carries it on one of the two, in a state in which it is free, and level if it must be.
    """
    if motion.home is not None and len(motion.approach) and task.verb not in ("pick", "place"):
        gap = np.abs(motion.home[-1] - motion.approach[0]).max()
        yield at_most("path home ends where the approach starts", gap, limits.join, "rad|m")


def level_checks(
    task: Task, path: DensePath, Ts_world_body: Float[np.ndarray, "s b 4 4"], limits: Limits
) -> Iterator[Check]:
    """Check that the object of a task stays as level as the task asks for.

    Args:
        task: The task.
        path: The interpolated states.
        Ts_world_body: Pose of the object at each, as its only body.
        limits: Allowed excess of the tilt, that of a joint limit.
    """
    if task.level is None:
        return
    R = Ts_world_body[:, 0, :3, :3]
    standing = R[-1] if task.verb == "place" else R[0]
    tilt = np.arccos(np.clip((R @ standing.T)[:, 2, 2], -1.0, 1.0))
    worst = int(tilt.argmax())
    most, found = (f"{math.degrees(value):.0f} deg" for value in (task.level, tilt[worst]))
    yield at_most(
        "object in the hand is level (excess)", tilt[worst] - task.level, limits.joint, "rad",
        f"{path.where(worst)}: {found} of {most}",
    )  # fmt: skip


def count_states(motion: Motion, step: float) -> float:
    """Return how many states `dense_path` would have."""
    both = motion.approach, _coordinates(motion)
    return float(sum(_pieces(q, step).sum() + 1 for q in both if len(q)))


def count_cuts(values: Float[np.ndarray, " s"], step: float, least: int) -> float:
    """Return into how many intervals to divide a joint's path; a multiple of `least`."""
    return float(max(1.0, np.ceil(np.ptp(values) / step / least)) * least)


def dense_path(motion: Motion, step: float) -> DensePath:
    """Interpolate states so that no joint moves more than a step [rad] or [m].

    A moving base, and the part that moves with it, don't move more either. The object's joint rests
    during the path home.
    """
    whole, at = _densify(_coordinates(motion), step)
    q, base = whole[:, : motion.q.shape[1]], None
    before, at_before = q[:0], at[:0]
    if len(motion.approach):
        before, at_before = _densify(motion.approach, step)

    def along(values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " s"]:
        held = np.interp(at, np.arange(len(values)), values)
        return np.concatenate([np.full(len(before), values[0]), held])

    if motion.base is not None:
        first = np.tile(motion.base[0], (len(before), 1))
        base = np.concatenate([first, whole[:, q.shape[1] :][:, :3]])
    return DensePath(
        q=np.concatenate([before, q]),
        object_q=along(motion.object_q),
        at=np.concatenate([at_before, at]),
        approach=len(before),
        latch_q=None if motion.latch_q is None else along(motion.latch_q),
        base=base,
    )


def curve_notes(motion: Motion) -> Iterator[str]:
    """Note where the executed curve leaves the straight motions between states, as checked."""
    for phase, q in (("approach", motion.approach), ("manipulation", motion.q)):
        off = float(deviation(q).max(initial=0.0))
        if off > NOTED_DEVIATION:
            yield (
                f"between states of the {phase}, a spline gets up to {off:.3f} rad or m off the "
                "straight motions, which are checked; states closer together prevent it"
            )


def _pieces(q: Float[np.ndarray, "s n"], step: float) -> Float[np.ndarray, " t"]:
    largest = np.abs(np.diff(q, axis=0)).max(1, initial=0.0)
    return np.asarray(np.maximum(1.0, np.ceil(largest / step - 1e-9)))


def _densify(
    q: Float[np.ndarray, "s n"], step: float
) -> tuple[Float[np.ndarray, "t n"], Float[np.ndarray, " t"]]:
    pieces = _pieces(q, step).astype(np.int64)
    segment = np.repeat(np.arange(len(pieces)), pieces)
    within = np.arange(len(segment)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    share = within / pieces[segment]
    states = q[segment] + (q[segment + 1] - q[segment]) * share[:, None]
    return np.vstack([states, q[-1:]]), np.append(segment + share, len(q) - 1.0)


def part_poses(
    part: MovedPart, verb: str, path: DensePath, Ts_world_tool: Float[np.ndarray, "s 4 4"]
) -> Float[np.ndarray, "s b 4 4"]:
    """Return world poses of the part's bodies along a path: by its joint, or as it is carried.

    A picked object is carried from the start of the manipulation on, a placed one until then.
    """
    if part.joint is not None:
        return part.poses(path.object_q, path.latch_q)
    Ts = part.poses(np.zeros(len(path.q)))
    carried = slice(path.approach) if verb == "place" else slice(path.approach, None)
    T_tool_part = invert(Ts_world_tool[path.approach]) @ Ts[path.approach, 0]
    Ts[carried, 0] = Ts_world_tool[carried] @ T_tool_part
    return Ts


def number_checks(
    part: MovedPart, motion: Motion, base_pose: tuple[float, float, float]
) -> Iterator[Check]:
    """Check that the arrays fit together and are finite; the other checks rely on this."""
    lengths = [len(motion.q), len(motion.Ts_world_tool), len(motion.object_q)]
    least = 1 if part.joint is None else 2
    yield verdict(
        f"q, object_q, T_world_tool have equal length >= {least}",
        min(lengths) == max(lengths) >= least,
        str(lengths),
    )
    extra = tuple(a for a in (motion.home, motion.latch_q, motion.base) if a is not None)
    if motion.home is not None:
        yield verdict("path home is not empty", len(motion.home) > 0)
    arrays = (motion.q, motion.approach, motion.object_q, motion.Ts_world_tool, *extra)
    largest = max(float(np.abs(a).max(initial=0.0)) for a in (*arrays, np.array(base_pose)))
    finite = all(np.isfinite(array).all() for array in (*arrays, np.array(base_pose)))
    yield verdict("numbers are finite", finite and largest < MAX_MAGNITUDE, f"largest {largest:g}")


def verb_checks(part: MovedPart, verb: str) -> Iterator[Check]:
    """Check that the task moves its part away from where it is closed, or toward it."""
    if part.joint is None or verb == "press":
        return
    opens = abs(part.goal - part.rest) > abs(part.start - part.rest)
    found = f"from {part.start:.4g} to {part.goal:.4g}, closed at {part.rest:.4g}"
    yield verdict(f"the task's values {verb} the part", opens == (verb == "open"), found)


def object_checks(part: MovedPart, motion: Motion, limits: Limits) -> Iterator[Check]:
    """Check that the object's joint reaches the task's value without moving backward."""
    if part.joint is None:
        return
    values, span = motion.object_q, part.goal - part.start
    slack = limits.goal * max(abs(span), 1e-9)
    yield at_most(
        "object starts at the scene's value", abs(values[0] - part.start), slack, "rad|m",
        f"{values[0]:.4f}, scene {part.start:.4f}",
    )  # fmt: skip
    yield at_most(
        "object ends at task.to", abs(values[-1] - part.goal), slack, "rad|m",
        f"{values[-1]:.4f}, task {part.goal:g}",
    )  # fmt: skip
    back = float((-np.sign(span) * np.diff(values)).max(initial=0.0))
    yield at_most("object moves monotonically (largest step back)", back, MAX_STEP_BACK, "rad|m")
    excess = max(part.joint.lower - values.min(), values.max() - part.joint.upper, 0.0)
    yield at_most("object within its joint limits (excess)", excess, limits.joint, "rad|m")


def joint_checks(robot: RobotCollisionModel, motion: Motion, limits: Limits) -> Iterator[Check]:
    """Check that the arm's states are within limits and connected."""
    held = from_grasp(motion)
    both = np.vstack([motion.approach, held])
    excess = np.maximum(robot.lower - both, both - robot.upper).max(0)
    worst = robot.joints[int(excess.argmax())]
    yield at_most(
        "joint limits (excess)", max(0.0, excess.max()), limits.joint, "rad|m", worst, worst
    )
    yield from _mimic_checks(robot, both, limits)
    if len(held) > 1:
        steps = np.abs(np.diff(held, axis=0))
        state, joint = np.unravel_index(int(steps.argmax()), steps.shape)
        yield at_most(
            "largest step of the manipulation", steps.max(), limits.jump, "rad|m",
            f"state {state}, {robot.joints[joint]}", robot.joints[joint],
        )  # fmt: skip
    yield verdict("approach present", len(motion.approach) > 0)
    if len(motion.approach):
        gap = np.abs(motion.approach[-1] - motion.q[0]).max()
        yield at_most("approach ends where the manipulation starts", gap, limits.join, "rad|m")


def _mimic_checks(
    robot: RobotCollisionModel, states: Float[np.ndarray, "m n"], limits: Limits
) -> Iterator[Check]:
    """Check that mimic joints follow their leaders as in the URDF."""
    column = {name: i for i, name in enumerate(robot.joints)}
    errors: dict[str, float] = {}
    for joint in robot.bodies.joints:
        if joint is None or joint.mimic is None or joint.name not in column:
            continue
        if joint.mimic.joint in column:
            there = following(joint.mimic, states[:, column[joint.mimic.joint]])
            errors[joint.name] = float(np.abs(states[:, column[joint.name]] - there).max())
    if errors:
        worst = max(errors, key=errors.__getitem__)
        yield at_most(
            "mimic joints follow their leaders", errors[worst], limits.joint, "rad|m", worst, worst
        )


def tool_checks(
    Ts_world_tool: Float[np.ndarray, "m 4 4"], motion: Motion, limits: Limits
) -> Iterator[Check]:
    """Check that the plan's tool poses match its joint values."""
    planned = motion.Ts_world_tool
    apart = np.linalg.norm(Ts_world_tool[:, :3, 3] - planned[:, :3, 3], axis=1)
    angle = rotation_angle(Ts_world_tool[:, :3, :3], planned[:, :3, :3])
    yield at_most(
        "FK position against T_world_tool", 1000 * apart.max(), 1000 * limits.fk_position, "mm",
        f"state {int(apart.argmax())}",
    )  # fmt: skip
    yield at_most(
        "FK rotation against T_world_tool", math.degrees(angle.max()),
        math.degrees(limits.fk_rotation), "deg", f"state {int(angle.argmax())}",
    )  # fmt: skip
    R = planned[:, :3, :3]
    off = max(
        np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(),
        np.abs(np.linalg.det(R) - 1.0).max(),
        np.abs(planned[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(),
    )
    yield at_most("T_world_tool is a rigid transform", off, MAX_RIGIDITY_ERROR)


def hold_checks(part: MovedPart, motion: Motion) -> Iterator[Check]:
    """Check that holds are ordered state ranges and that the part rests between them."""
    if not motion.holds or part.joint is None:
        return
    ends = np.array([(hold.first, hold.last) for hold in motion.holds])
    order = np.concatenate([[-1], ends.ravel(), [len(motion.q)]])
    fits = (np.diff(order)[::2] > 0).all() and (ends[:, 0] <= ends[:, 1]).all()
    axes = np.array([hold.turn_axis for hold in motion.holds if hold.turn_axis is not None], float)
    unit = np.isfinite(axes).all() and np.allclose(np.linalg.norm(axes.reshape(-1, 3), axis=1), 1.0)
    yield verdict("holds are ordered state ranges with unit axes", bool(fits and unit))
    if not fits:
        return
    held = np.zeros(max(len(motion.q) - 1, 0), bool)
    for first, last in ends:
        held[first:last] = True
    loose = np.abs(np.diff(motion.object_q))[~held]
    name = "object moves while nothing holds it"
    yield at_most(name, loose.max(initial=0.0), MAX_FREE_MOTION, "rad|m")


def grasp_checks(
    part: MovedPart,
    path: DensePath,
    Ts_world_tool: Float[np.ndarray, "s 4 4"],
    holds: tuple[Hold, ...],
    limits: Limits,
) -> Iterator[Check]:
    """Check that the tool keeps its pose in the part while it holds it.

    Of a part of several bodies it holds the nearest one, or the latch that it turns. It may turn
    about the hold's axis, which is fixed in that body. Tool poses are those of the dense path.
    """
    if part.joint is None:
        return
    states, slips, turns = [], [], []
    for hold in holds:
        inside = (path.at >= hold.first) & (path.at <= hold.last)
        inside[: path.approach] = False
        held = np.flatnonzero(inside)
        if part.latch is not None and hold.first == 0:
            body = part.latch.body
        else:
            body = part.nearest_body(Ts_world_tool[held[0], :3, 3], float(path.object_q[held[0]]))
        latch_q = None if path.latch_q is None else path.latch_q[held]
        T = invert(part.poses(path.object_q[held], latch_q)[:, body]) @ Ts_world_tool[held]
        states.append(held)
        slips.append(np.linalg.norm(T[:, :3, 3] - T[0, :3, 3], axis=1))
        turns.append(_swing_angles(T[:, :3, :3], hold.turn_axis))
    state, slip, turn = (np.concatenate(values) for values in (states, slips, turns))
    yield at_most(
        "grasp slips: translation in the moved part", 1000 * slip.max(),
        1000 * limits.slip_position, "mm", path.where(int(state[slip.argmax()])),
    )  # fmt: skip
    yield at_most(
        "grasp slips: rotation in the moved part", math.degrees(turn.max()),
        math.degrees(limits.slip_rotation), "deg", path.where(int(state[turn.argmax()])),
    )  # fmt: skip


def _swing_angles(
    R: Float[np.ndarray, "s 3 3"], axis: tuple[float, float, float] | None
) -> Float[np.ndarray, " s"]:
    """Return the angle from the first rotation to each, without the twist about the axis."""
    if axis is None:
        return np.asarray(rotation_angle(R[:1], R))
    M, a = R @ R[0].T, np.array(axis)
    sine = np.stack([M[:, 2, 1] - M[:, 1, 2], M[:, 0, 2] - M[:, 2, 0], M[:, 1, 0] - M[:, 0, 1]], 1)
    # Half angles: w = cos(t / 2) and n sin(t / 2) of the quaternion, both times 4 w.
    twist = 2.0 * np.arctan2(sine @ a, 1.0 + np.trace(M, axis1=1, axis2=2))
    return np.asarray(rotation_angle(rotation_about(a, twist) @ R[0], R))


def pose_checks(
    poses: Sequence[ToolPose], motion: Motion, Ts_world_tool: Float[np.ndarray, "m 4 4"]
) -> Iterator[Check]:
    """Check that the tool is at each requested pose, within its tolerance, in one hold each.

    Args:
        poses: What the task requests.
        motion: Its holds are the states at the poses, in their order.
        Ts_world_tool: Tool poses at the states of the manipulation, by the robot's kinematics.
    """
    at = [hold.first for hold in motion.holds]
    in_order = all(0 <= a < b for a, b in pairwise([*at, len(motion.q)]))
    met = len(at) == len(poses) and in_order
    yield verdict("one hold for each pose", met, f"{len(at)} holds, {len(poses)} poses")
    if not met:
        return
    rows = zip(poses, Ts_world_tool[at], strict=True)
    excess = np.array([one.excess(T[None])[0] for one, T in rows])
    for name, column, scale, unit in (
        ("position", 0, 1e3, "mm"),
        ("rotation", 1, 180 / np.pi, "deg"),
    ):
        worst = int(excess[:, column].argmax())
        most = scale * max(float(excess[worst, column]), 0.0)
        where = (poses[worst].name or f"pose {worst + 1}") if most > 0.0 else ""
        yield at_most(f"tool beyond the tolerance in {name}", most, 0.0, unit, where, where)


def follow_checks(
    task: Task, motion: Motion, path: DensePath, Ts_world_tool: Float[np.ndarray, "s 4 4"],
    limits: Limits,
) -> Iterator[Check]:  # fmt: skip
    """Check that the tool keeps to the path through its poses, and to its speed.

    Between two poses the tool moves straight and turns evenly, within the tolerance of the second.

    Args:
        task: The poses, and the speed.
        motion: Its holds are the states at the poses.
        path: The interpolated states.
        Ts_world_tool: The tool at each of these, by the robot's kinematics.
        limits: The share by which the speed may be exceeded.
    """
    at, poses = np.array([hold.first for hold in motion.holds]), task.poses
    if len(at) != len(poses) or (np.diff(at) <= 0).any() or len(at) < 2:
        yield verdict("states at the poses in their order", False, f"{len(at)} holds")
        return
    state = path.at[path.approach :]
    rows = path.approach + np.flatnonzero((state >= at[0]) & (state <= at[-1]))
    Ts, state = Ts_world_tool[rows], path.at[rows]
    leg = np.clip(np.searchsorted(at, state, side="right") - 1, 0, len(at) - 2)
    wanted = _between(np.stack([one.T_world_tool for one in poses]), leg, state, at, Ts)
    excess = np.empty((len(Ts), 2))
    for tolerance, legs in _by_tolerance(poses):
        own = np.isin(leg, legs)
        excess[own] = tolerance.excess(Ts[own], wanted[own])
    for name, column, scale, unit in (
        ("position", 0, 1e3, "mm"),
        ("rotation", 1, 180 / np.pi, "deg"),
    ):
        worst = int(excess[:, column].argmax())
        most = scale * max(float(excess[worst, column]), 0.0)
        where = f"between {task.pose_names[leg[worst]]} and {task.pose_names[leg[worst] + 1]}"
        detail = where if most > 0.0 else ""
        yield at_most(f"tool beyond the path's tolerance in {name}", most, 0.0, unit, detail)
    if task.speed is not None and motion.times is not None:
        held = slice(int(at[0]), int(at[-1]) + 1)
        moved = np.linalg.norm(np.diff(motion.Ts_world_tool[held, :3, 3], axis=0), axis=1)
        passed = np.maximum(np.diff(motion.times[held]), 1e-9)
        fastest = 1000 * float(np.where(moved > 1e-9, moved / passed, 0.0).max())
        yield at_most(
            "tool speed along the path", fastest, 1000 * limits.speed * task.speed, "mm/s"
        )


def _by_tolerance(poses: Sequence[ToolPose]) -> list[tuple[ToolPose, list[int]]]:
    """Return a pose for each tolerance, and the legs that end at a pose with it."""
    found: dict[tuple[object, ...], tuple[ToolPose, list[int]]] = {}
    for leg, one in enumerate(poses[1:]):
        key = one.position, one.rotation, one.axis, one.spin, one.cone
        found.setdefault(key, (one, []))[1].append(leg)
    return list(found.values())


def _between(
    Ts_poses: Float[np.ndarray, "p 4 4"],
    leg: Int[np.ndarray, " s"],
    state: Float[np.ndarray, " s"],
    at: Int[np.ndarray, " p"],
    Ts_world_tool: Float[np.ndarray, "s 4 4"],
) -> Float[np.ndarray, "s 4 4"]:
    """Return where the tool should be, given the leg of each state and how far it came on it."""
    from scipy.spatial.transform import Rotation

    point = Ts_world_tool[:, :3, 3]
    length = np.linalg.norm(np.diff(Ts_poses[:, :3, 3], axis=0), axis=1)
    turn = rotation_angle(Ts_world_tool[:-1, :3, :3], Ts_world_tool[1:, :3, :3])
    moved = np.linalg.norm(np.diff(point, axis=0), axis=1)
    share = np.empty(len(leg))
    for way, legs in ((moved, length > MIN_LEG), (turn, length <= MIN_LEG)):
        along = np.concatenate([[0.0], np.cumsum(way)])
        begin, end = np.interp(at[:-1], state, along), np.interp(at[1:], state, along)
        own = legs[leg]
        k = leg[own]
        share[own] = (along[own] - begin[k]) / np.maximum(end[k] - begin[k], 1e-12)
    R = Rotation.from_matrix(Ts_poses[:, :3, :3])
    turns = (R[:-1].inv() * R[1:]).as_rotvec()
    wanted = np.tile(np.eye(4), (len(leg), 1, 1))
    wanted[:, :3, :3] = (R[leg] * Rotation.from_rotvec(share[:, None] * turns[leg])).as_matrix()
    wanted[:, :3, 3] = (
        Ts_poses[leg, :3, 3] + share[:, None] * np.diff(Ts_poses[:, :3, 3], axis=0)[leg]
    )
    return wanted


def reach_check(
    part: MovedPart, motion: Motion, Ts_world_tool: Float[np.ndarray, "m 4 4"], limits: Limits
) -> Check:
    """Check that the tool is at the part while it holds it.

    A rigid object is picked up, or put down, at the first state.
    """
    states = np.concatenate([np.arange(h.first, h.last + 1) for h in motion.grasps])
    if part.joint is None:
        states = np.array([0])
    latch_q = None if motion.latch_q is None else motion.latch_q[states]
    Ts_body_world = invert(part.poses(motion.object_q[states], latch_q))
    points = (Ts_body_world @ Ts_world_tool[states][:, None])[..., :3, 3]
    if part.latch is not None:
        away = [part.distance(p, part.latch.body) for p in points[:, part.latch.body]]
        worst, where = max(away), int(np.argmax(away))
    elif points.shape[1] == 1:
        worst, where = _farthest(part, points[:, 0])
    else:
        away = [min(part.distance(p, b) for b, p in enumerate(row)) for row in points]
        worst, where = max(away), int(np.argmax(away))
    detail = f"state {states[where]}"
    return at_most("grasp point to the moved part", 1000 * worst, 1000 * limits.reach, "mm", detail)


def _farthest(part: MovedPart, points: Float[np.ndarray, "k 3"]) -> tuple[float, int]:
    """Return the largest distance of points from a part of one body [m], and which point has it.

    Between two points the distance changes by at most their separation, so few need computing.
    """
    bounds, worst, where = np.full(len(points), np.inf), -np.inf, 0
    while bounds.max() > worst + 1e-6:
        i = int(bounds.argmax())
        distance = part.distance(points[i])
        if distance > worst:
            worst, where = distance, i
        moved = np.linalg.norm(points - points[i], axis=1)
        bounds = np.minimum(bounds, distance + moved)
    return worst, where


MIN_LEG = 1e-4
"""Length between two poses of a path below which the tool only turns there [m]."""
MAX_SIDEWAYS, SIDEWAYS_SHARE = 3e-4, 0.05
"""A base that cannot drive sideways may move so far in total [m], beyond a share of its path."""
MAX_OVERTURN = math.radians(0.1)
"""A car-like base may turn so far in total beyond what its turning radius allows [rad]."""
MAX_BASE_STEP, MAX_BASE_TURN = 0.05, 0.1
"""Largest distance [m] and turn [rad] between consecutive poses of a base path."""
MAX_BASE_GAP = 1e-6
"""Largest difference of a plan's base pose and the first one of its manipulation [m] or [rad]."""


def base_path_checks(
    way: Float[np.ndarray, "k 3"], ends: Float[np.ndarray, "2 3"], limits: Limits
) -> Iterator[Check]:
    """Check that a base path leads from the start to the base pose in small steps."""
    if not len(way) or len(way) > limits.states or np.abs([*way, *ends]).max() > MAX_MAGNITUDE:
        yield verdict(f"base path has 1 to {limits.states} poses", False)
        return
    off = _max_offset(way[[0, -1]], ends)
    yield at_most("base path from start to base pose", 1000 * off[0], 1000 * limits.join, "mm")
    yield at_most("base path from start to base pose, turn", off[1], limits.join, "rad")
    step, turn = _max_offset(way[1:], way[:-1])
    yield at_most("step of the base path", 1000 * step, 1000 * MAX_BASE_STEP, "mm")
    yield at_most("turn of the base path", turn, MAX_BASE_TURN, "rad")


def known_base_checks(
    base_pose: tuple[float, float, float], motion: Motion, drive: str | None
) -> Iterator[Check]:
    """Check that a moving base has a pose for each state, and a drive to move with."""
    if motion.base is None:
        return
    fits = motion.base.shape == (len(motion.q), 3)
    yield verdict("one base pose for each state of the manipulation", fits, str(len(motion.base)))
    yield verdict("drive of the moving base is known", drive is not None)
    if fits and len(motion.base):
        off = max(_max_offset(motion.base[:1], np.array([base_pose])))
        name = "base_pose is the first base pose of the manipulation"
        yield at_most(name, off, MAX_BASE_GAP, "rad|m")


def moving_base_checks(
    path: DensePath, motion: Motion, drive: str | None, radius: float | None, limits: Limits
) -> Iterator[Check]:
    """Check that the base can move so during the manipulation, at all interpolated states."""
    if motion.base is None or path.base is None:
        return
    steps = np.abs(np.diff(motion.base, axis=0)).max(1, initial=0.0)
    where = f"state {int(steps.argmax())}" if len(steps) else ""
    yield at_most(
        "largest step of the base", steps.max(initial=0.0), limits.jump, "rad|m", where, "the base"
    )
    driven = path.base[path.approach :]
    yield from wheel_checks(driven, drive, radius, "base", lambda k: path.where(path.approach + k))


def wheel_checks(
    way: Float[np.ndarray, "k 3"],
    drive: str | None,
    radius: float | None,
    what: str = "base path",
    where: Callable[[int], str] = lambda k: f"pose {k}",
) -> Iterator[Check]:
    """Check that the wheels of the base can follow a base path.

    Tolerances add up over the path, so that many small steps allow no more than a large one.

    Args:
        way: x [m], y [m], yaw [rad].
        drive: "differential", "omni" or "car"; None if unknown, which checks nothing.
        radius: Least turning radius of a car-like base [m].
        what: What moves, for the names of the checks.
        where: Names a pose by its index.
    """
    if drive is None or drive == "omni":
        return
    step, turn = np.diff(way[:, :2], axis=0), wrap_angle(np.diff(way[:, 2]))
    middle = way[:-1, 2] + turn / 2  # an arc's chord has the heading of its middle
    ahead = np.abs(step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle))
    across = np.abs(step[:, 1] * np.cos(middle) - step[:, 0] * np.sin(middle))
    beyond = np.maximum(across - SIDEWAYS_SHARE * ahead, 0.0)
    yield at_most(
        f"{what} moves sideways, which its drive cannot", 1000 * beyond.sum(),
        1000 * MAX_SIDEWAYS, "mm", _largest(beyond, where), "the base",
    )  # fmt: skip
    if drive == "car" and radius is not None:
        over = np.maximum(np.abs(turn) - ahead / radius, 0.0)
        yield at_most(
            f"{what} turns tighter than its drive can", math.degrees(over.sum()),
            math.degrees(MAX_OVERTURN), "deg", _largest(over, where), "the base",
        )  # fmt: skip


def _largest(beyond: Float[np.ndarray, " n"], where: Callable[[int], str]) -> str:
    return f"most after {where(int(beyond.argmax()))}" if beyond.any() else ""


def _max_offset(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> tuple[float, float]:
    """Return the largest distance [m] and turn [rad] between poses."""
    away = a - b
    distance = np.hypot(away[:, 0], away[:, 1]).max(initial=0.0)
    return float(distance), float(np.abs(wrap_angle(away[:, 2])).max(initial=0.0))


def known_latch_checks(part: MovedPart, motion: Motion) -> Iterator[Check]:
    """Check that the motion turns a latch if and only if one must be turned."""
    if part.latch is not None:
        name = part.latch.joint.name
        yield verdict("the latch is turned first", motion.latch_q is not None, name)
    elif motion.latch_q is not None:
        yield verdict("the scene has the latch that the plan turns", False, "no latch to turn")
    if motion.latch_q is not None:
        yield verdict("one value of the latch for each state", len(motion.latch_q) == len(motion.q))


def latch_checks(part: MovedPart, motion: Motion, limits: Limits) -> Iterator[Check]:
    """Check that the latch is turned as the scene says, and that the part rests until then."""
    latch, values = part.latch, motion.latch_q
    if latch is None or values is None:
        return
    span = latch.goal - latch.start
    slack = limits.goal * max(abs(span), 1e-9)
    yield at_most(
        "latch starts at the scene's value", abs(values[0] - latch.start), slack, "rad|m",
        f"{values[0]:.4f}, scene {latch.start:.4f}",
    )  # fmt: skip
    back = float((-np.sign(span) * np.diff(values)).max(initial=0.0))
    yield at_most("latch turns monotonically (largest step back)", back, MAX_STEP_BACK, "rad|m")
    excess = max(latch.joint.lower - values.min(), values.max() - latch.joint.upper, 0.0)
    yield at_most("latch within its joint limits (excess)", excess, limits.joint, "rad|m")
    moves = np.abs(np.diff(motion.object_q)) > MAX_FREE_MOTION
    short = (latch.goal - values[:-1])[moves] * np.sign(span)
    yield at_most(
        "latch short of its value while the part moves", short.max(initial=0.0), slack, "rad|m",
        f"{values[-1]:.4f} at the end, scene {latch.goal:.4f}",
    )  # fmt: skip


_STILL = 1e-9
"""A joint that moves less between two states rests [rad] or [m]."""


def time_checks(robot: RobotCollisionModel, motion: Motion, limits: Limits) -> Iterator[Check]:
    """Check the times of the states, if the plan has any.

    Of a joint only its mean speed between two states is known. It never exceeds the joint's limit,
    and from one interval to the next it changes by no more than the acceleration limit times half
    the length of both, if the joint keeps its limits in between. Both phases start and end at rest.
    """
    phases = ((motion.approach, motion.approach_times), (motion.q, motion.times))
    means = [_means(q, times) for q, times in phases if times is not None and len(times) > 1]
    if not means:
        return
    speed = np.vstack([np.abs(v) for v, _ in means]) / robot.speed
    yield _worst("joint speed by the plan's times", speed, robot, limits)
    if np.isfinite(robot.acceleration).any():
        change = np.vstack([_changes(v, length) for v, length in means]) / robot.acceleration
        yield _worst("joint acceleration by the plan's times", change, robot, limits)


def _means(
    q: Float[np.ndarray, "m n"], times: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, " k"]]:
    """Return the mean velocity in each interval, and its length [s]."""
    moved, length = np.diff(q, axis=0), np.diff(times)
    still = np.abs(moved) <= _STILL
    with np.errstate(divide="ignore"):
        return np.where(still, 0.0, moved / np.where(still, 1.0, length[:, None])), length


def _changes(v: Float[np.ndarray, "k n"], length: Float[np.ndarray, " k"]) -> np.ndarray:
    """Return the least acceleration that changes the mean velocities so, from rest to rest."""
    half = np.convolve(np.pad(length, 1), (0.5, 0.5), mode="valid")[:, None]
    rest = np.zeros((1, v.shape[1]))
    change = np.abs(np.diff(v, axis=0, prepend=rest, append=rest))
    change = np.where(np.isfinite(change), change, np.inf)
    return np.divide(change, half, out=np.where(change > 0.0, np.inf, 0.0), where=half > 0.0)


def _worst(
    name: str, share: Float[np.ndarray, "k n"], robot: RobotCollisionModel, limits: Limits
) -> Check:
    worst = robot.joints[int(share.max(0).argmax())]
    percent = 100.0 * float(share.max(initial=0.0))
    return at_most(name, percent, 100.0 * limits.speed, "%", worst, worst)
