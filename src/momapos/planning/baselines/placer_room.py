"""Provide base placers with a scene, a robot, a task and the checks they may make."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from momapos.core.geometry import all_inside, contains, place_points
from momapos.model.collision import FREE, base_hits, check
from momapos.model.records import ReachScorer, TravelCost
from momapos.model.robots import Robot
from momapos.model.scene import upright_boxes
from momapos.model.urdf import Boxes
from momapos.planning.arm_motion import layer_jobs, solve_layers, task_arrays
from momapos.planning.config import BaselineConfig
from momapos.planning.grasps import slides
from momapos.planning.placement import arm_radius
from momapos.planning.task_setup import PreparedTask

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

GRASP_WAYPOINT = 1
"""Index of the waypoint at which the hand grasps; the one before is the pre-grasp."""
_MIN_HORIZONTAL = 0.1
"""A hand whose approach direction has a smaller horizontal part comes from above [-]."""
_BLOCK = 1024
"""Base poses whose reachability is looked up together [-]."""


class BasePlacer(Protocol):
    """Yields base poses (x [m], y [m], yaw [rad]) in the order in which it would try them."""

    def __call__(
        self, room: PlacerRoom, rng: np.random.Generator
    ) -> Iterator[Float[np.ndarray, "n 3"]]: ...


@dataclass(frozen=True, eq=False)
class PlacerRoom:
    """A scene, a robot and a task, as a base placer sees them."""

    prepared: PreparedTask
    reach: ReachScorer
    """The robot's reachability map."""
    travel_cost: TravelCost
    start: Float[np.ndarray, "3"]
    """Start pose of the base: x [m], y [m], yaw [rad]."""
    grasps: int
    """Maximum number of grasps checked at one base pose, the best reached first [-]."""
    knows: BaselineConfig = field(default_factory=BaselineConfig)
    """What the placer knows of objects and grasps."""

    @property
    def robot(self) -> Robot:
        """The mobile manipulator."""
        return self.prepared.robot

    @property
    def Ts_world_tool(self) -> Float[np.ndarray, "g w 4 4"]:
        """Tool poses of every grasp that the placer knows, at every waypoint."""
        return self.prepared.geometry.Ts_world_tool[: 1 if self.knows.one_grasp else None]

    @property
    def slides(self) -> bool:
        """Whether the part is a drawer."""
        return slides(self.prepared.scene, self.prepared.task)

    @property
    def articulated(self) -> bool:
        """Whether the task moves a joint."""
        return self.prepared.task.joint is not None

    @cached_property
    def whole_boxes(self) -> Boxes:
        """The objects' bounding boxes, without the one that would hide a rigid target."""
        task = self.prepared.task
        items = [
            o for o in self.prepared.scene.objects if self.articulated or o.name != task.object
        ]
        return upright_boxes(items)

    @cached_property
    def target(self) -> Float[np.ndarray, "3"]:
        """Position of the first grasp [m]."""
        return self.Ts_world_tool[0, GRASP_WAYPOINT, :3, 3].copy()

    @cached_property
    def handle_frame(self) -> Float[np.ndarray, "3"]:
        """Frame at the handle, x out of the furniture: x [m], y [m], yaw [rad]."""
        return np.append(self.target[:2], self._outward)

    @cached_property
    def object_frame(self) -> Float[np.ndarray, "3"]:
        """Frame at the middle of the object's depth and the part's width, x out of the front."""
        box = upright_boxes([self.prepared.scene.object(self.prepared.task.object)])
        out = np.array([np.cos(self._outward), np.sin(self._outward)])
        side, middle = np.array([-out[1], out[0]]), box.center[0, :2]
        motion, closing = self.prepared.motion, self.prepared.task.verb == "close"
        closed = motion.moving.at(int(motion.value[-1 if closing else 0])).center[:, :2]
        part = (closed.min(0) + closed.max(0)) / 2
        return np.append(middle + side * ((part - middle) @ side), self._outward)

    @cached_property
    def _outward(self) -> float:
        """Yaw of the front: the side of the object's box from which the hand approaches."""
        box = upright_boxes([self.prepared.scene.object(self.prepared.task.object)])
        back = -self.Ts_world_tool[0, GRASP_WAYPOINT, :2, :3] @ self.robot.approach_axis
        if np.hypot(*back) < _MIN_HORIZONTAL:
            back = self.target[:2] - box.center[0, :2]
        sides = np.concatenate([box.rotation[0, :2, :2].T, -box.rotation[0, :2, :2].T])
        side = sides[int(np.argmax(sides @ back))]
        return float(np.arctan2(side[1], side[0]))

    def facing(
        self, xy: Float[np.ndarray, "n 2"], toward: Float[np.ndarray, "2"]
    ) -> Float[np.ndarray, "n 3"]:
        """Return base poses at positions, facing a point."""
        away = toward - xy
        return np.column_stack([xy, np.arctan2(away[:, 1], away[:, 0])])

    def cells(
        self, middle: Float[np.ndarray, "2"], radius: float, size: float
    ) -> Float[np.ndarray, "n 2"]:
        """Return the centers of square cells around a point [m]."""
        steps = (np.arange(2 * int(np.ceil(radius / size))) + 0.5) * size
        x, y = np.meshgrid(steps - steps.mean(), steps - steps.mean(), indexing="ij")
        return np.stack([x, y], -1).reshape(-1, 2) + middle

    def navigable(self, xy: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Check that a disc inside the base can drive to each position from the start."""
        return np.isfinite(self.travel_cost(xy))

    def stands_clear(self, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Check that the robot, with its arm at home, touches nothing before the task."""
        prepared = self.prepared
        motion, geometry = prepared.motion, prepared.geometry
        clear = self.inside(poses)
        near = np.flatnonzero(clear)
        standing = self.whole_boxes if self.knows.boxes else motion.static_obstacles()
        hits = base_hits(poses[near], self.robot.base, standing, clearance=geometry.clearance)
        clear[near] = hits == FREE
        near = np.flatnonzero(clear)
        home = np.tile(self.robot.home, (len(near), 1))
        value = np.full(len(near), motion.value[0])
        carrying = np.full(len(near), prepared.task.verb == "place")
        codes = check(
            prepared.world, self.robot.chain, self.robot.spheres, home,
            np.ascontiguousarray(poses[near]), value, carrying,
        )  # fmt: skip
        clear[near] = codes == FREE
        return clear

    def inside(self, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Check that the whole base is on the floor; True if the floor is unbounded."""
        polygon = self.prepared.geometry.floor_polygon
        if polygon is None:
            return np.ones(len(poses), bool)
        return all_inside(polygon, place_points(poses, self.robot.footprint))

    def on_floor(self, xy: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Check that positions are on the floor; True if the floor is unbounded."""
        polygon = self.prepared.geometry.floor_polygon
        return np.ones(len(xy), bool) if polygon is None else contains(polygon, xy)

    @cached_property
    def eye_height(self) -> float:
        """Height of the robot's head: the top of its body [m]."""
        base = self.robot.base
        top = base.center[:, 2] + (np.abs(base.rotation[:, 2]) * base.half).sum(1)
        return float(max(top.max(), self.prepared.geometry.shoulder[2]))

    def within_arm(self, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Check that the target is within the arm's length."""
        axis = place_points(poses, self.prepared.geometry.shoulder[None, :2])[:, 0]
        away = np.linalg.norm(axis - self.target[:2], axis=1)
        return away <= arm_radius(self.prepared.geometry)[GRASP_WAYPOINT]

    def scores(
        self, poses: Float[np.ndarray, "n 3"], waypoints: Sequence[int]
    ) -> Float[np.ndarray, "n g w"]:
        """Return the reachability of every grasp at each of some waypoints, in [0, 1]."""
        grasps = len(self.Ts_world_tool)
        each = np.ascontiguousarray(self.Ts_world_tool[:, list(waypoints)].reshape(-1, 1, 4, 4))
        out = np.empty((len(poses), grasps, len(waypoints)), np.float32)
        for first in range(0, len(poses), _BLOCK):
            block = slice(first, first + _BLOCK)
            out[block] = self.reach.min_score(poses[block], each).reshape(-1, *out.shape[1:])
        return out

    def holds_at(
        self, poses: Float[np.ndarray, "n 3"], waypoints: Sequence[int]
    ) -> Bool[np.ndarray, " n"]:
        """Check that one grasp has a collision-free arm state at each of some waypoints."""
        scores = self.scores(poses, waypoints).min(2)
        order = np.argsort(-scores, axis=1, kind="stable")[:, : self.grasps]
        base, rank = np.nonzero(np.take_along_axis(scores, order, 1) > 0)
        jobs, grasps = np.arange(len(base)), order[base, rank][:, None]
        for waypoint in waypoints:
            jobs = self._free(poses[base], grasps, jobs, waypoint)
        held = np.zeros(len(poses), bool)
        held[base[jobs]] = True
        return held

    def _free(
        self,
        bases: Float[np.ndarray, "j 3"],
        grasps: Int[np.ndarray, "j 1"],
        jobs: Int[np.ndarray, " a"],
        waypoint: int,
    ) -> Int[np.ndarray, " b"]:
        """Return the pairs of base pose and grasp with a free arm state at a waypoint."""
        if not len(jobs):
            return jobs
        robot, motion = self.robot, self.prepared.motion
        layers = solve_layers(
            layer_jobs(robot, motion, bases[jobs], grasps[jobs, 0]),
            task_arrays(motion, robot, self.prepared.world),
            np.array([waypoint]),
        )
        return jobs[layers.passed > 0]
