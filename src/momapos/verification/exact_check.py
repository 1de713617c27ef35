"""The exact check of a motion: one world a task, many motions.

The planner's spheres, boxes and kinematics are not used here. Shapes are the collision elements
themselves, a mesh as its hull, from which the planner's are made too; states are no farther apart
than the execution's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import pose_planar
from momapos.model.records import Motion, PlacementPlan, Task
from momapos.model.scene import Scene

from . import path_checks as paths
from .exact_shapes import Shapes
from .moved_part import split
from .part_sweep import part_sweep_check
from .polygon import outside
from .report import DEFAULT, Check, Limits, Report, at_most
from .robot_collision_model import Arm, robot_collision_model
from .sweep import all_pairs, deepest

if TYPE_CHECKING:
    from jaxtyping import Float, Int

SWEEP_STEPS = 49
"""The joint's way is cut into so many steps, or a multiple, where base and room are checked [-]."""
DRIVEN_OVER = 0.005
"""What is no higher than this is no obstacle to a base that drives [m]."""
MOST_PAIRS = 6
"""Overlapping pairs that are named one by one [-]."""


@dataclass(frozen=True)
class _Placed:
    """Where everything is at every state of a motion, in the world."""

    path: paths.DensePath
    Ts_tool: Float[np.ndarray, "s 4 4"]
    Ts_base: Float[np.ndarray, "1 b 4 4"]
    """Of the base's shapes."""
    Ts_arm: Float[np.ndarray, "s a 4 4"]
    Ts_part: Float[np.ndarray, "s p 4 4"]


class PlanVerifier:
    """A scene, a robot and a task, prepared for the check of motions.

    Raises:
        UnknownNameError, TaskError, RobotError: They do not fit together.
    """

    def __init__(self, scene: Scene, robot: Arm, task: Task, limits: Limits = DEFAULT) -> None:
        self.limits = limits
        self.task = task
        self.robot_model = robot_collision_model(robot)
        self.part, self.fixed, own = split(scene, task)
        self.part_sweep = part_sweep_check(self.part, self.fixed, own, limits)
        self.floor_polygon = scene.floor_polygon
        self._base, self._arm = self.robot_model.base, self.robot_model.arm
        self._arm_fixed = all_pairs(len(self._arm), len(self.fixed))
        self._base_fixed = all_pairs(len(self._base), len(self.fixed))
        self._part_base = all_pairs(len(self.part.shapes), len(self._base))
        on_part = all_pairs(len(self._arm), len(self.part.shapes))
        holds = self.robot_model.gripper[on_part[:, 0]]
        self._arm_part, self._gripper_part = on_part[~holds], on_part[holds]

    def first_violation(self, base_pose: tuple[float, float, float], motion: Motion) -> str | None:
        """Why a motion is refused, in words that are the same for similar motions; None if not."""
        checks, _ = self._checks(base_pose, motion)
        first = next((check for check in checks if not check.ok), None)
        if first is None:
            return None
        return f"{first.name}: {first.culprit}" if first.culprit else first.name

    def blocked(self, lift: float) -> str | None:
        """What the part runs into on its way, wherever the robot stands; None where it is free.

        Args:
            lift: How far an object without a joint is lifted straight up [m].
        """
        goal = self.part.goal if self.part.joint is not None else lift
        return self.part_sweep.first_hit(goal)

    def check(self, base_pose: tuple[float, float, float], motion: Motion) -> Report:
        """Check a motion at a base pose.

        Args:
            base_pose: x [m], y [m], yaw [rad] of the base link on the floor.
            motion: The motion of the arm and the object.
        """
        checks, placed = self._checks(base_pose, motion)
        if placed is None:
            return Report(checks)
        depth = self._gripper_depth(placed)
        return Report(checks, self._notes(placed.path, depth), depth)

    def _checks(
        self, base_pose: tuple[float, float, float], motion: Motion
    ) -> tuple[tuple[Check, ...], _Placed | None]:
        """All checks, and where everything is at every state; None where it makes no sense."""
        checks = list(paths.number_checks(self.part, motion, base_pose))
        if all(check.ok for check in checks):
            checks += paths.hold_checks(self.part, motion)
        if not all(check.ok for check in checks):
            return tuple(checks), None
        # Before anything is allocated: a step of 1e6 would be cut into millions of states.
        states = paths.count_states(motion, self.limits.step)
        if self.part.joint is not None:
            states += paths.count_cuts(motion.object_q, self.limits.step, SWEEP_STEPS)
        shapes = len(self._arm) + len(self._base) + len(self.part.shapes)
        few = [
            at_most("states to check", states, self.limits.states),
            at_most("poses of shapes to check", states * shapes, self.limits.poses),
        ]
        if not all(check.ok for check in few):
            first = next(check for check in few if not check.ok)
            return (*checks, first), None
        placed = self._placed(base_pose, motion)
        return (*checks, *self._of_placed(placed, motion)), placed

    def drive_checks(self, plan: PlacementPlan) -> tuple[Check, ...]:
        """Check the start that a plan names, and its way from there, with the arm at home.

        Home is where the approach begins; the object is as the scene has it, and left out where
        the robot brings it. What is no higher than a base drives over is no obstacle.
        """
        if plan.motion is None or plan.start is None or plan.base_pose is None:
            return ()
        ends = np.array([plan.start, plan.base_pose])
        way = ends[:1] if plan.base_path is None else plan.base_path
        checks = [] if plan.base_path is None else list(paths.way_checks(way, ends, self.limits))
        if not all(check.ok for check in checks):
            return tuple(checks)
        _, T_base, T_arm = self.robot_model.poses((0.0, 0.0, 0.0), plan.motion.approach[:1])
        Ts_world_base = pose_planar(way)[:, None]
        found, fixed, part = _Overlaps(self.limits.penetration), self.fixed, self.part
        high = fixed.Ts_body_shape[:, 2, 3] + (
            np.abs(fixed.Ts_body_shape[:, 2, :3]) * fixed.half
        ).sum(1)
        tall = high > DRIVEN_OVER
        for shapes, Ts in (
            (self._base, Ts_world_base @ T_base),
            (self._arm, Ts_world_base @ T_arm),
        ):
            pairs = all_pairs(len(shapes), len(fixed))
            found.add(
                shapes, Ts, fixed, fixed.Ts_body_shape[None], pairs[tall[pairs[:, 1]]], _where
            )
            if self.task.verb != "place":
                placed = part.placed(np.array([part.start if part.joint is not None else 0.0]))
                pairs = all_pairs(len(shapes), len(part.shapes))
                found.add(shapes, Ts, part.shapes, placed, pairs, _where)
        return (*checks, found.check("start and way, arm at home"))

    def _placed(self, base_pose: tuple[float, float, float], motion: Motion) -> _Placed:
        path = paths.dense_path(motion, self.limits.step)
        Ts_tool, Ts_base, Ts_arm = self.robot_model.poses(base_pose, path.q)
        Ts = paths.part_poses(self.part, self.task.verb, path, Ts_tool)
        return _Placed(path, Ts_tool, Ts_base, Ts_arm, self.part.placed_at(Ts))

    def _of_placed(self, placed: _Placed, motion: Motion) -> Iterator[Check]:
        """The checks of what is placed."""
        machine, part, limits, path = self.robot_model, self.part, self.limits, placed.path
        Ts_planned = placed.Ts_tool[path.planned[: len(motion.q)]]
        yield from paths.object_checks(part, motion, limits)
        yield from paths.joint_checks(machine, motion, limits)
        yield from paths.home_checks(motion, limits)
        yield from paths.tool_checks(Ts_planned, motion, limits)
        yield from paths.grasp_checks(part, path, placed.Ts_tool, paths.holds_of(motion), limits)
        yield paths.reach_check(part, self.task.verb, motion, Ts_planned, limits)
        Ts_way, where = self._way(placed.Ts_part, path)
        yield self._part_check(Ts_way, where)
        yield self._base_check(placed.Ts_base, Ts_way, where)
        yield self._arm_check(placed.Ts_arm, placed.Ts_part, path)
        yield self._self_check(placed.Ts_base, placed.Ts_arm, path)
        yield _above_floor(self._arm, placed.Ts_arm, path, limits)
        yield from self._on_floor(placed.Ts_base)

    def _way(
        self, Ts_part: Float[np.ndarray, "s p 4 4"], path: paths.DensePath
    ) -> tuple[Float[np.ndarray, "w p 4 4"], Callable[[int], str]]:
        """Every pose of the part's shapes, and how to name it.

        Arm states may be far apart in the joint's value: a joint's way is cut once more.
        """
        if self.part.joint is None:
            return Ts_part, path.where
        held = path.object_q[path.approach :]
        cuts = int(paths.count_cuts(held, self.limits.step, SWEEP_STEPS))
        values = np.unique(np.concatenate([held, np.linspace(held[0], held[-1], cuts + 1)]))
        return self.part.placed(values), lambda state: f"object_q {values[state]:.3f}"

    def _part_check(
        self, Ts_way: Float[np.ndarray, "w p 4 4"], where: Callable[[int], str]
    ) -> Check:
        """The moved part against the room: no deeper than in the scene, but for the tolerance."""
        found, passage, fixed = _Overlaps(self.limits.penetration), self.part_sweep, self.fixed
        found.add(
            self.part.shapes, Ts_way, fixed, fixed.Ts_body_shape[None],
            passage.pairs, where, already=passage.already,
        )  # fmt: skip
        return found.check("moved part in the room")

    def _base_check(
        self,
        Ts_base: Float[np.ndarray, "1 b 4 4"],
        Ts_way: Float[np.ndarray, "w p 4 4"],
        where: Callable[[int], str],
    ) -> Check:
        """The base against the scene, and against the part on all its way."""
        fixed, part = self.fixed, self.part
        found = _Overlaps(self.limits.penetration)
        found.add(
            self._base, Ts_base, fixed, fixed.Ts_body_shape[None],
            self._base_fixed, lambda _: "any state",
        )  # fmt: skip
        found.add(
            part.shapes, Ts_way, self._base, Ts_base, self._part_base, where, swapped=True,
        )  # fmt: skip
        return found.check("base in the scene")

    def _arm_check(
        self,
        Ts_arm: Float[np.ndarray, "s a 4 4"],
        Ts_part: Float[np.ndarray, "s p 4 4"],
        path: paths.DensePath,
    ) -> Check:
        """The arm against the scene, and without the gripper against the part."""
        found = _Overlaps(self.limits.penetration)
        fixed, part = self.fixed, self.part.shapes
        found.add(self._arm, Ts_arm, fixed, fixed.Ts_body_shape[None], self._arm_fixed, path.where)
        found.add(self._arm, Ts_arm, part, Ts_part, self._arm_part, path.where)
        return found.check("arm in the scene")

    def _self_check(
        self,
        Ts_base: Float[np.ndarray, "1 b 4 4"],
        Ts_arm: Float[np.ndarray, "s a 4 4"],
        path: paths.DensePath,
    ) -> Check:
        found = _Overlaps(self.limits.penetration)
        arm, base, machine = self._arm, self._base, self.robot_model
        found.add(arm, Ts_arm, base, Ts_base, machine.arm_base_pairs, path.where)
        found.add(arm, Ts_arm, arm, Ts_arm, machine.arm_arm_pairs, path.where)
        return found.check("robot in itself")

    def _gripper_depth(self, placed: _Placed) -> float:
        depth, _ = deepest(
            self._arm, placed.Ts_arm, self.part.shapes, placed.Ts_part, self._gripper_part, 0.0
        )
        return float(depth.max(initial=0.0))

    def _on_floor(self, Ts_base: Float[np.ndarray, "1 b 4 4"]) -> Iterator[Check]:
        if self.floor_polygon is None:
            return
        outlines = [self._base.outline(index) for index in range(len(self._base))]
        points = [x @ T[:2, :3].T + T[:2, 3] for x, T in zip(outlines, Ts_base[0], strict=True)]
        balls = np.repeat(self._base.ball, [len(x) for x in outlines])
        gaps = outside(self.floor_polygon, np.concatenate([np.empty((0, 2)), *points])) + balls
        worst = float(gaps.max(initial=0.0))
        limit = self.limits.floor_edge
        yield at_most("base outside the floor polygon", 1000 * worst, 1000 * limit, "mm")

    def _notes(self, path: paths.DensePath, gripper_depth: float) -> tuple[str, ...]:
        held = len(path.q) - path.approach
        notes = [f"{held} states of the manipulation and {path.approach} of the approach checked"]
        if gripper_depth > 0.0:
            deep = f"{1000 * gripper_depth:.1f} mm"
            notes.append(f"the gripper overlaps the part it holds by up to {deep}, as it may")
        if self.part.joint is None:
            notes.append("no joint moves: neither the goal nor the grasp's slip is checked")
        return tuple(notes)


def _where(pose: int) -> str:
    return "the start" if pose == 0 else f"base_path[{pose}]"


class _Overlaps:
    """Gathers overlapping pairs, the deepest overlap of each pair of links."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self.worst: dict[tuple[str, str], tuple[float, str]] = {}

    def add(
        self,
        a: Shapes,
        Ts_a: Float[np.ndarray, "s a 4 4"],
        b: Shapes,
        Ts_b: Float[np.ndarray, "#s b 4 4"],
        pairs: Int[np.ndarray, "p 2"],
        where: Callable[[int], str],
        *,
        swapped: bool = False,
        already: Float[np.ndarray, " p"] | float = 0.0,
    ) -> None:
        """Look at pairs of shapes; only what is deeper than `already` counts [m]."""
        depth, state = deepest(a, Ts_a, b, Ts_b, pairs, min(0.0, self.limit))
        depth = depth - already
        for p in np.flatnonzero(state >= 0):
            names = (a.names[pairs[p, 0]], b.names[pairs[p, 1]])
            names = names[::-1] if swapped else names
            if depth[p] > self.worst.get(names, (-np.inf, ""))[0]:
                self.worst[names] = (float(depth[p]), where(int(state[p])))

    def check(self, name: str) -> Check:
        ranked = sorted(self.worst.items(), key=lambda item: -item[1][0])
        deep = ranked[0][1][0] if ranked else min(0.0, self.limit)
        bad = [(names, d, at) for names, (d, at) in ranked if d > self.limit]
        words = [f"{a} in {b} by {1000 * d:.0f} mm at {at}" for (a, b), d, at in bad[:MOST_PAIRS]]
        more = [f"and {len(bad) - MOST_PAIRS} more pairs"] if len(bad) > MOST_PAIRS else []
        culprit = " in ".join(bad[0][0]) if bad else ""
        return at_most(
            name, 1000 * deep, 1000 * self.limit, "mm deep", "; ".join(words + more), culprit
        )


def _above_floor(
    arm: Shapes, Ts_arm: Float[np.ndarray, "s a 4 4"], path: paths.DensePath, limits: Limits
) -> Check:
    """How far the arm dips below z = 0."""
    extent = np.einsum("skj,kj->sk", np.abs(Ts_arm[..., 2, :3]), arm.half)
    low = Ts_arm[..., 2, 3] - extent
    worst, where, culprit = 0.0, "", ""
    for state, index in np.argwhere(low < 0.0).tolist():
        if -low[state, index] <= worst:
            continue
        T = Ts_arm[state, index]
        bottom = float((arm.outline(index) @ T[2, :3]).min() + T[2, 3] - arm.ball[index])
        if -bottom > worst:
            worst, where, culprit = -bottom, path.where(state), arm.names[index]
    return at_most(
        "arm below the floor", 1000 * worst, 1000 * limits.penetration, "mm deep", where, culprit
    )
