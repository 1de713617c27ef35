"""Solve for arm states at the waypoints, for many pairs of base pose and grasp mode."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from momapos.core import InputError, owner_cache
from momapos.core.compiled import B1, F1, F2, F3, F4, I1, I2, entry, kernel
from momapos.core.geometry import apply, invert, pose_planar, rotation
from momapos.model.collision import (
    FREE,
    CollisionWorld,
    HandLoad,
    check_one,
    collision_arrays,
    scratch_of,
)
from momapos.model.kinematics import (
    COARSE,
    MAX_BRANCHES,
    ArmArrays,
    Chain,
    ChainArrays,
    CollisionArrays,
    IkModel,
    LoadArrays,
    TaskState,
    arm_arrays,
    begin_pose,
    build_ik,
    chain_arrays,
    ik_scratch,
    load_excess,
    load_scratch,
    max_solutions,
    sample_count,
    solve_sample,
    state_loads,
    with_base_slides,
)
from momapos.model.records import InverseKinematics
from momapos.model.robots import Robot, RobotLoads, StateLoads, robot_loads
from momapos.planning.grasps import TaskMotion

from .hand_clearance import arm_spheres

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


_MAX_MISS = 1e-3
"""How far a state may miss its tool pose, in every entry of the pose [-] or [m]. The planner's
Newton steps remove smaller errors; a larger one is a solver for another arm or frame."""
_ROUNDING = 1e-6
"""A state may exceed a limit by this [rad] or [m]."""


def own_states(
    solve: InverseKinematics,
    chain: Chain,
    bases: Float[np.ndarray, "j d 3"],
    grasps: Int[np.ndarray, "j k"],
    steps: Int[np.ndarray, " l"],
    Ts_world_tool: Float[np.ndarray, "g s 4 4"],
) -> Float[np.ndarray, "r b n"]:
    """Return the states within limits for each job, step and grasp; NaN where there is none.

    Args:
        solve: The inverse kinematics.
        chain: The arm.
        bases: Base pose of each job, one for all steps or one for each.
        grasps: Grasps of each job, padded with -1.
        steps: Steps of the motion that are solved.
        Ts_world_tool: Tool pose of each grasp at every step.

    Raises:
        InputError: It returns anything but states whose tools are at the poses.
    """
    used = np.broadcast_to((grasps >= 0)[:, None], (len(grasps), len(steps), grasps.shape[1]))
    at = bases[:, np.minimum(steps, bases.shape[1] - 1)]
    tools = Ts_world_tool[grasps[:, None], steps[:, None]]
    Ts = (invert(pose_planar(at))[:, :, None] @ tools)[used]
    found = _checked(solve(Ts.copy()), chain, Ts)
    states = np.full((used.size, max(1, found.shape[1]), chain.size), np.nan)
    states[used.ravel(), : found.shape[1]] = found
    return states


def _checked(
    found: object, chain: Chain, Ts: Float[np.ndarray, "m 4 4"]
) -> Float[np.ndarray, "m b n"]:
    """Return states with those beyond the limits removed, after a check of their tool poses."""
    states = np.array(found, float) if isinstance(found, np.ndarray) else np.empty(0)
    if states.ndim != 3 or (states.shape[0], states.shape[2]) != (len(Ts), chain.size):
        raise InputError(
            f"inverse kinematics must return an array of shape ({len(Ts)}, b, {chain.size}), b "
            f"states for each of {len(Ts)} tool poses, not {getattr(found, 'shape', type(found))}"
        )
    known = ~np.isnan(states).any(2)
    states[~known] = np.nan
    pose, _ = np.nonzero(known)
    miss = np.abs(chain.tool_poses(states[known]) - Ts[pose]).max(initial=0.0)
    if not miss <= _MAX_MISS:
        raise InputError(
            f"inverse kinematics returned a state whose tool misses its pose by {miss:.2g}; at "
            f"most {_MAX_MISS:g} is allowed (m, or entries of the rotation matrix)"
        )
    beyond = (states < chain.lower - _ROUNDING) | (states > chain.upper + _ROUNDING)
    states[beyond.any(2)] = np.nan
    return np.clip(states, chain.lower, chain.upper)


@kernel
def copy_states(states, into):
    """Copy the rows without NaN; return their number."""
    count = 0
    for b in range(len(states)):
        if not np.isnan(states[b, 0]):
            into[count] = states[b]
            count += 1
    return count


@dataclass(frozen=True, eq=False)
class TurningArm:
    """A robot's arm whose last degree of freedom is the turn of its hand about the grasp."""

    robot: Robot
    chain: Chain
    """Kinematic chain, including the turn."""
    ik: IkModel


@dataclass(frozen=True, eq=False)
class DrivingArm:
    """An arm whose first degrees of freedom are slides of the base, without turning."""

    arm: Robot | TurningArm
    directions: Float[np.ndarray, "k 3"]
    """Unit directions in the frame of the base."""
    travel: float
    """How far the base slides to either side [m]."""

    @cached_property
    def chain(self) -> Chain:
        """Return the kinematic chain, slides first."""
        return with_base_slides(self.arm.chain, self.directions, self.travel)

    @cached_property
    def ik(self) -> IkModel:
        """Return the inverse kinematics of slides and arm."""
        return build_ik(self.chain)


ArmModel: TypeAlias = Robot | TurningArm | DrivingArm


def robot_of(arm: ArmModel) -> Robot:
    """Return the robot of an arm."""
    if isinstance(arm, Robot):
        return arm
    return arm.robot if isinstance(arm, TurningArm) else robot_of(arm.arm)


def standing_arm(arm: ArmModel) -> Robot | TurningArm:
    """Return the arm without the slides of its base."""
    return arm.arm if isinstance(arm, DrivingArm) else arm


def slides_of(arm: ArmModel) -> Float[np.ndarray, "k 3"]:
    """Return the directions in which the base slides; none if it stands."""
    return arm.directions if isinstance(arm, DrivingArm) else np.zeros((0, 3))


def split_states(
    arm: ArmModel, base: Float[np.ndarray, "*d 3"], states: Float[np.ndarray, "d n"]
) -> tuple[Float[np.ndarray, "d 3"], Float[np.ndarray, "d m"]]:
    """Return the base pose at each state, and the states of the arm on it.

    Args:
        arm: The arm.
        base: Base pose without the slides, one for all states or one for each.
        states: Values of all degrees of freedom.
    """
    slides = slides_of(arm)
    poses = np.array(np.broadcast_to(base, (len(states), 3)))
    if len(slides):
        R = rotation(poses[:, 2])
        poses[:, :2] += np.einsum("dij,dj->di", R, states[:, : len(slides)] @ slides[:, :2])
    return poses, states[:, len(slides) :]


def hand_poses(
    arm: Robot | TurningArm,
    bases: Float[np.ndarray, "d 3"],
    states: Float[np.ndarray, "d n"],
    Ts_world_tool: Float[np.ndarray, "d 4 4"],
) -> Float[np.ndarray, "d 4 4"]:
    """Return the tool poses in the world: the given ones, or those of the turned hand."""
    if not isinstance(arm, TurningArm):
        return Ts_world_tool
    return pose_planar(bases) @ arm.robot.chain.tool_poses(states[:, :-1])


@dataclass(frozen=True, eq=False)
class TaskLoads:
    """The loads of a robot at the states of a task."""

    robot: Robot
    motion: TaskMotion

    @cached_property
    def limits(self) -> RobotLoads:
        """Return the robot's masses, effort limits and wheels."""
        return robot_loads(self.robot)

    def at(
        self,
        base: Float[np.ndarray, "*s 3"],
        q: Float[np.ndarray, "s n"],
        grasp: int,
        steps: Int[np.ndarray, " s"],
    ) -> StateLoads:
        """Return the loads at steps of the motion.

        Args:
            base: Base pose x [m], y [m], yaw [rad], or one at each state.
            q: Values of the degrees of freedom; further ones are ignored.
            grasp: The grasp.
            steps: The step of the motion at each state.
        """
        force, point = (x[grasp, steps] for x in self.motion.hand_loads)
        turned, moved, R = force.copy(), point.copy(), rotation(base[..., 2])
        moved[:, :2] -= base[..., :2]
        turned[:, :2], moved[:, :2] = ((x[:, None, :2] @ R)[:, 0] for x in (force, moved))
        return self.limits.at(q[:, : self.robot.chain.size], turned, moved)

    def free(
        self, q: Float[np.ndarray, "s n"], carried: tuple[int, int] | None = None
    ) -> StateLoads:
        """Return the loads of a free motion of the arm.

        Args:
            q: Values of the degrees of freedom.
            carried: The grasp and a step of the motion at which the hand holds the object that it
                carries; None for an empty hand.
        """
        if carried is None:
            return self.limits.at(q)
        hand = self.of_hand(carried)
        T_base_tool = self.robot.chain.tool_poses(q)
        points = T_base_tool[:, :3, :3] @ hand.in_tool + T_base_tool[:, :3, 3]
        return self.limits.at(q, np.tile(hand.force, (len(q), 1)), points)

    def of_hand(self, carried: tuple[int, int] | None) -> HandLoad:
        """Return what the arm bears in a free motion, see `free`."""
        if carried is None:
            return HandLoad(self.limits.arrays, np.zeros(3), np.zeros(3))
        force, point = (x[carried] for x in self.motion.hand_loads)
        in_tool = apply(invert(self.motion.Ts_world_tool[carried]), point[None])[0]
        return HandLoad(self.limits.arrays, np.array(force), in_tool)


def load_arrays(arm: ArmModel) -> LoadArrays:
    """Return an arm's masses and limits for kernels; a turn of the hand needs nothing."""
    arrays, chain = robot_loads(robot_of(arm)).arrays, standing_arm(arm).chain
    more = chain.last + 1 - len(arrays.mass)
    if not more:
        return arrays
    return arrays._replace(
        mass=np.append(arrays.mass, np.zeros(more)),
        center=np.vstack([arrays.center, np.zeros((more, 3))]),
        limit=np.append(arrays.limit, np.full(more, np.inf)),
    )


MAX_STEP = 0.8
"""Largest joint step between waypoints [rad]."""
PRISMATIC_SCALE = 4.0
"""Weight of a prismatic joint's travel in joint steps [rad/m]."""
NOWHERE, CUT_OFF, OVERLOADED = FREE, FREE - 10, FREE - 9
"""Failures without a collision: out of reach, too far from the neighboring waypoints, or beyond
what the motors and the base bear."""


class Layers(NamedTuple):
    """Configurations of j jobs in l layers, concatenated."""

    q: F2
    """(m, n)"""
    grasps: I1
    """The grasp of each configuration (m,)."""
    checked: B1
    """Whether it is known to be free (m,); in each layer with configurations, one is."""
    first: I2
    """Index of the first configuration of each job in each layer (j, l)."""
    counts: I2
    """Number of configurations (j, l); also 0 where none was searched."""
    passed: I1
    """Number of layers with configurations before the first failure (j,)."""
    codes: I1
    """Cause of the failure (j,): the obstacle that was hit, NOWHERE, CUT_OFF or OVERLOADED."""
    excess: F1
    """Least excess of the refused configurations of that layer (j,) [-]; infinite without any."""
    where: I1
    """The degree of freedom that exceeds its limit there, or BASE (j,)."""
    hit: F2
    """A configuration of that layer that hits the obstacle, after its base pose (j, 3 + n)."""


class JointSteps(NamedTuple):
    """How to measure steps of n joints."""

    full_turn: B1
    """Which joints turn fully, so that a step takes the shorter direction."""
    scale: F1
    """Weight of each joint [rad/rad] or [rad/m]."""
    locked: F1
    """Weight of each joint that inverse kinematics does not solve for, 0 for the others."""


class Jobs(NamedTuple):
    """Pairs of base pose and grasp mode."""

    bases: F3
    """Base pose of each, at every step or one for all: x [m], y [m], yaw [rad]."""
    grasps: I2
    """Grasps of each mode, padded with -1."""
    own: F3
    """States by the user's own inverse kinematics for each job, layer and grasp of its mode, with
    NaN where there is none; empty if the arm's own is used."""


class Standing(NamedTuple):
    """The arm on a base that slides with its first degrees of freedom."""

    chain: ChainArrays
    """The arm without the slides."""
    slides: F2
    """Directions of the slides in the frame of the base; none if it stands."""


class Course(NamedTuple):
    """A motion of d steps and w waypoints, which share the states of l layers."""

    order: I1
    """The order in which the layers are solved (l,)."""
    place: I1
    """The first waypoint of each layer (l,)."""
    waypoints: I1
    """The step of each waypoint (w,)."""
    layer: I1
    """The layer of each waypoint (w,)."""
    again: I1
    """How many waypoints before each share its layer (w,)."""
    value: I1
    """Index of the moved part's configuration at each step (d,)."""
    holding: B1
    """Whether the hand holds the part there (d,)."""
    Ts_world_tool: F4
    """Tool pose of each grasp at every step (g, d, 4, 4)."""
    force: F3
    """Force on the hand of each grasp at every step, in the world (g, d, 3) [N]."""
    point: F3
    """Where it acts (g, d, 3) [m]."""
    lanes: I2
    row: I1
    """See `TaskMotion.lanes`: (k, g) and (w,)."""
    angles: F1
    """Turn of the hand in each grasp (g,) [rad]."""


class Found(NamedTuple):
    """Output arrays of the kernel, see `Layers`."""

    q: F2
    grasps: I1
    checked: B1
    first: I2
    counts: I2
    excess: F1
    where: I1
    hit: F2


class TaskArrays(NamedTuple):
    """One arm, its obstacles and one motion."""

    arm: ArmArrays
    standing: Standing
    robot: LoadArrays
    room: CollisionArrays
    steps: JointSteps
    course: Course


@owner_cache(8)
def task_arrays(motion: TaskMotion, robot: ArmModel, world: CollisionWorld) -> TaskArrays:
    """Return an arm, its obstacles and a motion as an argument of kernels."""
    chain, scale = robot.chain, joint_scale(robot.chain)
    locked = scale.copy()
    locked[robot.ik.active] = 0.0
    layer, (lanes, row) = motion.layer_of, motion.lanes
    place = np.unique(layer, return_index=True)[1]
    force, point = map(np.ascontiguousarray, motion.hand_loads)
    return TaskArrays(
        arm_arrays(chain, robot.ik),
        Standing(chain_arrays(standing_arm(robot).chain), slides_of(robot)),
        load_arrays(robot),
        collision_arrays(arm_spheres(robot_of(robot)), world),
        JointSteps(full_turns(chain), scale, locked),
        Course(
            np.array(_ends_first(len(place))), place, np.array(motion.waypoint_steps), layer,
            np.arange(len(layer)) - place[layer], np.array(motion.value), np.array(motion.holding),
            np.ascontiguousarray(motion.Ts_world_tool), force, point, np.ascontiguousarray(lanes),
            row, np.array(motion.turning.angles),
        ),
    )  # fmt: skip


def _ends_first(count: int) -> list[int]:
    """Order range(count): grasp, last, first, then by bisection."""
    order, stride = [1, count - 1, 0], count - 1
    order = [layer for layer in dict.fromkeys(order) if layer < count]
    while stride > 1:
        stride = (stride + 1) // 2
        order += [i for i in range(0, count, stride) if i not in order]
    return order


def joint_scale(chain: Chain) -> Float[np.ndarray, " n"]:
    """Return the weight of each joint in a joint step [rad/rad] or [rad/m]."""
    return np.where(chain.prismatic, PRISMATIC_SCALE, 1.0)


def full_turns(chain: Chain) -> Bool[np.ndarray, " n"]:
    """Find the joints that turn fully, so that a step takes the shorter direction."""
    return ~chain.prismatic & (chain.upper - chain.lower > 2 * np.pi + 0.1)


def layer_jobs(
    robot: ArmModel,
    motion: TaskMotion,
    bases: Float[np.ndarray, "j *d 3"],
    modes: Int[np.ndarray, " j"],
) -> Jobs:
    """Return pairs of base pose, or base path, and grasp mode as an argument of kernels."""
    paths = np.ascontiguousarray(bases[:, None] if bases.ndim == 2 else bases)
    grasps = np.ascontiguousarray(motion.turning.members(modes))
    solve = robot.own_ik if isinstance(robot, Robot) else None
    if solve is None:
        return Jobs(paths, grasps, np.empty((0, 0, robot.chain.size)))
    step = motion.waypoint_steps[np.unique(motion.layer_of, return_index=True)[1]]
    own = own_states(solve, robot.chain, paths, grasps, step, motion.Ts_world_tool)
    return Jobs(paths, grasps, own)


def solve_layers(
    jobs: Jobs, task: TaskArrays, order: Int[np.ndarray, " o"] | None = None
) -> Layers:
    """Find configurations of each job in some layers, until a layer has none that is free.

    Collision checks of a layer stop at the first free configuration, since most end up on no path.
    A configuration farther than `MAX_STEP` per waypoint from all configurations of the nearest
    solved layer on either side is on no path; it is dropped without a check.

    Args:
        jobs, task: From `layer_jobs` and `task_arrays`.
        order: The layers, in the order in which they are solved. By default all, those that fail
            most first: the ends and the middle.
    """
    if order is not None:
        task = task._replace(course=task.course._replace(order=order))
    return Layers(*_solve_layers(jobs, task))


_HALF_TURN = 3.14
"""Joint differences up to this are not shorter in the other direction [rad]."""


@kernel
def joint_step(a, b, full_turn, scale, limit):
    """Return the largest joint difference, in the shorter direction; stop beyond the limit."""
    worst = 0.0
    for k in range(len(a)):
        d = b[k] - a[k]
        if full_turn[k] and abs(d) > _HALF_TURN:
            d -= 2.0 * np.pi * np.floor(d / (2.0 * np.pi) + 0.5)
        worst = max(worst, abs(d) * scale[k])
        if worst > limit:
            break
    return worst


@kernel
def _near(q, limit, states, full_turn, scale):
    """Check that a state at another waypoint is near enough."""
    for i in range(len(states)):
        if joint_step(q, states[i], full_turn, scale, limit) <= limit:
            return True
    return False


@kernel
def _joined(q, limits, before, after, full_turn, scale):
    """Check that a state of the solved waypoint on either side is near enough."""
    return (limits[0] == np.inf or _near(q, limits[0], before, full_turn, scale)) and (
        limits[1] == np.inf or _near(q, limits[1], after, full_turn, scale)
    )


@kernel
def _around(at, order, looked, place):
    """Return the nearest solved waypoints before and after one; -1 if there is none."""
    before, after = -1, -1
    for i in range(looked):
        other = order[i]
        if place[other] < place[at] and (before < 0 or place[other] > place[before]):
            before = other
        if place[other] > place[at] and (after < 0 or place[other] < place[after]):
            after = other
    return before, after


@kernel
def _tool_in_base(T, base, R, p):
    """Fill in rotation and position of a tool pose in the base frame."""
    c, s = np.cos(base[2]), np.sin(base[2])
    for k in range(3):
        R[0, k] = c * T[0, k] + s * T[1, k]
        R[1, k] = c * T[1, k] - s * T[0, k]
        R[2, k] = T[2, k]
    p[0] = c * T[0, 3] + s * T[1, 3] - (c * base[0] + s * base[1])
    p[1] = c * T[1, 3] - s * T[0, 3] - (c * base[1] - s * base[0])
    p[2] = T[2, 3]


@kernel
def load_in_base(force, point, base, memory):
    """Fill in a force and where it acts, in the base frame."""
    c, s = np.cos(base[2]), np.sin(base[2])
    x, y = point[0] - base[0], point[1] - base[1]
    memory[0, 0], memory[0, 1] = c * force[0] + s * force[1], c * force[1] - s * force[0]
    memory[1, 0], memory[1, 1] = c * x + s * y, c * y - s * x
    memory[0, 2], memory[1, 2] = force[2], point[2]


@kernel
def slide(q, at, standing, here):
    """Write the base pose of a state."""
    here[0], here[1], here[2] = at[0], at[1], at[2]
    c, s = np.cos(at[2]), np.sin(at[2])
    for k in range(len(standing.slides)):
        x, y = standing.slides[k, 0] * q[k], standing.slides[k, 1] * q[k]
        here[0] += c * x - s * y
        here[1] += s * x + c * y


@kernel
def _solve_layer(j, looked, used, jobs, task, found, scratch, placed, memory):
    """Fill in the configurations of a job in one layer; return their number and a code."""
    arm, standing, robot, room, steps, course = task
    R, p, solutions, limits, load, bearing, here = memory
    w = course.order[looked]
    place = course.place
    step, lead = course.waypoints[place[w]], len(standing.slides)
    base = jobs.bases[j, min(step, jobs.bases.shape[1] - 1)]
    full_turn, n, samples = steps.full_turn, len(steps.full_turn), arm.ik.samples
    state = TaskState(course.value[step], course.holding[step])
    low, high = _around(w, course.order, looked, place)
    limits[0] = limits[1] = np.inf
    before, after = found.q[:0], found.q[:0]
    if low >= 0:
        limits[0] = MAX_STEP * (place[w] - place[low])
        before = found.q[found.first[j, low] : found.first[j, low] + found.counts[j, low]]
    if high >= 0:
        limits[1] = MAX_STEP * (place[high] - place[w])
        after = found.q[found.first[j, high] : found.first[j, high] + found.counts[j, high]]
    count, worst, own = 0, CUT_OFF, len(jobs.own) > 0
    found.excess[j] = np.inf
    for column in range(jobs.grasps.shape[1]):
        grasp, code = jobs.grasps[j, column], NOWHERE
        if grasp < 0:
            break
        _tool_in_base(course.Ts_world_tool[grasp, step], base, R, p)
        force, point = course.force[grasp, step], course.point[grasp, step]
        begin_pose(scratch)
        for s in range(1 if own else sample_count(arm.ik)):
            # Locked joints are known, so most samples need no inverse kinematics.
            if (
                not own
                and s < len(samples)
                and not _joined(samples[s], limits, before, after, full_turn, steps.locked)
            ):
                continue
            if own:
                row = (j * len(place) + w) * jobs.grasps.shape[1] + column
                solved = copy_states(jobs.own[row], solutions)
            else:
                solved = solve_sample(s, R, p, arm, COARSE, solutions, scratch)
            for b in range(solved):
                q = solutions[b]
                if not _joined(q, limits, before, after, full_turn, steps.scale):
                    if code == NOWHERE:
                        code = CUT_OFF
                    continue
                slide(q, base, standing, here)
                q_arm = q[lead:]
                load_in_base(force, point, here, load)
                stability = state_loads(q_arm, standing.chain, robot, load[0], load[1], bearing)
                excess, where = load_excess(bearing.efforts, stability, robot)
                if excess > 0.0:
                    if excess < found.excess[j]:
                        found.excess[j], found.where[j] = excess, where
                    if code in (NOWHERE, CUT_OFF):
                        code = OVERLOADED
                    continue
                known = count == 0
                hit = FREE
                if known:
                    hit = check_one(q_arm, here, state, standing.chain, room, placed)
                if hit == FREE:
                    for k in range(n):
                        found.q[used + count, k] = q[k]
                    found.grasps[used + count], found.checked[used + count] = grasp, known
                    count += 1
                elif code in (NOWHERE, CUT_OFF, OVERLOADED):
                    code = hit
                    if hit > worst:
                        for k in range(3):
                            found.hit[j, k] = here[k]
                        for k in range(len(q_arm)):
                            found.hit[j, 3 + k] = q_arm[k]
        worst = max(worst, code)
    return count, worst


@entry
def _solve_layers(jobs: Jobs, task: TaskArrays) -> tuple[np.ndarray, ...]:
    arm, standing, course = task.arm, task.standing, task.course
    count, n = len(jobs.bases), len(arm.limits.lower)
    first = np.zeros((count, len(course.place)), np.int64)
    counts, passed, codes = (
        np.zeros_like(first),
        np.zeros(count, np.int64),
        np.zeros(count, np.int64),
    )
    joints = len(standing.chain.slides)
    scratch, placed = ik_scratch(arm), scratch_of(joints, task.room.spheres)
    solutions = np.empty((max(MAX_BRANCHES, jobs.own.shape[1]), n))
    memory = (
        np.empty((3, 3)), np.empty(3), solutions, np.empty(2), np.empty((2, 3)),
        load_scratch(joints, n - len(standing.slides)), np.empty(3),
    )  # fmt: skip
    excess, where = np.full(count, np.inf), np.zeros(count, np.int64)
    hits = np.zeros((count, 3 + n))
    # The arrays always have space for one job at one waypoint.
    each = max(max_solutions(arm.ik), jobs.own.shape[1])
    most, used = jobs.grasps.shape[1] * each, 0
    q, grasps = np.empty((4 * most, n)), np.empty(4 * most, np.int64)
    checked = np.empty(4 * most, np.bool_)
    for j in range(count):
        for looked in range(len(course.order)):
            if used + most > len(q):
                q, grasps = np.concatenate((q, np.empty_like(q))), np.append(grasps, grasps)
                checked = np.append(checked, checked)
            found = Found(q, grasps, checked, first, counts, excess, where, hits)
            added, code = _solve_layer(j, looked, used, jobs, task, found, scratch, placed, memory)
            if added == 0:
                codes[j] = code
                break
            first[j, course.order[looked]], counts[j, course.order[looked]] = used, added
            used, passed[j] = used + added, looked + 1
    ends = passed, codes, excess, where, hits
    return (q[:used], grasps[:used], checked[:used], first, counts, *ends)
