"""Choose how the arm carries an object while the base drives, so that both get through.

What drives is a robot with its arm in some state, and what it holds. The arm at home comes first.
Where that does not fit, the base drives with the arm in other states, in which robot and object
take up little of the floor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import signed_area
from momapos.model.records import Motion, PlacementPlan
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.arm_motion import carried_at_home, carrying_homes, carrying_states
from momapos.planning.grasps import GraspFilter, TaskMotion
from momapos.planning.navigation import (
    HeldObject,
    NavigationMap,
    build_navigation_map,
    outline_from_above,
)

from .query import PlacementQuery
from .task_setup import PreparedTask

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

GRASPS = 12
"""Number of grasps with which other states than home are sought, evenly among all [-]."""
SHORTLIST = 24
"""Number of states whose exact outlines are compared, for each measure [-]."""
STATES = 3
"""Number of states that are tried for each measure, smallest first [-]."""


SAME_GRASP = 1e-3
"""Sum of the differences of two tool poses below which they are the same grasp [-] and [m]."""


@dataclass(frozen=True, eq=False)
class Carrying:
    """How a robot can carry the object that a task places."""

    query: PlacementQuery
    prepared: PreparedTask
    start: Float[np.ndarray, "3"]
    """Where the base begins: x [m], y [m], yaw [rad]."""

    def maps(self, grasp: int) -> Iterator[NavigationMap]:
        """Yield where the robot fits with the object in a grasp, for each state of its arm."""
        if grasp not in self._known:
            self._known[grasp] = [self._map(grasp, q) for q in self._homes(grasp)]
        yield from self._known[grasp]
        yield from self._others.get(grasp, ())

    def others(self) -> Iterator[tuple[NavigationMap, GraspFilter]]:
        """Yield the maps of other states than home, each with the filter that keeps its grasp."""
        motion = self.prepared.motion
        for grasp, maps in self._others.items():
            for nav_map in maps:
                yield nav_map, _only(motion.Ts_world_tool[grasp, motion.grasp_step])

    def every_map(self) -> Iterator[NavigationMap]:
        """Yield the maps of all grasps."""
        for grasp in range(len(self._held)):
            yield from self.maps(grasp)

    def map_of(self, motion: Motion) -> NavigationMap:
        """Return the map of the state in which a motion begins, with the object in its grasp."""
        robot, task = self.query.robot, self.prepared.motion
        away = np.abs(task.Ts_world_tool[:, task.grasp_step] - motion.Ts_world_tool[0])
        grasp = int(away.sum((1, 2)).argmin())
        q = robot.chain.freedom_values(motion.approach[0])
        every = [*self.maps(grasp)]
        return every[int(np.argmin([np.abs(one.robot.home - q).max() for one in every]))]

    def size(self, nav_map: NavigationMap) -> tuple[float, float]:
        """Return the area [m^2] and the width [m] of a robot with the object, from above."""
        return self._sizes[nav_map]

    @property
    def reason(self) -> str:
        """Return why no grasp can be carried; "" if one may."""
        if any(len(self._homes(grasp)) for grasp in range(len(self._held))) or self._others:
            return ""
        return f"no state of the arm is free of collision with {self.query.task.object} in the hand"

    def _homes(self, grasp: int) -> Float[np.ndarray, "k n"]:
        """Return the preferred states of the arm: home, if it can be, and not `_others`."""
        query, motion = self.query, self.prepared.motion
        if query.carried is not None:
            return query.carried[None]
        if motion.task.level is not None or query.from_home:
            return carrying_homes(query.robot, motion, grasp)
        return query.robot.home[None][: int(self._free_at_home[grasp])]

    @cached_property
    def _free_at_home(self) -> Bool[np.ndarray, " g"]:
        return carried_at_home(self.query.robot, self.prepared.motion)

    @cached_property
    def _held(self) -> tuple[HeldObject, ...]:
        """The object in each grasp."""
        motion, item = self.prepared.motion, self.query.scene.object(self.query.task.object)
        return tuple(HeldObject.of(item, T) for T in motion.Ts_world_tool[:, motion.grasp_step])

    @cached_property
    def _known(self) -> dict[int, list[NavigationMap]]:
        return {}

    @cached_property
    def _sizes(self) -> dict[NavigationMap, tuple[float, float]]:
        return {}

    def _map(self, grasp: int, q: Float[np.ndarray, " n"]) -> NavigationMap:
        query, robot = self.query, self.query.robot
        carrier = robot if np.array_equal(q, robot.home) else robot.with_home(q)
        held = self._held[grasp]
        nav_map = build_navigation_map(query.scene, carrier, query.region.keep_out, held)
        self._sizes[nav_map] = _size(outline_from_above(carrier, held))
        return nav_map

    @cached_property
    def _others(self) -> dict[int, list[NavigationMap]]:
        """The maps of other states than home, by grasp: the smallest by area, and by width.

        A path home ends where the approach begins, so that there are none with it.
        """
        level = self.prepared.motion.task.level
        if level is not None or self.query.from_home or self.query.config.motion.home_again:
            return {}
        robot, count = self.query.robot, len(self._held)
        grasps, states, sizes = [], [], []
        for grasp in np.unique(np.linspace(0, count - 1, GRASPS).astype(int)).tolist():
            q = carrying_states(robot, self.prepared.world, self.prepared.motion, grasp, self.start)
            grasps.append(np.full(len(q), grasp))
            states.append(q)
            sizes.append(self._rough_sizes(grasp, q))
        grasp_of, q, rough = map(np.concatenate, (grasps, states, sizes))
        near = np.unique(np.argsort(rough, axis=0)[:SHORTLIST])
        if not len(near):
            return {}
        exact = np.array([
            _size(outline_from_above(robot.with_home(q[k]), self._held[grasp_of[k]])) for k in near
        ])  # fmt: skip
        best: dict[int, list[NavigationMap]] = {}
        for k in dict.fromkeys(near[np.argsort(exact, axis=0)[:STATES]].ravel().tolist()):
            best.setdefault(int(grasp_of[k]), []).append(self._map(int(grasp_of[k]), q[k]))
        return best

    def _rough_sizes(self, grasp: int, q: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k 2"]:
        """Return the sizes of base, hand and object in arm states, see `_size`, without the arm
        between them, and of the rectangle around them."""
        robot = self.query.robot
        Ts = robot.chain.tool_poses(q)
        points = np.concatenate([np.zeros((1, 3)), *self._held[grasp].hulls])
        carried = (points @ Ts[:, :3, :3].swapaxes(1, 2) + Ts[:, None, :3, 3])[..., :2]
        base = robot.base_outline
        low = np.minimum(carried.min(1), base.min(0))
        high = np.maximum(carried.max(1), base.max(0))
        return np.stack([(high - low).prod(1), 2 * np.maximum(high, -low)[:, 1]], axis=1)


def carrier_of(plan: PlacementPlan, scene: Scene, robot: Robot) -> tuple[Robot, HeldObject | None]:
    """Return the robot with its arm as on the drive of a plan, and what it holds there.

    Args:
        plan: A plan with a motion.
        scene: Its scene.
        robot: Its robot.
    """
    motion, task = plan.motion, plan.task
    if motion is None or task.verb != "place":
        return robot, None
    first = motion.approach[0] if len(motion.approach) else motion.q[0]
    carrier = robot.with_home(robot.chain.freedom_values(first))
    return carrier, HeldObject.of(scene.object(task.object), motion.Ts_world_tool[0])


def grasp_of(plan: PlacementPlan) -> GraspFilter:
    """Return the filter that keeps only the grasp of a plan."""
    assert plan.motion is not None
    return _only(plan.motion.Ts_world_tool[0])


def _only(T_world_tool: Float[np.ndarray, "4 4"]) -> GraspFilter:
    def same(motion: TaskMotion) -> Bool[np.ndarray, " g"]:
        away = np.abs(motion.Ts_world_tool[:, motion.grasp_step] - T_world_tool).sum((1, 2))
        return np.asarray(away < SAME_GRASP)

    return same


def _size(outline: Float[np.ndarray, "k 2"]) -> tuple[float, float]:
    """Return the area of an outline [m^2], and its width about the direction ahead [m]."""
    return float(signed_area(outline)), float(2 * np.abs(outline[:, 1]).max())
