"""Replan during a run: drive, plan arm motions, update the belief, and recover from failures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import SceneError, Stopwatch, TaskError
from momapos.core.geometry import (
    compose,
    invert,
    local_points,
    pose_planar,
    rotation_angle,
    wrap_angle,
)
from momapos.model.collision import StraightMotions, build_motions
from momapos.model.kinematics import track_tools
from momapos.model.records import (
    Attempt,
    Motion,
    PlacementPlan,
    PoseOutcome,
    PoseStatus,
    ReachScorer,
    Task,
)
from momapos.model.robots import Robot
from momapos.model.scene import Scene, hypothesis_about, scene_with_part_motion, with_assumptions
from momapos.model.urdf import opening_of
from momapos.planning import PipelineConfig, PlacementQuery, check_pose, collision_world, grasp_of
from momapos.planning.arm_motion import RESOLUTION, interpolate, plan_with_clearance
from momapos.planning.baselines import plan_with_method
from momapos.planning.grasps import GraspFilter, TaskMotion, slides, task_motion
from momapos.planning.navigation import (
    DriveRecord,
    HeldObject,
    NavigationMap,
    build_navigation_map,
    gaps,
)
from momapos.simulation import (
    AttemptOutcome,
    Axis,
    LearnedPart,
    PlanHomePath,
    Pose,
    TrueWorld,
    Visit,
)
from momapos.verification import PlanVerifier

from .joint_belief import JointBelief, JointBeliefs

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


_BEYOND = PoseOutcome(PoseStatus.EXACT_CHECK, "the arm does not reach from the displaced base path")
MAX_OFFSET = 0.02
"""Largest offset of the hand from the plan, of an arm that cannot make up for where the base has
stopped [m] or [rad]; the exact check decides whether the hand may hold the part so."""


def motion_from(
    plan: PlacementPlan, scene: Scene, robot: Robot, here: Float[np.ndarray, "3"]
) -> Attempt:
    """Return a plan's motion for a base that has stopped near its base pose.

    The base path moves with the base, so that the drive can follow it as planned. The hand moves as
    planned, and the arm makes up for the difference; a short arm as far as it can. The motion is
    checked exactly.

    Args:
        plan: A plan whose base moves.
        scene: The scene, as the robot believes it.
        robot: The robot.
        here: Where the base has stopped: x [m], y [m], yaw [rad].
    """
    motion = plan.motion
    assert motion is not None
    assert motion.base is not None
    base, chain = _displaced(motion.base, here), robot.chain
    T_world_base = pose_planar(base)
    q = track_tools(
        chain,
        chain.freedom_values(motion.q),
        invert(T_world_base) @ motion.Ts_world_tool,
        MAX_OFFSET,
    )
    if q is None:
        return Attempt(None, _BEYOND)
    found = _joined(
        replace(
            motion, base=base, times=None, approach_times=None,
            Ts_world_tool=T_world_base @ chain.tool_poses(q),
        ),
        motion, chain.joint_values(q),
    )  # fmt: skip
    x, y, yaw = base[0].tolist()
    verifier = PlanVerifier(with_assumptions(scene, plan), robot, plan.task)
    violation = verifier.first_violation((x, y, yaw), found)
    if violation is not None:
        return Attempt(None, PoseOutcome(PoseStatus.EXACT_CHECK, violation))
    return Attempt(found, PoseOutcome(PoseStatus.FEASIBLE))


def _displaced(
    base: Float[np.ndarray, "m 3"], here: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "m 3"]:
    """Return a base path that starts at a pose instead of at its first one."""
    relative = np.column_stack([local_points(base[0], base[:, :2]), base[:, 2] - base[0, 2]])
    moved = compose(here, relative)
    moved[:, 2] = here[2] + relative[:, 2]
    return moved


def _joined(found: Motion, planned: Motion, q: Float[np.ndarray, "m n"]) -> Motion:
    """Return a motion with new arm states, whose approach and path home lead to and from them."""
    approach, home = planned.approach, planned.home
    if len(approach):
        share = np.linspace(0.0, 1.0, len(approach))[:, None]
        share = share if len(approach) > 1 else np.ones((1, 1))
        approach = approach + share * (q[0] - planned.q[0])
    if home is not None:
        home = home + np.linspace(1.0, 0.0, len(home))[:, None] * (q[-1] - planned.q[-1])
    return replace(found, q=q, approach=approach, home=home)


MIN_GRASP_DISTANCE, MIN_GRASP_ANGLE = 0.02, np.radians(20.0)
"""A new grasp differs from the failed ones by at least this distance [m] or this angle [rad]."""
MAX_RESTING_SLOPE = 0.03
"""Slope of a released part's path above which it falls closed; below, friction holds it [-]."""
_START_RANGE, _START_SAMPLES = 0.15, 300
"""Maximum joint offset of the start of the path home from the current state [rad] or [m], and the
number of sampled states [-]."""


def believed_scene(scene: Scene, task: Task, value: float, offset: Float[np.ndarray, "3"]) -> Scene:
    """Return the scene as the hand left it: the part at a value, its object offset [m]."""
    assert task.joint is not None
    joint = scene.object(task.object).model.joint(task.joint)
    moved = scene.with_joint(
        task.object, task.joint, float(np.clip(value, joint.lower, joint.upper))
    )
    item = moved.object(task.object)
    T = item.T_world_object.copy()
    T[:3, 3] += offset
    shifted = replace(item, T_world_object=T)
    return replace(moved, objects=tuple(shifted if o is item else o for o in moved.objects))


def with_estimated_joint(
    scene: Scene, task: Task, axis: Axis, value: float
) -> tuple[Scene, Task, float]:
    """Return scene, task and joint value for the joint that the hand has measured.

    In the returned scene, the part is closed at 0 and opens with a positive value.

    Args:
        scene, task: The scene and the task as believed.
        axis: The measured joint.
        value: Joint value to which the hand moved the part [rad] or [m].

    Raises:
        SceneError: The joint is coupled with others.
    """
    assert task.joint is not None
    assert task.to is not None
    item = scene.object(task.object)
    opening = opening_of(item.model, task.joint)
    moved = opening.sign * (value - opening.closed)
    measured = hypothesis_about(item, task.joint, axis.direction, axis.point, moved)
    first, to = (
        float(np.clip(opening.sign * (at - opening.closed), 0.0, measured.upper))
        for at in (item.values()[task.joint], task.to)
    )
    other = scene_with_part_motion(scene, task.object, task.joint, measured)
    return other.with_joint(task.object, task.joint, first), replace(task, to=to), moved


def falls_closed(scene: Scene, task: Task, learned: LearnedPart) -> bool:
    """Check whether a released part falls closed because opening lifts it."""
    if task.joint is None or not learned.way:
        return False
    slope = float(learned.axis.way_at(learned.way[-1])[2])
    sign = opening_of(scene.object(task.object).model, task.joint).sign
    return sign * slope > MAX_RESTING_SLOPE


def without_pushes(config: PipelineConfig) -> PipelineConfig:
    """Return the configuration with one grasp for the whole motion, so that it never lets go."""
    grasps = config.motion.grasps
    families = tuple(family for family in grasps.families if family != "push")
    return replace(config, motion=replace(config.motion, grasps=replace(grasps, families=families)))


def grasp_in_part(scene: Scene, task: Task, motion: Motion) -> Float[np.ndarray, "4 4"]:
    """Return the first grasp of a motion: the tool in the object's frame, with the part closed."""
    return invert(_part_pose(scene, task)) @ motion.Ts_world_tool[0]


def other_grasps(
    scene: Scene, task: Task, failed: Sequence[Float[np.ndarray, "4 4"]]
) -> GraspFilter:
    """Return a filter that accepts grasps different from the failed ones, see `grasp_in_part`."""
    back = invert(_part_pose(scene, task))

    def accept(motion: TaskMotion) -> Bool[np.ndarray, " g"]:
        Ts = back @ motion.Ts_world_tool[:, motion.grasp_step]
        accepted = np.ones(len(Ts), bool)
        for T in failed:
            away = np.linalg.norm(Ts[:, :3, 3] - T[:3, 3], axis=-1)
            angle = rotation_angle(Ts[:, :3, :3], np.broadcast_to(T[:3, :3], Ts[:, :3, :3].shape))
            accepted &= (away > MIN_GRASP_DISTANCE) | (angle > MIN_GRASP_ANGLE)
        return accepted

    return accept


def _part_pose(scene: Scene, task: Task) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the object's frame, moved with the part from its closed value."""
    item, name = scene.object(task.object), task.joint
    assert name is not None
    link, closed = item.model.joint(name).child, opening_of(item.model, name).closed
    T_object_closed = item.model.link_poses({**item.values(), name: closed})[link]
    return item.link_poses()[link] @ invert(T_object_closed)


def arm_home_path(
    scene: Scene,
    robot: Robot,
    task: Task,
    base_pose: Float[np.ndarray, "3"],
    q: Float[np.ndarray, " n"],
    *,
    config: PipelineConfig,
    seed: int,
) -> Float[np.ndarray, "k n"] | None:
    """Plan a path of the arm from a state back to home.

    Args:
        scene: The scene as the hand left it.
        robot: The robot.
        task: The task.
        base_pose: x [m], y [m], yaw [rad].
        q: Values of the joints that the arm moves [rad] or [m].
        config: Configuration of the planner.
        seed: Same seed, same path.

    Returns:
        Densely interpolated states; None if there is no path.
    """
    try:
        motion = task_motion(scene, robot, task, config.motion)
    except TaskError:  # the remaining opening is too short to plan
        return None
    world = collision_world(robot, motion, replace(config, arm_clearance=0.0))
    chain = robot.chain
    checker = partial(
        build_motions, world, chain, robot.spheres.by_hulls, base_pose, value=int(motion.value[0]),
        holding=False, step=RESOLUTION,
    )  # fmt: skip
    q = chain.freedom_values(q)
    begin = _free_state(q, chain.lower, chain.upper, checker(), np.random.default_rng(seed))
    if begin is None:
        return None
    path = plan_with_clearance(
        begin, robot.home, chain.lower, chain.upper, checker,
        config=config.arm_planner, seed=seed,
    )  # fmt: skip
    if path is None:
        return None
    away = interpolate(np.stack([q, begin]))
    return chain.joint_values(np.concatenate([away[:-1], path.states()]))


def _free_state(
    q: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    free: StraightMotions,
    rng: np.random.Generator,
) -> Float[np.ndarray, " n"] | None:
    """Return the nearest sampled state without a collision: spheres enclose more than the arm."""
    away = rng.uniform(-_START_RANGE, _START_RANGE, (_START_SAMPLES, len(q)))
    away = away[np.argsort(np.abs(away).max(1))]
    states = np.clip(q + np.concatenate([np.zeros((1, len(q))), away]), lower, upper)
    return next((state for state in states if free(state, state)), None)


MIN_POSE_DISTANCE = 0.15
"""Minimum distance of a new base pose from the failed ones [m]."""
YAW_WEIGHT = 0.3
"""Distance that counts as much as a rotation by one radian [m]."""
DOCKING_TOLERANCE = 0.005
"""A drive that ends nearer to its goal is not repeated [m]."""
NO_POSE_LEFT = "no other base pose is left"

Drive: TypeAlias = (
    "Callable[[NavigationMap, Float[np.ndarray, '3'], Float[np.ndarray, '3'],"
    " np.random.Generator], DriveRecord]"
)
"""BasePaths from a pose to a pose: x [m], y [m], yaw [rad]."""
OnDrive: TypeAlias = "Callable[[Float[np.ndarray, ' t'], Float[np.ndarray, 't 3']], None]"
"""Called after every drive with its times [s] and true poses."""


@dataclass(eq=False)
class Replanner:
    """BasePaths to base poses until the arm finds a motion, and replans after failures."""

    ground: NavigationMap
    scene: Scene
    plan: PlacementPlan
    reach: ReachScorer
    drive: Drive
    config: PipelineConfig
    trace: OnDrive
    stopwatch: Stopwatch
    rng: np.random.Generator
    visits: list[Visit] = field(default_factory=list)
    failed: list[Float[np.ndarray, "3"]] = field(default_factory=list)
    """Base poses that failed."""
    grasps: list[Float[np.ndarray, "4 4"]] = field(default_factory=list)
    """Grasps that failed, see `grasp_in_part`."""
    _: KW_ONLY
    initial: Scene
    """The scene at the start of the run, with the joint of the part as now believed."""
    held: HeldObject | None = None
    """What the robot holds on its drives, with its arm at home."""
    beliefs: JointBeliefs
    """Hypotheses of the part's joint."""
    given: TrueWorld = field(init=False)
    """The given scene and task."""
    alternative: Scene | None = None
    """The scene with the part at its next most probable value."""
    unmeasured: tuple[Scene, Scene, Task] | None = None
    """`initial`, `scene` and the task without the measured joint; None if it was not measured."""

    def __post_init__(self) -> None:
        self.given = TrueWorld(self.initial, self.plan.task)
        if self.plan.moves_base and self.config.base == "fixed":
            # Where no single base pose served the task, none does after a failure.
            self.config = replace(self.config, base="auto")

    def true_world(self, there: TrueWorld | None) -> TrueWorld | None:
        """Return the true world if it differs from the robot's belief.

        Args:
            there: The true world as given; None for the scene at the start of the run.
        """
        return there or (None if self.initial is self.given.scene else self.given)

    def learn(self, motion: Motion, outcome: AttemptOutcome) -> bool:
        """Update the belief after a failed motion: failed grasps, state and joint of the part.

        Args:
            motion: The executed motion.
            outcome: Its outcome.

        Returns:
            Whether the hypothesis of the part's joint stays the same.
        """
        # A hand that does not find a part that it moved before also indicates a wrong hypothesis.
        if outcome.learned is not None or self.beliefs.moved:
            other = self.beliefs.fail(() if outcome.learned is None else outcome.learned.way)
            if other is not None:
                self._switch(other)
                return False
        task = self.plan.task
        self.grasps.append(grasp_in_part(self.scene, task, motion))
        if outcome.learned is not None:
            falls = falls_closed(self.scene, task, outcome.learned)
            if falls or outcome.ran_away:
                self.config = without_pushes(self.config)
            self._use_measured(outcome.learned, falls=falls)
        elif outcome.nothing_there:  # the part is not at its believed value
            self._believe(self.alternative or self.initial)
        return True

    def _use_measured(self, learned: LearnedPart, *, falls: bool) -> None:
        """Use the measured joint, and the value at which the hand left the part.

        Args:
            learned: The measurements of the hand.
            falls: Whether the released part falls closed.
        """
        task, initial = self.plan.task, self.initial
        known, first = (
            scene.object(task.object).T_world_object[:3, 3] for scene in (self.scene, initial)
        )
        offset = learned.offset + known - first
        left = believed_scene(initial, task, learned.value, offset)
        self.unmeasured = initial, initial if falls else left, task
        try:
            self.initial, task, value = with_estimated_joint(
                initial, task, learned.axis.shifted(first - known), learned.value
            )
        except SceneError:  # its file couples the joint with others
            self.unmeasured = None
        else:
            self.plan = replace(self.plan, task=task)
            left = believed_scene(self.initial, task, value, offset)
        self.alternative = left if falls else self.initial
        self._believe(self.initial if falls else left)

    def _switch(self, belief: JointBelief) -> None:
        """Use another hypothesis, and forget the failed grasps and base poses."""
        self.initial, self.grasps, self.failed = belief.scene, [], []
        self.unmeasured, self.alternative = None, None
        self.plan = replace(self.plan, task=belief.task)
        self._believe(belief.as_left()[0])

    def _believe(self, scene: Scene) -> None:
        if scene is not self.scene:
            self.scene = scene
            with self.stopwatch.stage("drive"):
                self.ground = build_navigation_map(
                    scene, self.ground.robot, self.plan.region.keep_out, self.held
                )

    def retry(
        self, here: Float[np.ndarray, "3"], attempts: int, *, leave: bool
    ) -> tuple[Float[np.ndarray, "3"], Motion | None]:
        """Try another grasp at this base pose, then another base pose, then another hypothesis.

        Args:
            here: Current base pose x [m], y [m], yaw [rad].
            attempts: Maximum number of base poses [-].
            leave: Whether to leave this base pose because the arm was blocked.

        Returns:
            The last base pose, and the motion found there, if any.
        """
        while (found := self._next(here, leave)) is None:
            if self.unmeasured is not None:  # no base pose works for the measured joint
                (self.initial, scene, task), self.unmeasured = self.unmeasured, None
                self.alternative = None
                self.plan = replace(self.plan, task=task)
                self._believe(scene)
                continue
            other = self.beliefs.drop_current()
            if other is None:
                return here, None
            self._switch(other)
            leave = False
        if isinstance(found, PlacementPlan):
            return self.drive_and_plan(here, found, attempts)
        return here, found

    def _next(self, here: Float[np.ndarray, "3"], leave: bool) -> Motion | PlacementPlan | None:
        """Plan a motion at this base pose, or else a plan with another one.

        A regrasp passes the edge of the released part more closely than its value is known after a
        failure. So one grasp from another base pose is tried before two grasps from this one.
        """
        task = self.plan.task
        configs = [self.config]
        one_grasp = without_pushes(self.config)
        if task.verb == "open" and not slides(self.scene, task) and one_grasp != self.config:
            configs.insert(0, one_grasp)
        try:
            with self.stopwatch.stage("plan"):
                others = other_grasps(self.scene, task, self.grasps)
                for config in configs:
                    found = None if leave else self._motion(here, config, others).motion
                    if found is not None:
                        return found
                    self.failed.append(here)
                    other = self._other_pose(here, config)
                    if other is not None:
                        return other
        except TaskError:  # the hand has no grasp for a part of this kind
            return None
        return None

    def home_path_planner(self, base: Float[np.ndarray, "3"]) -> PlanHomePath:
        """Return a planner of the arm's path home, with the part where the hand left it.

        Each further call assumes the next most probable hypothesis of the joint.
        """
        calls = 0

        def plan(
            q: Float[np.ndarray, " n"], learned: LearnedPart
        ) -> Float[np.ndarray, "k n"] | None:
            nonlocal calls
            beliefs, task = self.beliefs.ranked(learned.way)[calls:], self.plan.task
            calls += 1
            if not beliefs:
                return None
            scene = believed_scene(self.scene, task, learned.value, learned.offset)
            if beliefs[0] is not None:
                scene, task = beliefs[0].as_left()
            return arm_home_path(
                scene, self.ground.robot, task, base, q, config=self.config, seed=self.plan.seed
            )

        return plan

    def drive_and_plan(
        self, here: Float[np.ndarray, "3"], plan: PlacementPlan | None, attempts: int
    ) -> tuple[Float[np.ndarray, "3"], Motion | None]:
        """Drive to the plan's base pose and replan the arm; on failure try other base poses.

        Returns:
            The last base pose, and the motion found there, if any.
        """
        motion, max_visits = None, len(self.visits) + attempts
        while plan is not None and len(self.visits) < max_visits:
            assert plan.base_pose is not None
            goal = np.array(plan.base_pose)
            with self.stopwatch.stage("drive"):
                driven = self.drive(self.ground, here, goal, self.rng)
            self.trace(driven.times, driven.poses)
            here, reason, now, plan = driven.pose, driven.reason, plan, None
            if driven.arrived:
                with self.stopwatch.stage("plan"):
                    attempt = self._at_plan(now, here)
                motion, reason = attempt.motion, attempt.reason
                self.failed.append(here)
            self.failed.append(goal)
            self.visits.append(_visit(goal, driven, reason))
            # After a collision the run ends: the base must not drive on.
            if motion is None and not driven.hit and len(self.visits) < max_visits:
                with self.stopwatch.stage("plan"):
                    plan = self._other_pose(here, self.config)
                if plan is None:
                    reason = f"{reason}; {NO_POSE_LEFT}"
                    self.visits[-1] = replace(self.visits[-1], reason=reason)
                    plan = now if driven.arrived and _missed(goal, here) else None
        return here, motion

    def _at_plan(self, plan: PlacementPlan, here: Float[np.ndarray, "3"]) -> Attempt:
        """Return the motion at the pose at which a drive to a plan's base pose has ended."""
        if plan.moves_base:
            return motion_from(plan, self.scene, self.ground.robot, here)
        return self._motion(here, self.config)

    def _motion(
        self,
        pose: Float[np.ndarray, "3"],
        config: PipelineConfig,
        grasps: GraspFilter | None = None,
    ) -> Attempt:
        query = self._query(config)
        if self.held is None:
            query = replace(query, keep_grasps=grasps)
        return check_pose(query, pose, how_far=False)

    def _other_pose(
        self, pose: Float[np.ndarray, "3"], config: PipelineConfig
    ) -> PlacementPlan | None:
        """Plan with the cheapest base pose from here that is not near a failed one."""
        try:
            query = replace(self._query(config), start=pose, keep_poses=self._untried)
            result = plan_with_method(query)
        except SceneError:  # the planner's boxes enclose more than the outlines for driving
            return None
        return result.plan if result.plan.feasible else None

    def _query(self, config: PipelineConfig) -> PlacementQuery:
        plan = self.plan
        return PlacementQuery(
            self.scene, self.ground.robot, plan.task, self.reach, config=config,
            region=plan.region, seed=plan.seed, from_home=True,
            keep_grasps=None if self.held is None else grasp_of(plan),
        )  # fmt: skip

    def _untried(self, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return which poses are away from the failed ones and let the base dock."""
        away = poses[:, None] - np.array(self.failed)
        apart = np.hypot(away[..., 0], away[..., 1]) + YAW_WEIGHT * np.abs(wrap_angle(away[..., 2]))
        fits = gaps(poses, self.ground.prisms, self.ground.planning_obstacles) > 0.0
        return np.asarray((apart >= MIN_POSE_DISTANCE).all(1) & fits)


def _missed(goal: Float[np.ndarray, "3"], pose: Float[np.ndarray, "3"]) -> bool:
    """Check that a drive ended so far from its goal that another drive may end nearer."""
    turn = abs(float(wrap_angle(pose[2] - goal[2])))
    return float(np.hypot(*(pose - goal)[:2])) + YAW_WEIGHT * turn > DOCKING_TOLERANCE


def _visit(goal: Float[np.ndarray, "3"], driven: DriveRecord, reason: str) -> Visit:
    return Visit(
        planned=base_triple(goal),
        reached=base_triple(driven.pose),
        length=driven.length,
        seconds=driven.time,
        reason=reason,
        arrived=driven.arrived,
        way=driven.planned if np.isfinite(driven.planned) else None,
        clearance=driven.clearance if np.isfinite(driven.clearance) else None,
        hit=driven.hit,
    )


def base_triple(pose: Float[np.ndarray, "3"]) -> Pose:
    return float(pose[0]), float(pose[1]), float(pose[2])
