"""Check motions exactly: one verifier per task checks many motions.

The planner's spheres, boxes and kinematics are not used. Shapes are the collision elements
themselves, a mesh as its hull or its convex pieces; states are no farther apart than in execution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import contact_text
from momapos.core.geometry import apply, contains, edge_distances, invert, place_points, pose_planar
from momapos.model.records import Motion, MotionLoads, Outline, PlacementPlan, Task
from momapos.model.scene import MAX_STEP_HEIGHT, ResistanceConfig, Scene, area_name

from . import path_checks as paths
from .exact_shapes import Shapes, without_piece
from .hand_checks import DEPTH_CHECK, HandChecker
from .motion_loads import (
    CarriedLoad,
    MeasuredLoads,
    depths_in,
    farthest_outside,
    outline_of,
    outside,
    robot_efforts,
)
from .moved_part import split, way_of
from .part_sweep import depths_below_floor, dips, part_sweep_check
from .path_checks import (
    base_path_checks,
    known_base_checks,
    known_latch_checks,
    latch_checks,
    moving_base_checks,
    time_checks,
    wheel_checks,
)
from .report import DEFAULT, Check, Limits, Report, at_most
from .robot_collision_model import RobotDescription, robot_collision_model
from .sweep import Overlaps, all_pairs

if TYPE_CHECKING:
    from jaxtyping import Float


MIN_OUTSIDE = 0.01
"""Smaller distances outside the outline are not reported [m]."""
MAX_STATES = 100
"""Number of states that are looked at, evenly spaced; more change the distance by millimeters."""
_SHARES = (0.25, 0.5, 0.75, 1.0)
"""Points between the middle of a shape and its corners; a long link may span a notch."""
_CORNERS = np.stack(np.meshgrid(*3 * [(-1.0, 1.0)]), -1).reshape(-1, 3)


def outside_note(
    scene: Scene, moving: Sequence[tuple[Shapes, Float[np.ndarray, "_ _ 4 4"]]]
) -> str | None:
    """Return where and how far shapes leave the floor's outline; None if they stay inside.

    Points above or in the footprint of an object do not count, since no wall can be there. A scene
    with walls has solid ones, so nothing is reported.

    Args:
        scene: The scene.
        moving: Shapes and their world poses, such as those of the arm.
    """
    if scene.floor_polygon is None or scene.walls:
        return None
    spots = [_farthest(scene, *group) for group in moving]
    name, distance, point = max(spots, key=lambda spot: spot[1], default=("", 0.0, np.zeros(2)))
    if distance < MIN_OUTSIDE:
        return None
    return (
        f"{name} is up to {100 * distance:.0f} cm outside the floor's outline at "
        f'({point[0]:.2f}, {point[1]:.2f}); if there are walls, set walls = "floor" in the scene'
    )


def _farthest(
    scene: Scene, shapes: Shapes, Ts: Float[np.ndarray, "s k 4 4"]
) -> tuple[str, float, Float[np.ndarray, "2"]]:
    """Return the shape that is farthest outside, its distance [m] and its farthest point."""
    assert scene.floor_polygon is not None
    Ts = Ts[np.linspace(0, len(Ts) - 1, min(len(Ts), MAX_STATES)).round().astype(int)]
    middle = outside(scene.floor_polygon, Ts[..., :2, 3].reshape(-1, 2)).reshape(Ts.shape[:2])
    near = middle + np.linalg.norm(shapes.half, axis=1) > MIN_OUTSIDE
    worst: tuple[str, float, np.ndarray] = ("", 0.0, np.zeros(2))
    for index in np.flatnonzero(near.any(0)).tolist():
        T = Ts[near[:, index], index]
        rough = _distances(scene, T, _CORNERS * shapes.half[index])[0].max(1)
        state = int(rough.argmax())
        distance, points = _distances(scene, T[state : state + 1], shapes.outline(index))
        at = int(distance[0].argmax())
        far = float(distance[0, at]) + float(shapes.ball[index])
        if far > worst[1]:
            worst = shapes.names[index], far, points[0, at]
    return worst


def _distances(
    scene: Scene, Ts: Float[np.ndarray, "s 4 4"], corners: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "s m"], Float[np.ndarray, "s m 2"]]:
    """Return the distances of points of a shape from the outline [m], and the points.

    Args:
        scene: The scene.
        Ts: World poses of the shape.
        corners: Points whose hull it is, around the origin [m].
    """
    assert scene.floor_polygon is not None
    local = (np.array(_SHARES)[:, None, None] * corners).reshape(-1, 3)
    points = np.asarray(apply(Ts, local))[..., :2]
    flat = points.reshape(-1, 2)
    distance = outside(scene.floor_polygon, flat)
    for item in scene.objects:
        low, high = item.bounds[:, :2]
        distance[((low <= flat) & (flat <= high)).all(1)] = -np.inf
    return distance.reshape(points.shape[:2]), points


MIN_SWEEP_STEPS = 49
"""The part's path is divided into this number of intervals, or a multiple of it [-]."""
MAX_BEYOND_AREA = 0.01
"""How far the base's shapes may extend beyond an area to keep in [m]; robot files round the
footprint that the planner keeps in."""


MAX_NAMED_GAP = 0.03
"""Distance up to which shapes are named that are not in contact: more than the clearance, and the
distance between spheres or boxes of planning and the shapes in them [m]."""


@dataclass(frozen=True, eq=False)
class _Placed:
    """World poses of tool and shapes at every state of a motion."""

    path: paths.DensePath
    Ts_body: Float[np.ndarray, "s r 4 4"]
    """Bodies of the robot."""
    Ts_tool: Float[np.ndarray, "s 4 4"]
    Ts_base: Float[np.ndarray, "#s b 4 4"]
    """One pose of each shape if the base stands still."""
    Ts_arm: Float[np.ndarray, "s a 4 4"]
    Ts_part_body: Float[np.ndarray, "s q 4 4"]
    """Bodies of the moved part."""
    Ts_part: Float[np.ndarray, "s p 4 4"]
    """Shapes of the moved part."""


class PlanVerifier:
    """A verifier of motions for one scene, robot and task.

    Raises:
        UnknownNameError, TaskError, RobotError: The task does not fit the scene or the robot.
    """

    def __init__(
        self, scene: Scene, robot: RobotDescription, task: Task, limits: Limits = DEFAULT
    ) -> None:
        self.limits = limits
        self.scene = scene
        self.task = task
        self.robot_model = robot_collision_model(robot)
        self._drive, self._radius = robot.drive, robot.min_turning_radius
        self.part, self.fixed, own = split(scene, task)
        self.part_sweep = part_sweep_check(self.part, self.fixed, own, limits)
        self._efforts = robot_efforts(
            robot.model, self.robot_model.bodies, robot.base_link, self.robot_model.joints
        )
        self._hand_load = CarriedLoad(scene.object(task.object), task, ResistanceConfig())
        self._hand = HandChecker(
            self.robot_model, robot.grip_force, self.part, scene.object(task.object).model, limits
        )
        self._base, self._arm = self.robot_model.base, self.robot_model.arm
        self._arm_fixed = all_pairs(len(self._arm), len(self.fixed))
        self._base_fixed = all_pairs(len(self._base), len(self.fixed))
        self._part_base = all_pairs(len(self.part.shapes), len(self._base))
        on_part = all_pairs(len(self._arm), len(self.part.shapes))
        on_gripper = self.robot_model.gripper[on_part[:, 0]]
        # The hand holds the part, and nothing that rests on it.
        loose = own.loose[own.of_part[on_part[:, 1]]]
        self._arm_part = on_part[~on_gripper | loose]
        self._measured: tuple[tuple[float, float, float], Motion, MeasuredLoads] | None = None
        self.contacts: dict[str, str] = {}
        """Details of the first motion that was rejected for each reason of `first_violation`."""

    def first_violation(self, base_pose: tuple[float, float, float], motion: Motion) -> str | None:
        """Return why a motion is rejected, in the same words for similar motions, or None."""
        checks, _ = self._checks(base_pose, motion)
        first = next((check for check in checks if not check.ok), None)
        if first is None:
            return None
        reason = f"{first.name}: {first.culprit}" if first.culprit else first.name
        self.contacts.setdefault(reason, f"{first.name}: {first.detail or first.culprit}")
        return reason

    def contact(
        self,
        base_pose: Sequence[float] | Float[np.ndarray, "3"],
        q: Float[np.ndarray, " n"],
        object_q: float,
        obstacle: str,
    ) -> str:
        """Return how deep a robot is in an obstacle, in words; "" if it is far from it.

        Args:
            base_pose: x [m], y [m], yaw [rad] of the base link on the floor.
            q: Values of the arm's joints [rad] or [m].
            object_q: Value of the task's joint [rad] or [m].
            obstacle: OBJECT/LINK; the deepest contact of the robot if nothing in the scene has
                this name.
        """
        model, fixed, part = self.robot_model, self.fixed, self.part.shapes
        _, Ts_base, Ts_arm = model.poses(model.body_poses(base_pose, q[None]))
        found = model.self_overlaps(Ts_base, Ts_arm, lambda _: "", -MAX_NAMED_GAP)
        Ts_fixed = fixed.Ts_body_shape[None]
        found.add(self._arm, Ts_arm, fixed, Ts_fixed, self._arm_fixed, lambda _: "")
        found.add(self._base, Ts_base, fixed, Ts_fixed, self._base_fixed, lambda _: "")
        if self.part.joint is not None:
            Ts_part = self.part.placed(np.array([object_q]))
            found.add(self._arm, Ts_arm, part, Ts_part, self._arm_part, lambda _: "")
        below = depths_below_floor(self._arm, Ts_arm)[0]
        lowest = self._arm.names[int(below.argmax())]
        deep = float(below.max())
        found.worst[lowest, "the floor"] = deep, contact_text(lowest, "the floor", deep)
        among = {pair: one for pair, one in found.worst.items() if obstacle in pair} or found.worst
        depth, words = max(among.values())
        return words.removesuffix(" at ") if depth > -MAX_NAMED_GAP else ""

    def blocked(self, lift: float, slide: Sequence[float] = (0.0, 0.0, 0.0)) -> str | None:
        """Return what the part hits on its path, wherever the robot stands; None if it is free.

        Args:
            lift: Height to which an object without a joint is lifted [m].
            slide: By which vector it is slid before [m].
        """
        if self.part.joint is not None:
            return self.part_sweep.first_hit(self.part.goal)
        part = replace(self.part, way=way_of(lift, slide))
        return replace(self.part_sweep, part=part).first_hit(lift + float(np.linalg.norm(slide)))

    def check(self, base_pose: tuple[float, float, float], motion: Motion) -> Report:
        """Check a motion from a base pose on.

        Args:
            base_pose: x [m], y [m], yaw [rad] of the base link on the floor, at the approach.
            motion: The motion of the arm and the object, and of the base if it moves.
        """
        checks, placed = self._checks(base_pose, motion)
        if placed is None:
            return Report(checks)
        depth = next((c.value / 1000 for c in checks if c.name == DEPTH_CHECK), 0.0)
        notes = (*self._notes(placed, depth), *paths.curve_notes(motion))
        return Report(checks, notes, depth)

    def outside_note(self, base_pose: tuple[float, float, float], motion: Motion) -> str | None:
        """Return where and how far arm or part leave the floor's outline; None if they do not.

        Args:
            base_pose: x [m], y [m], yaw [rad] of the base link on the floor.
            motion: A valid motion.
        """
        return self._outside(self._placed(base_pose, motion))

    def loads(self, base_pose: tuple[float, float, float], motion: Motion) -> MotionLoads:
        """Return the worst loads of a valid motion at a base pose x [m], y [m], yaw [rad]."""
        known = self._measured
        if known is None or known[0] != base_pose or known[1] is not motion:
            known = (
                base_pose,
                motion,
                self._loads(base_pose, motion, self._placed(base_pose, motion)),
            )
        return known[2].record(self._hand_load.mass)

    def load_checks(
        self, base_pose: tuple[float, float, float], motion: Motion, among: str = ""
    ) -> tuple[Check, ...]:
        """Check the efforts and the stability of a valid motion.

        Args:
            base_pose: x [m], y [m], yaw [rad] of the base link on the floor.
            motion: The motion.
            among: What the loads are of, which follows the names of the checks.
        """
        placed = self._placed(base_pose, motion)
        found = self._loads(base_pose, motion, placed).checks(placed.path, self.limits)
        return tuple(replace(check, name=check.name + among) for check in found)

    def _loads(
        self, base_pose: tuple[float, float, float], motion: Motion, placed: _Placed
    ) -> MeasuredLoads:
        force, point = self._hand_load.along(motion, placed.path, placed.Ts_tool)
        needs = self._efforts.efforts(placed.Ts_body, force, point)
        bases = base_pose if placed.path.base is None else placed.path.base
        stability = self._efforts.stability(bases, placed.Ts_body, force, point)
        none = np.zeros((1, 3))
        at_first = self._efforts.stability(base_pose, placed.Ts_body[:1], none, none)
        if at_first is not None and at_first[0] < self.limits.stability:
            stability = None  # the masses of the base in its file are incomplete
        grasp = self._hand.pull_shares(motion, placed.path, placed.Ts_tool, force)
        return MeasuredLoads(self._efforts, needs, stability, grasp)

    def _outside(self, placed: _Placed) -> str | None:
        moving = [(self._arm, placed.Ts_arm), (self.part.shapes, placed.Ts_part)]
        return outside_note(self.scene, moving)

    def _checks(
        self, base_pose: tuple[float, float, float], motion: Motion
    ) -> tuple[tuple[Check, ...], _Placed | None]:
        """Return all checks, and the poses; no poses if the motion is not well formed."""
        checks = list(paths.number_checks(self.part, motion, base_pose))
        checks += known_latch_checks(self.part, motion)
        checks += known_base_checks(base_pose, motion, self._drive)
        if all(check.ok for check in checks):
            checks += paths.hold_checks(self.part, motion)
        if not all(check.ok for check in checks):
            return tuple(checks), None
        # Check the sizes before allocating: a step of 1e6 would make millions of states.
        states = paths.count_states(motion, self.limits.step)
        if self.part.joint is not None:
            states += paths.count_cuts(motion.object_q, self.limits.step, MIN_SWEEP_STEPS)
        shapes = len(self._arm) + len(self._base) + len(self.part.shapes)
        for check in (
            at_most("states to check", states, self.limits.states),
            at_most("poses of shapes to check", states * shapes, self.limits.poses),
        ):
            if not check.ok:
                return (*checks, check), None
        placed = self._placed(base_pose, motion)
        checks += self._motion_checks(placed, motion)
        loads = self._loads(base_pose, motion, placed)
        # The loads of a motion are mostly wanted right after it was found valid.
        self._measured = base_pose, motion, loads
        checks += loads.checks(placed.path, self.limits)
        return tuple(checks), placed

    def drive_checks(self, plan: PlacementPlan) -> tuple[Check, ...]:
        """Check the plan's start and base path, with the arm as at the start of the approach.

        The object is as in the scene; what a task places is in the hand.
        """
        if plan.motion is None or plan.start is None or plan.base_pose is None:
            return ()
        ends = np.array([plan.start, plan.base_pose])
        way = ends[:1] if plan.base_path is None else plan.base_path
        checks: list[Check] = []
        if plan.base_path is not None:
            checks += base_path_checks(way, ends, self.limits)
        if all(check.ok for check in checks):
            checks += wheel_checks(way, self._drive, self._radius)
        if not all(check.ok for check in checks):
            return tuple(checks)
        first = self.robot_model.body_poses((0.0, 0.0, 0.0), plan.motion.approach[:1])
        T_tool, T_base, T_arm = self.robot_model.poses(first)
        Ts_world_base = pose_planar(way)[:, None]
        found, fixed, part = Overlaps(self.limits.penetration), self.fixed, self.part
        high = fixed.Ts_body_shape[:, 2, 3] + (
            np.abs(fixed.Ts_body_shape[:, 2, :3]) * fixed.half
        ).sum(1)
        tall = high > MAX_STEP_HEIGHT
        carried = self.task.verb == "place"
        drives = [(self._base, T_base), (self._arm, T_arm)]
        if carried:
            T_tool_part = self._part_in_hand(plan.base_pose, plan.motion)
            drives.append((part.shapes, part.placed_at((T_tool @ T_tool_part)[:, None])))
        for shapes, Ts_base_shape in drives:
            Ts = Ts_world_base @ Ts_base_shape
            pairs = all_pairs(len(shapes), len(fixed))
            found.add(
                shapes, Ts, fixed, fixed.Ts_body_shape[None], pairs[tall[pairs[:, 1]]], _where
            )
            if not carried:
                placed = part.placed(np.array([part.start if part.joint is not None else 0.0]))
                pairs = all_pairs(len(shapes), len(part.shapes))
                found.add(shapes, Ts, part.shapes, placed, pairs, _where)
        return (*checks, found.check("start and base path collision, arm at home"))

    def _part_in_hand(
        self, base_pose: tuple[float, float, float], motion: Motion
    ) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a placed object in the hand, which puts it where the scene has it."""
        at_goal = self.robot_model.body_poses(base_pose, motion.q[:1])
        T_world_tool = self.robot_model.poses(at_goal)[0][0]
        return invert(T_world_tool) @ self.part.poses(np.zeros(1))[0, 0]

    def region_checks(self, plan: PlacementPlan) -> tuple[Check, ...]:
        """Check that the base keeps out of the plan's areas: at its pose, on its way, and moving.

        The outline of the base counts: of all shapes that do not move with the arm. At its base
        pose it is in one of the areas to keep in.
        """
        region = plan.region
        if plan.motion is None or plan.base_pose is None or not (region.keep_in or region.keep_out):
            return ()
        where = [("base_pose", np.array([plan.base_pose])), ("manipulation.base", plan.motion.base)]
        where.append(("base_path", plan.base_path))
        rest = self.robot_model.body_poses((0.0, 0.0, 0.0), plan.motion.q[:1])
        outline = outline_of(self._base, self.robot_model.poses(rest)[1][0])
        kept = _kept_in(region.keep_in, place_points(np.array([plan.base_pose]), outline)[0])
        if not region.keep_out:
            return kept
        worst, at, inside = 0.0, "", 0
        for name, poses in where:
            if poses is None or not len(poses):
                continue
            outlines = place_points(poses, outline)
            for area in plan.region.keep_out:
                depth = depths_in(np.array(area), outlines)
                inside += int((depth > self.limits.floor_edge).sum())
                if depth.max() > max(worst, self.limits.floor_edge):
                    at = f"{name}[{depth.argmax()}] in the {area_name(area, self.scene)}"
                worst = max(worst, float(depth.max()))
        detail = f"{inside} poses, deepest {at}" if at else ""
        limit = 1000 * self.limits.floor_edge
        out = at_most("base in a keep-out area", 1000 * worst, limit, "mm deep", detail)
        return (*kept, out)

    def _placed(self, base_pose: tuple[float, float, float], motion: Motion) -> _Placed:
        path = paths.dense_path(motion, self.limits.step)
        bases = base_pose if path.base is None else path.base
        Ts_body = self.robot_model.body_poses(bases, path.q)
        Ts_tool, Ts_base, Ts_arm = self.robot_model.poses(Ts_body, base_moves=motion.moves_base)
        Ts = paths.part_poses(self.part, self.task.verb, path, Ts_tool)
        return _Placed(path, Ts_body, Ts_tool, Ts_base, Ts_arm, Ts, self.part.placed_at(Ts))

    def _motion_checks(self, placed: _Placed, motion: Motion) -> Iterator[Check]:
        robot, part, limits, path = self.robot_model, self.part, self.limits, placed.path
        Ts_planned = placed.Ts_tool[path.planned[: len(motion.q)]]
        yield from paths.verb_checks(part, self.task.verb)
        yield from paths.object_checks(part, motion, limits)
        yield from latch_checks(part, motion, limits)
        yield from paths.joint_checks(robot, motion, limits)
        yield from paths.home_checks(self.task, motion, limits)
        yield from paths.level_checks(self.task, path, placed.Ts_part_body, limits)
        yield from time_checks(robot, motion, limits)
        yield from moving_base_checks(path, motion, self._drive, self._radius, limits)
        yield from paths.tool_checks(Ts_planned, motion, limits)
        if self.task.poses:
            yield from paths.pose_checks(self.task.poses, motion, Ts_planned)
            if self.task.verb == "follow":
                yield from paths.follow_checks(self.task, motion, path, placed.Ts_tool, limits)
        else:
            yield from paths.grasp_checks(part, path, placed.Ts_tool, motion.grasps, limits)
            yield paths.reach_check(part, motion, Ts_planned, limits)
            yield from self._hand.checks(motion, path, placed.Ts_tool, placed.Ts_part_body)
        Ts_body, where = self._part_path(placed.Ts_part_body, path)
        Ts_way = self.part.placed_at(Ts_body)
        yield self._part_check(motion, Ts_body, where)
        yield self._part_above_floor(Ts_way, where)
        yield self._base_check(placed, Ts_way, where)
        yield self._arm_check(placed.Ts_arm, placed.Ts_part, path)
        yield self.robot_model.self_check(
            placed.Ts_base, placed.Ts_arm, path.where, limits.penetration
        )
        yield _above_floor(self._arm, placed.Ts_arm, path, limits)
        yield from self._on_floor(placed)

    def _part_path(
        self, Ts_held: Float[np.ndarray, "s b 4 4"], path: paths.DensePath
    ) -> tuple[Float[np.ndarray, "w b 4 4"], Callable[[int], str]]:
        """Return the poses of the part's bodies along its path, and a function that names them.

        Consecutive arm states may be far apart in the joint's value, so its range is sampled, too.
        """
        if self.part.joint is None:
            return Ts_held, path.where
        held = path.object_q[path.approach :]
        cuts = int(paths.count_cuts(held, self.limits.step, MIN_SWEEP_STEPS))
        values = np.unique(np.concatenate([held, np.linspace(held[0], held[-1], cuts + 1)]))
        turned = self.part.turned(len(values))
        if turned is None or path.latch_q is None:
            return self.part.poses(values), lambda state: f"object_q {values[state]:.3f}"
        # The latch turns first; then the part moves with the turned latch.
        latch_q = np.append(path.latch_q, turned)
        values = np.append(path.object_q, values)
        return self.part.poses(values, latch_q), lambda state: f"object_q {values[state]:.3f}"

    def _part_check(
        self,
        motion: Motion,
        Ts_body: Float[np.ndarray, "w b 4 4"],
        where: Callable[[int], str],
    ) -> Check:
        """Check the moved part against the scene, relative to its overlap in the given scene.

        Motions of a task have the same path of the part, which is checked once.
        """
        sweep, part = self.part_sweep, self.part
        if part.joint is not None and part.latch is None and self._on_task(motion):
            found = sweep.on_task
        else:
            found = sweep.overlaps(Ts_body, where)
        return found.check("moved part collision with the scene")

    def _on_task(self, motion: Motion) -> bool:
        """Check whether the joint's values are all between the task's start and goal."""
        low, high = sorted((self.part.start, self.part.goal))
        return bool(low <= motion.object_q.min() and motion.object_q.max() <= high)

    def _part_above_floor(
        self, Ts_way: Float[np.ndarray, "w p 4 4"], where: Callable[[int], str]
    ) -> Check:
        """Check how much deeper below z = 0 the moved part gets than in the given scene."""
        depths, limit = dips(self.part, Ts_way), self.limits.penetration
        worst = float(depths.max())
        detail = where(int(depths.argmax())) if worst > limit else ""
        culprit = self.part.name if worst > limit else ""
        return at_most(
            "moved part below the floor", 1000 * worst, 1000 * limit, "mm deep", detail, culprit
        )

    def _base_check(
        self, placed: _Placed, Ts_way: Float[np.ndarray, "w p 4 4"], where: Callable[[int], str]
    ) -> Check:
        """Check the base against the scene, and against the part on its whole path.

        A base that moves is checked against the part where it is at that state.
        """
        fixed, part, path = self.fixed, self.part, placed.path
        at: Callable[[int], str] = lambda _: "all states"  # noqa: E731
        if path.base is not None:
            Ts_way, where, at = placed.Ts_part, path.where, path.where
        found = Overlaps(self.limits.penetration)
        found.add(
            self._base, placed.Ts_base, fixed, fixed.Ts_body_shape[None], self._base_fixed, at
        )
        found.add(
            part.shapes, Ts_way, self._base, placed.Ts_base, self._part_base, where, swapped=True
        )
        return found.check("base collision with the scene")

    def _arm_check(
        self,
        Ts_arm: Float[np.ndarray, "s a 4 4"],
        Ts_part: Float[np.ndarray, "s p 4 4"],
        path: paths.DensePath,
    ) -> Check:
        """Check the arm against the scene, and the arm without gripper against the part."""
        found = Overlaps(self.limits.penetration)
        fixed, part = self.fixed, self.part.shapes
        found.add(self._arm, Ts_arm, fixed, fixed.Ts_body_shape[None], self._arm_fixed, path.where)
        found.add(self._arm, Ts_arm, part, Ts_part, self._arm_part, path.where)
        return found.check("arm collision with the scene")

    def _on_floor(self, placed: _Placed) -> Iterator[Check]:
        polygon = self.scene.floor_polygon
        if polygon is None:
            return
        worst, state = farthest_outside(polygon, self._base, placed.Ts_base)
        limit = self.limits.floor_edge
        moves = placed.path.base is not None and worst > limit
        detail = placed.path.where(state) if moves else ""
        yield at_most("base outside the floor polygon", 1000 * worst, 1000 * limit, "mm", detail)

    def _notes(self, placed: _Placed, gripper_depth: float) -> tuple[str, ...]:
        path, outside = placed.path, self._outside(placed)
        held = len(path.q) - path.approach
        notes = [f"checked {held} manipulation states and {path.approach} approach states"]
        if gripper_depth > 0.0:
            deep = f"{1000 * gripper_depth:.1f} mm"
            notes.append(f"the gripper overlaps the held part by up to {deep}, which is allowed")
        if self.part.joint is None and not self.task.poses:
            notes.append("the task moves no joint: goal and grasp slip are not checked")
        if outside is not None:
            notes.append(outside)
        return tuple(notes)


def _kept_in(areas: Sequence[Outline], outline: Float[np.ndarray, "k 2"]) -> tuple[Check, ...]:
    """Check that an outline is inside one of some areas; no check without areas."""
    if not areas:
        return ()
    beyond = [
        np.where(contains(area, outline), 0.0, edge_distances(outline, area)).max()
        for area in map(np.array, areas)
    ]
    limit = 1000 * MAX_BEYOND_AREA
    return (at_most("base outside the areas to keep in", 1000 * min(beyond), limit, "mm"),)


def _where(pose: int) -> str:
    return "the start" if pose == 0 else f"base_path[{pose}]"


def _above_floor(
    arm: Shapes, Ts_arm: Float[np.ndarray, "s a 4 4"], path: paths.DensePath, limits: Limits
) -> Check:
    """Check how far the arm extends below z = 0."""
    depth = depths_below_floor(arm, Ts_arm)
    worst, where, culprit = float(depth.max(initial=0.0)), "", ""
    if worst > 0.0:
        state, index = np.unravel_index(int(depth.argmax()), depth.shape)
        where, culprit = path.where(int(state)), without_piece(arm.names[index])
    return at_most(
        "arm below the floor", 1000 * worst, 1000 * limits.penetration, "mm deep", where, culprit
    )
