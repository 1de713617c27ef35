"""Plan where a robot stands to bring its tool to a set of poses, and how its arm moves there.

The fewest stops, of these a short drive. Base poses are sampled around the tool poses, and the
reachability map says which of them each serves (all base poses for all tool poses at once). What is
chosen by that is checked: inverse kinematics and collisions, then the arm's motion, the drive and
the exact check. What fails is no longer served from there, and the choice is made again, so that
few base poses are checked (lazy evaluation, as in LazySP: Dellin and Srinivasa 2016).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import InputError, RobotError, look, shortest_order
from momapos.core.geometry import halton
from momapos.model import with_close_states
from momapos.model.collision import FREE, check
from momapos.model.records import Hold, Motion, PoseOutcome, PoseStatus, ReachScorer
from momapos.model.urdf import Boxes
from momapos.planning.arm_motion import (
    PoseArm,
    PoseSequence,
    between_config,
    brief_config,
    free_hands,
    world_tools,
)
from momapos.planning.grasps import FULL_DOF, targets_of, tool_poses_of
from momapos.planning.navigation import BasePath, TravelLengths, plan_path
from momapos.planning.placement import (
    OFF_FLOOR,
    BasePoseRule,
    PlacementGeometry,
    PoseOutcomes,
    Search,
    arm_radius,
    cover_choices,
    fewest_serving_all,
    rules,
    standing_codes,
)

from .query import PlacementQuery
from .result import PlacementResult, plan_of
from .search_setup import optimistic
from .task_setup import PreparedTask, collision_world, cost_map, start_pose
from .tour import Tour

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

SAMPLES_PER_AREA, MIN_SAMPLES, MAX_SAMPLES = 800.0, 4_096, 32_768
"""Base poses that are sampled: a number per area from which some tool pose may be within reach
[1/m^2], and bounds [-]. With 800 they are 10 cm and 45 degrees apart."""
MORE = 2.0
"""So many times as many are sampled around poses that none of the first serves [-]."""
CHECK_ROUNDS = 4
"""How often base poses to choose among are checked, as others take the place of some [-]."""
ALTERNATIVES = 12
"""Base poses that are checked along with each chosen one, those that could replace it [-]."""
PASSES = 3
"""How often each stop is exchanged for one with a shorter drive [-]."""
MIN_GAIN = 0.01
"""A stop is exchanged if that shortens the drive by more [m]."""
_LOOKUPS = 4_000_000
"""Pairs of base pose and tool pose whose scores are in memory at a time [-]."""


def plan_pose_stops(query: PlacementQuery, *, in_order: bool = False) -> Tour:
    """Return from where a robot reaches the poses of a task, and how it moves there.

    The fewest stops that the search finds, of these with a short drive. The order of the poses is
    free unless it is fixed.

    Args:
        query: The question; its task has the poses.
        in_order: Whether the poses must be reached in the order of the task.

    Returns:
        One answer for each stop, whose task has the poses that are reached there, in their order.
        A last one without a plan has the poses that no base pose serves.

    Raises:
        InputError: The region limits the angle to the grasp.
        RobotError: The arm has fewer than six joints, so that it reaches no given pose from most
            base poses.
        SceneError: The robot collides at its start pose.
        UnknownNameError: A pose touches an object that does not exist.
        OutOfTimeError: The time was over.
    """
    robot = query.robot
    if robot.chain.size < FULL_DOF:
        raise RobotError(
            f"{robot.title}: its arm has {robot.chain.size} joints; to reach given tool poses, it "
            f"needs {FULL_DOF}"
        )
    began = query.watch.clock()
    with query.in_time():
        tour = PoseSearch.of(query, in_order=in_order).answer()
    return replace(tour, seconds=query.watch.clock() - began)


@dataclass(eq=False)
class ServingBases:
    """Base poses, and which tool poses each serves as far as is known."""

    bases: Float[np.ndarray, "n 3"]
    travel: Float[np.ndarray, " n"]
    """Driving length from the start [m]."""
    serves: Bool[np.ndarray, "n p"]
    sure: Bool[np.ndarray, " n"]
    """Whether inverse kinematics and collisions were checked."""

    def joined(self, other: ServingBases) -> ServingBases:
        """Return all base poses of both."""
        return ServingBases(
            np.concatenate([self.bases, other.bases]), np.append(self.travel, other.travel),
            np.concatenate([self.serves, other.serves]), np.append(self.sure, other.sure),
        )  # fmt: skip


class _Stop(NamedTuple):
    """A chosen base pose, and the tool poses that it is there for."""

    row: int
    """Its row in the base poses."""
    poses: Int[np.ndarray, " p"]
    """Indices of the tool poses."""


@dataclass(eq=False)
class PoseSearch:
    """The search of one answer."""

    query: PlacementQuery
    in_order: bool
    tools: list[Float[np.ndarray, "_ 4 4"]]
    """Tool poses at which the hand is free, for each pose."""
    reasons: dict[int, str]
    """Why no base pose serves a pose, where that is known."""
    arm: PoseArm | None
    """None if the hand is free at no pose."""
    start: Float[np.ndarray, "3"]
    prepared: PreparedTask
    """The scene and all poses, for driving lengths."""
    counts: Counter[PoseOutcome] = field(default_factory=Counter)
    """Outcomes of the sampled base poses."""
    checked: int = 0
    """Number of base poses whose arm was checked [-]."""
    _motions: dict[tuple[int, bytes], tuple[PreparedTask, Motion]] = field(default_factory=dict)
    """Checked motions, by base pose and poses."""
    _planned: list[_Stop] = field(default_factory=list)
    """Base poses with a planned motion, and the poses that it reaches."""
    _lengths: dict[int, Float[np.ndarray, " n"]] = field(default_factory=dict)
    """Driving lengths from base poses to all others [m]."""
    _paths: dict[tuple[int, bytes], BasePath | None] = field(default_factory=dict)
    """Drives, by base pose and where they begin."""

    @classmethod
    def of(cls, query: PlacementQuery, *, in_order: bool) -> PoseSearch:
        """Prepare the search.

        Raises:
            InputError: The region limits the angle to the grasp.
        """
        if query.region.facing is not None:
            raise InputError("facing is for one grasp, not for tool poses; leave it out")
        scene, robot, task, config, watch = (
            query.scene, query.robot, query.task, query.config, query.watch,
        )  # fmt: skip
        with watch.stage("model"):
            tools = [tool_poses_of(pose) for pose in task.poses]
            reasons: dict[int, str] = {}
            every = targets_of(scene, task, tools)
            for targets in every:
                world = collision_world(robot, targets.motion, config)
                codes = free_hands(robot, world, targets)
                for k in targets.rows.tolist():
                    own = codes[targets.pose == k]
                    tools[k] = tools[k][own == FREE]
                    if not len(tools[k]):
                        reasons[k] = f"the hand hits {world.reason(int(own[0]))}"
            usable = tuple(targets_of(scene, task, tools))
            worlds = tuple(collision_world(robot, one.motion, config) for one in usable)
            arm = None
            if usable:
                pregrasp = config.motion.grasps.pregrasp
                planner = between_config(config.arm_planner)
                arm = PoseArm(robot, usable, worlds, planner, pregrasp, query.seed)
        motion = every[0].motion
        geometry = PlacementGeometry(
            robot, np.stack([pose.T_world_tool for pose in task.poses])[None],
            Boxes.join([motion.static, motion.sweep()]), Boxes.join([]), scene.floor_polygon,
            config.place.clearance,
        )  # fmt: skip
        with watch.stage("drive"):
            start = start_pose(scene, robot, motion, query.start, query.nav_map)
        world = collision_world(robot, motion, config)
        prepared = PreparedTask(scene, robot, task, motion, world, geometry, "")
        found = cls(query, in_order, tools, reasons, arm, start, prepared)
        for k in np.flatnonzero(np.isnan(arm_radius(geometry))).tolist():
            reasons.setdefault(k, str(PoseOutcome(PoseStatus.OUT_OF_REACH_ANYWHERE)))
            tools[k] = tools[k][:0]
        return found

    def answer(self) -> Tour:
        """Return the stops; tool poses that no base pose serves come last."""
        usable = self.usable
        with self.query.watch.stage("search"):
            rows = self.rows_of(self._samples(usable))
        steps, served = self._most(rows)
        lost = np.setdiff1d(usable, served)
        if len(lost):
            rows = self._with_more(rows, lost)
            more, then = self._most(rows)
            steps, served = (more, then) if len(then) > len(served) else (steps, served)
        stops = list(range(1, 1 + len(steps)))
        lost = np.setdiff1d(np.arange(len(self.tools)), served)
        if len(lost):
            steps.append(self._refused(lost))
            stops.append(len(steps))
        return Tour(tuple(steps), tuple(stops), scenes=(self.query.scene,) * len(steps))

    def _most(self, rows: ServingBases) -> tuple[list[PlacementResult], Int[np.ndarray, " k"]]:
        """Return the stops for all poses that some base pose serves, and these poses."""
        while True:
            served = np.flatnonzero(rows.serves.any(0))
            steps = self._stops(rows, served) if len(served) else []
            if steps is not None:
                return steps, served

    def _with_more(self, rows: ServingBases, lost: Int[np.ndarray, " k"]) -> ServingBases:
        """Return more base poses around poses that none serves, and plan longer from now on."""
        query = self.query
        with query.watch.stage("search"):
            bases = self._samples(lost, MORE, query.seed + 1)
            more = self.rows_of(bases, reach=optimistic(query.reach))
        kept = more.serves[:, lost].any(1)
        more = ServingBases(more.bases[kept], more.travel[kept], more.serves[kept], more.sure[kept])
        if self.arm is not None:
            self.arm = replace(self.arm, planner=brief_config(query.config.arm_planner))
        self._lengths.clear()
        return rows.joined(more)

    def _stops(
        self, rows: ServingBases, served: Int[np.ndarray, " k"]
    ) -> list[PlacementResult] | None:
        """Return the stops that serve some poses; None if one of these has no base pose left."""
        while rows.serves[:, served].any(0).all():
            look()
            with self.query.watch.stage("search"):
                stops = self._choice(rows, served)
                if not stops:
                    return None
                others = self._alternatives(rows, stops)
                unsure = others[~rows.sure[others]]
                if len(unsure):
                    self.check(rows, unsure)
                    continue
            steps = self._steps(rows, stops)
            if steps is not None:
                return steps
        return None

    # The base poses.

    def rows_of(
        self,
        bases: Float[np.ndarray, "n 3"],
        *,
        reach: ReachScorer | None = None,
        by_map: bool = True,
        every: bool = False,
    ) -> ServingBases:
        """Return the base poses that stand clear and that the robot may drive to.

        Args:
            bases: Base poses x [m], y [m], yaw [rad].
            reach: The reachability map; that of the query by default.
            by_map: Whether the reachability map says which poses each serves, and those that serve
                none are left out; else all poses within the arm's length count.
            every: Whether base poses that serve none are kept.
        """
        query, geometry, usable = self.query, self.prepared.geometry, self.usable
        kept = standing_codes(geometry, bases)
        off, blocked = kept == OFF_FLOOR, (kept != OFF_FLOOR) & (kept != FREE)
        self.counts[PoseOutcome(PoseStatus.OFF_FLOOR)] += int(off.sum())
        self.counts[PoseOutcome(PoseStatus.BASE_BLOCKED)] += int(blocked.sum())
        bases = bases[kept == FREE]
        travel = self.travel(self.start)(bases)
        no_route = PoseOutcome(PoseStatus.NO_ROUTE)
        drives = BasePoseRule(lambda _, lengths: np.isfinite(lengths), no_route)
        for rule in (*rules(query.region, geometry), drives):
            fits = rule.keeps(bases, travel)
            self.counts[rule.otherwise] += int((~fits).sum())
            bases, travel = bases[fits], travel[fits]
        if query.keep_poses is not None and len(bases):
            fits = query.kept(bases)
            self.counts[PoseOutcome(PoseStatus.FILTERED)] += int((~fits).sum())
            bases, travel = bases[fits], travel[fits]
        serves = np.zeros((len(bases), len(self.tools)), bool)
        if len(usable):
            scorer = (reach or query.reach) if by_map else None
            serves[:, usable] = self._reached(bases, usable, scorer)
        some = serves.any(1) | (not by_map) | every
        self.counts[PoseOutcome(PoseStatus.OUT_OF_REACH)] += int((~some).sum())
        return ServingBases(
            bases[some], travel[some], serves[some], np.zeros(int(some.sum()), bool)
        )

    @property
    def usable(self) -> Int[np.ndarray, " k"]:
        """Return the poses at which the hand is free."""
        return np.flatnonzero([len(one) > 0 for one in self.tools])

    def _reaches(
        self, poses: Int[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, " k"]]:
        """Return the position of some poses, and how far the base may be from each [m]."""
        geometry = self.prepared.geometry
        reach = (arm_radius(geometry) + np.linalg.norm(geometry.shoulder[:2]))[poses]
        return geometry.Ts_world_tool[0, poses, :2, 3], reach

    def rectangle(
        self, poses: Int[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
        """Return the corners of the floor from which some poses may be within reach [m]."""
        if not len(poses):
            return np.zeros(2), np.zeros(2)
        floor = self.prepared.geometry.floor_polygon
        points, reach = self._reaches(poses)
        low, high = (points - reach[:, None]).min(0), (points + reach[:, None]).max(0)
        if floor is None:
            return low, high
        return np.maximum(low, floor.min(0)), np.minimum(high, floor.max(0))

    def _samples(
        self, poses: Int[np.ndarray, " k"], share: float = 1.0, seed: int | None = None
    ) -> Float[np.ndarray, "n 3"]:
        """Return base poses spread evenly over the floor from which a pose may be within reach.

        Args:
            poses: Indices of the poses.
            share: Number of base poses, relative to the usual one.
            seed: Shifts them; that of the query by default.
        """
        low, high = self.rectangle(poses)
        if (low >= high).any():
            return np.zeros((0, 3))
        points, reach = self._reaches(poses)
        area = float(np.prod(high - low))
        count = int(share * np.clip(SAMPLES_PER_AREA * area, MIN_SAMPLES, MAX_SAMPLES))
        shift = np.random.default_rng(self.query.seed if seed is None else seed).uniform(size=3)
        unit = (halton(count, 3) + shift) % 1.0
        bases = np.column_stack([low + unit[:, :2] * (high - low), np.pi * (2 * unit[:, 2] - 1)])
        near = np.zeros(count, bool)
        for point, most in zip(points, reach.tolist(), strict=True):
            near |= np.hypot(*(bases[:, :2] - point).T) <= most
        return bases[near]

    def _reached(
        self,
        bases: Float[np.ndarray, "n 3"],
        poses: Int[np.ndarray, " k"],
        reach_map: ReachScorer | None,
    ) -> Bool[np.ndarray, "n k"]:
        """Return which poses may be within reach from which base poses, by a map or by length."""
        if reach_map is None:
            points, reach = self._reaches(poses)
            return np.hypot(*(bases[:, None, :2] - points).transpose(2, 0, 1)) <= reach
        tools = [self.tools[k] for k in poses.tolist()]
        Ts = np.ascontiguousarray(np.concatenate(tools)[:, None])
        first = np.cumsum([0, *map(len, tools[:-1])])
        out = np.zeros((len(bases), len(poses)), bool)
        block = max(1, _LOOKUPS // len(Ts))
        for k in range(0, len(bases), block):
            look()
            scores = reach_map.min_score(bases[k : k + block], Ts)
            out[k : k + block] = np.logical_or.reduceat(scores > 0.0, first, axis=1)
        return out

    def travel(self, start: Float[np.ndarray, "3"]) -> TravelLengths:
        """Return the driving lengths from a base pose."""
        costs = cost_map(self.prepared, start, self.query.region.keep_out)
        return TravelLengths(costs, self.query.robot, start)

    # The choice of the stops.

    def _choice(self, rows: ServingBases, served: Int[np.ndarray, " k"]) -> list[_Stop]:
        """Return the base pose of each stop, and the poses it is there for."""
        if self.in_order:
            return self._runs(rows, served)
        serves = rows.serves[:, served]
        cost = rows.travel.copy()
        cost[list({row for row, _ in self._planned})] = 0.0
        some = np.flatnonzero(serves.all(1))
        if not len(some):
            some = self._checked_choices(rows, served, cost)
            serves = rows.serves[:, served]
            if not serves.any(0).all():
                return []
        chosen = self._shorter(rows, serves, some[fewest_serving_all(serves[some], cost[some])])
        return self._assigned(chosen, serves, served)

    def _checked_choices(
        self, rows: ServingBases, served: Int[np.ndarray, " k"], cost: Float[np.ndarray, " n"]
    ) -> Int[np.ndarray, " r"]:
        """Return base poses to choose among, most of them checked."""
        for _ in range(CHECK_ROUNDS):
            some = cover_choices(rows.serves[:, served], cost)
            unsure = some[~rows.sure[some]]
            if not len(unsure):
                break
            self.check(rows, unsure)
        return cover_choices(rows.serves[:, served], cost)

    def _assigned(
        self, chosen: Int[np.ndarray, " k"], serves: Bool[np.ndarray, "n p"],
        served: Int[np.ndarray, " p"],
    ) -> list[_Stop]:  # fmt: skip
        """Assign each pose to a stop: to one with a planned motion, else to the first."""
        owner = np.full(len(served), -1)
        for row, poses in self._planned:
            if row in chosen:
                owner[(owner < 0) & np.isin(served, poses) & serves[row]] = row
        for row in chosen.tolist():
            owner[(owner < 0) & serves[row]] = row
        return [_Stop(k, served[owner == k]) for k in chosen.tolist() if (owner == k).any()]

    def _runs(self, rows: ServingBases, served: Int[np.ndarray, " k"]) -> list[_Stop]:
        """Return the stops for poses in their order: each serves as many of the next as any."""
        stops, first, travel = [], 0, rows.travel
        while first < len(served):
            run = np.logical_and.accumulate(rows.serves[:, served[first:]], axis=1).sum(1)
            row = int(np.lexsort((travel, -run))[0])
            stops.append(_Stop(row, served[first : first + run[row]]))
            first += int(run[row])
            travel = self._lengths_from(rows, row)
        return stops

    def _shorter(
        self, rows: ServingBases, serves: Bool[np.ndarray, "n p"], chosen: Int[np.ndarray, " k"]
    ) -> Int[np.ndarray, " k"]:
        """Exchange stops for others that shorten the drive, and order them by it."""
        for _ in range(PASSES):
            between = np.stack([self._lengths_from(rows, int(row))[chosen] for row in chosen])
            order = shortest_order(
                rows.travel[chosen], (between + between.T) / 2, np.zeros(len(chosen))
            )
            chosen, changed = chosen[order], False
            for k in range(len(chosen)):
                need = ~serves[np.delete(chosen, k)].any(0)
                able = np.flatnonzero(serves[:, need].all(1))
                cost = rows.travel[able]
                if k > 0:
                    cost = self._lengths_from(rows, int(chosen[k - 1]))[able]
                if k + 1 < len(chosen):
                    cost = cost + self._lengths_from(rows, int(chosen[k + 1]))[able]
                best = able[int(cost.argmin())]
                if cost.min() < cost[able == chosen[k]][0] - MIN_GAIN:
                    chosen, changed = chosen.copy(), True
                    chosen[k] = best
            if not changed:
                break
        return chosen

    def _lengths_from(self, rows: ServingBases, row: int) -> Float[np.ndarray, " n"]:
        """Return the driving lengths from one base pose to all, computed once."""
        if row not in self._lengths:
            self._lengths[row] = self.travel(rows.bases[row])(rows.bases)
        return self._lengths[row]

    def _alternatives(self, rows: ServingBases, stops: Sequence[_Stop]) -> Int[np.ndarray, " r"]:
        """Return the chosen base poses, and with unchecked ones others that could replace them."""
        chosen = [row for row, _ in stops]
        if rows.sure[chosen].all():
            return np.array(chosen)
        found = [np.array(chosen)]
        for row, poses in stops:
            if not rows.sure[row]:
                able = np.flatnonzero(rows.serves[:, poses].all(1) & ~rows.sure)
                away = np.hypot(*(rows.bases[able, :2] - rows.bases[row, :2]).T)
                found.append(able[np.argsort(away, kind="stable")[:ALTERNATIVES]])
        return np.unique(np.concatenate(found))

    # The checks.

    def check(self, rows: ServingBases, which: Int[np.ndarray, " r"]) -> None:
        """Check with inverse kinematics and for collisions what some base poses serve."""
        assert self.arm is not None
        robot, bases = self.query.robot, rows.bases[which]
        home = check(
            self.prepared.world, robot.chain, robot.spheres.by_hulls,
            np.tile(robot.home, (len(which), 1)), bases, np.zeros(len(which), np.int64),
            np.zeros(len(which), bool),
        )  # fmt: skip
        for code in home[home != FREE].tolist():
            outcome = PoseOutcome(PoseStatus.HOME_COLLISION, self.prepared.world.reason(code))
            self.counts[outcome] += 1
        rows.serves[which[home != FREE]] = False
        self.checked += len(which)
        row, pose = np.nonzero(rows.serves[which])
        reached = self.arm.reaches(np.ascontiguousarray(bases[row]), pose)
        rows.serves[which[row[~reached]], pose[~reached]] = False
        rows.sure[which] = True

    def _steps(self, rows: ServingBases, stops: Sequence[_Stop]) -> list[PlacementResult] | None:
        """Plan the motions at all stops; None if one fails, which then no longer serves poses."""
        arms = [self._arm_motion(rows, row, poses) for row, poses in stops]
        if any(arm is None for arm in arms):
            return None
        at, paths = self.start, []
        for row, _ in stops:
            paths.append(self._path(rows, row, at))
            at = rows.bases[row]
        if any(path is None for path in paths):
            return None
        return [
            self._step(rows.bases[row], *arm, path)
            for (row, _), arm, path in zip(stops, arms, paths, strict=True)
            if arm is not None and path is not None
        ]

    def _arm_motion(
        self, rows: ServingBases, row: int, poses: Int[np.ndarray, " p"]
    ) -> tuple[PreparedTask, Motion] | None:
        """Plan the motion of the arm at a base pose, once; None if it fails there."""
        key = row, poses.tobytes()
        if key not in self._motions:
            assert self.arm is not None
            query, base = self.query, rows.bases[row]
            with query.watch.stage("search"):
                found = self.arm.sequence(base, poses, in_order=self.in_order)
            refused = np.setdiff1d(poses, found.poses)
            self.counts[PoseOutcome(PoseStatus.NO_APPROACH)] += len(refused)
            rows.serves[row, refused] = False
            if not len(found.poses):
                return None
            motion = self._motion(base, found)
            prepared = self._prepared(found.poses, motion)
            with query.watch.stage("exact check"):
                why = prepared.violation(base, motion)
            if why is not None:
                self.counts[PoseOutcome(PoseStatus.EXACT_CHECK, why)] += 1
                rows.serves[row] = False
                return None
            self._motions[row, np.sort(found.poses).tobytes()] = prepared, motion
            self._planned.append(_Stop(row, found.poses))
        return self._motions.get(key)

    def _path(self, rows: ServingBases, row: int, at: Float[np.ndarray, "3"]) -> BasePath | None:
        """Plan the drive to a base pose, once; None if there is none."""
        key = row, at.tobytes()
        if key not in self._paths:
            with self.query.watch.stage("path"):
                self._paths[key] = plan_path(self.query.nav_map, at, rows.bases[row])
        if self._paths[key] is None:
            self.counts[PoseOutcome(PoseStatus.NO_ROUTE_AT_HOME)] += 1
            rows.serves[row] = False
        return self._paths[key]

    def _step(
        self, base: Float[np.ndarray, "3"], prepared: PreparedTask, motion: Motion, path: BasePath
    ) -> PlacementResult:
        """Return the answer of one stop."""
        start = path.poses[0]
        query = replace(self.query, task=prepared.task, start=start)
        search = Search(checked=self.checked, base=base, motion=motion, cost=path.length)
        search.note(base[None], PoseOutcomes([PoseOutcome(PoseStatus.FEASIBLE)]))
        plan = plan_of(query, prepared, search, start, path)
        plan = replace(plan, timing=query.watch.timing)
        return PlacementResult(plan, prepared, search, start, query)

    def _motion(self, base: Float[np.ndarray, "3"], found: PoseSequence) -> Motion:
        """Return the motion of an arm through its poses, as a plan has it."""
        chain, q = self.query.robot.chain, found.q
        first, last = int(found.at[0]), int(found.at[-1])
        names = [self.query.task.pose_names[k] for k in found.poses.tolist()]
        at = (found.at - first).tolist()
        holds = [Hold(k, k, words=one) for k, one in zip(at, names, strict=True)]
        held = q[first : last + 1]
        joints = chain.joint_values(held)
        motion = Motion(
            chain.joint_values(q[: first + 1]), joints, np.zeros(len(held)),
            world_tools(chain, base, joints, None), holds=tuple(holds),
            home=chain.joint_values(q[last + 1 :]),
        )  # fmt: skip
        return with_close_states(motion, partial(world_tools, chain, base))

    def _prepared(self, poses: Int[np.ndarray, " p"], motion: Motion) -> PreparedTask:
        """Return the task of one stop, whose only grasp is the path of the tool there."""
        task = replace(self.query.task, poses=tuple(self.query.task.poses[k] for k in poses))
        assert self.arm is not None
        steps = len(motion.q)
        one = self.arm.targets[0].motion.only(np.arange(len(self.arm.targets[0].pose)) == 0)
        along = replace(
            one, task=task, Ts_world_tool=np.ascontiguousarray(motion.Ts_world_tool[None]),
            object_q=np.zeros(steps), value=np.zeros(steps, np.int64),
            holding=np.zeros(steps, bool),
            waypoint_steps=np.array([hold.first for hold in motion.holds]),
        )  # fmt: skip
        return replace(
            self.prepared, task=task, motion=along,
            geometry=replace(
                self.prepared.geometry,
                Ts_world_tool=np.ascontiguousarray(along.Ts_world_tool[:, along.waypoint_steps]),
            ),
        )  # fmt: skip

    def _refused(self, lost: Int[np.ndarray, " k"]) -> PlacementResult:
        """Return the answer for poses that no base pose serves, with the reasons."""
        query = self.query
        task = replace(query.task, poses=tuple(query.task.poses[k] for k in lost))
        search = Search(checked=self.checked)
        outcomes = [
            PoseOutcome(PoseStatus.TASK_INFEASIBLE, f"{name}: {self.reasons[k]}")
            for name, k in zip(task.pose_names, lost.tolist(), strict=True)
            if k in self.reasons
        ]
        outcomes += [one for one, count in self.counts.items() for _ in range(count)]
        search.note(np.zeros((len(outcomes), 3)), PoseOutcomes(outcomes))
        own = replace(query, task=task)
        prepared = replace(self.prepared, task=task)
        plan = plan_of(own, prepared, search, self.start, None)
        return PlacementResult(plan, prepared, search, self.start, own)
