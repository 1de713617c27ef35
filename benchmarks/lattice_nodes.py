"""The nodes of the lattice: base poses and grasps at each value of the part, and their levels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lattice_kernel import LatticeJobs, Sliding, rate_nodes
from momapos.core import TaskError
from momapos.core.geometry import all_inside, place_points, rotation
from momapos.model.collision import FREE, CollisionWorld, base_hits, collision_arrays
from momapos.model.kinematics import (
    Chain,
    IkModel,
    arm_arrays,
    build_ik,
    chain_arrays,
    with_base_slides,
)
from momapos.model.kinematics.closed_forms import SLIDES
from momapos.model.records import MOVING_PULL
from momapos.model.robots import Robot, robot_loads
from momapos.model.scene import stays_in_place
from momapos.model.urdf import opening_of
from momapos.planning import PipelineConfig, PlacementQuery, collision_world
from momapos.planning.arm_motion import arm_spheres
from momapos.planning.arm_motion.hand_clearance import hand_hits_along
from momapos.planning.grasps import FULL_DOF, Handle, TaskMotion, task_motion, with_other_handle
from momapos.planning.search_setup import SearchSetup

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, Int8

CELL = 0.1
"""Edge of the cells [m]."""
SAMPLE = 0.025
"""Edge of the samples of the floor on which the base of a short arm slides [m]."""
YAWS, SHORT_YAWS = 16, 36
"""Number of yaws, and that of short arms, which reach a grasp from few base poses [-]."""
SLIDE = 4.0
"""How far the base of a short arm may slide to its arm state, more than is ever needed [m]."""
LOCKED = 33
"""Values of a locked joint of a short arm, 1 in 5 cm of its reach or finer [-]."""
PUSHED_FROM = np.radians(30.0)
"""Angle from which a door is also pushed from behind, as the planner does [rad]."""


@dataclass(frozen=True, eq=False)
class GraspSet:
    """Grasps of one handle, or pushes from behind, at the layers."""

    motion: TaskMotion
    world: CollisionWorld
    first: int
    """The layer at which the motion begins."""
    free: Bool[np.ndarray, "g l"]
    """Whether the hand is free, at the layers from `first` on."""
    following: Int[np.ndarray, " g"]
    """The next grasp when the hand turns about its grasp; -1 for none."""


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm whose base slides freely, if it is too short to reach poses of a lattice."""

    chain: Chain
    ik: IkModel
    directions: Float[np.ndarray, "k 3"]

    @classmethod
    def of(cls, robot: Robot) -> Arm:
        """Return a robot's arm.

        Raises:
            TaskError: The arm is short, and no number of slides gives it a closed form.
        """
        if robot.chain.size >= FULL_DOF:
            return cls(robot.chain, robot.ik, np.zeros((0, 3)))
        for slides in (1, 2):
            axes = np.eye(3)[:slides]
            chain = with_base_slides(robot.chain, axes, SLIDE)
            ik = build_ik(chain, samples_per_joint=LOCKED, max_samples=LOCKED)
            locked = np.setdiff1d(np.arange(chain.size), ik.active)
            if ik.kind == SLIDES and (locked >= slides).all():
                return cls(chain, ik, axes)
        raise TaskError(f"the lattice needs a closed form, and {robot.name} has none")

    @property
    def samples(self) -> int:
        """Number of samples of the locked joints, or of seeds [-]."""
        return len(self.ik.samples) or self.ik.tries


@dataclass(frozen=True, eq=False)
class Lattice:
    """The lattice of one opening."""

    setup: SearchSetup
    sets: tuple[GraspSet, ...]
    arm: Arm
    values: Float[np.ndarray, " l"]
    """Value of the part at each layer."""
    stays: Bool[np.ndarray, " l"]
    """Whether friction holds the part there."""

    @classmethod
    def of(cls, query: PlacementQuery, setup: SearchSetup, *, pushes: bool) -> Lattice:
        """Lay the lattice of an opening.

        Args:
            query: The question.
            setup: Its search.
            pushes: Whether the hand may also push from behind.
        """
        robot, config, task = query.robot, query.config, query.task
        motion: TaskMotion | None = task_motion(query.scene, robot, task, config.motion)
        assert motion is not None
        assert task.joint is not None
        values = motion.object_q[motion.waypoint_steps[1:]]
        sets, passed = [], list[Handle]()
        while motion is not None:
            sets += [] if motion.refusal else [_grasp_set(robot, motion, config, 0)]
            passed += motion.grasps.handles
            motion = with_other_handle(motion, query.scene, robot, config.motion, passed)
        sets += _pushes(query, values) if pushes else []
        item = query.scene.object(task.object)
        stays = stays_in_place(item, task.joint, values, config.motion.grasps.resistance)
        kept = tuple(one for one in sets if one is not None)
        return cls(setup, kept, Arm.of(robot), values, stays)

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.setup.query.robot

    @cached_property
    def yaws(self) -> Float[np.ndarray, " y"]:
        """Yaws of the base [rad]."""
        count = YAWS if len(self.arm.directions) == 0 else SHORT_YAWS
        return np.arange(count) * (2 * np.pi / count)

    @cached_property
    def _box(self) -> Float[np.ndarray, "2 2"]:
        """Corners of the box around the hand's positions [m]."""
        points = np.concatenate(
            [s.motion.Ts_world_tool[:, s.motion.grasp_step :, :2, 3].reshape(-1, 2)
             for s in self.sets]
        )  # fmt: skip
        return np.stack([points.min(0), points.max(0)])

    @cached_property
    def half(self) -> int:
        """Number of cells to either side of the middle [-]."""
        robot = self.setup.problem.geometry
        far = robot.robot.reach + robot.telescope + float(np.linalg.norm(robot.shoulder[:2]))
        return int(np.ceil((far + np.linalg.norm(np.diff(self._box, axis=0)) / 2) / CELL))

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Number of grasps, yaws, and cells along and across the heading."""
        side = 2 * self.half + 1
        return sum(len(s.free) for s in self.sets), len(self.yaws), side, side

    @cached_property
    def poses(self) -> Float[np.ndarray, "y i j 3"]:
        """Base poses of the cells: along the heading and across it."""
        steps = np.arange(-self.half, self.half + 1) * CELL
        return self._poses(steps)

    def _poses(self, steps: Float[np.ndarray, " n"]) -> Float[np.ndarray, "y n n 3"]:
        ahead = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
        at = np.einsum("yab,ijb->yija", rotation(self.yaws), ahead) + self._box.mean(0)
        yaw = np.broadcast_to(self.yaws[:, None, None, None], (*at.shape[:3], 1))
        return np.concatenate([at, yaw], axis=-1)

    @cached_property
    def drivable(self) -> Bool[np.ndarray, "y i j"]:
        """Whether the robot's narrowest part gets to the cells."""
        poses = self.poses.reshape(-1, 3)
        return self.setup.passage.keeps(poses, np.zeros(len(poses))).reshape(self.poses.shape[:3])

    @cached_property
    def _floor(self) -> Float[np.ndarray, "y n n 3"]:
        """Base poses of the floor's samples; those of the cells if the base does not slide."""
        if not len(self.arm.directions):
            return self.poses
        ratio = round(CELL / SAMPLE)
        return self._poses(np.arange(-self.half * ratio, self.half * ratio + 1) * SAMPLE)

    @cached_property
    def _clearance(self) -> float:
        """Distance that the base keeps from everything at the floor's samples [m].

        Between samples of a sliding base it may be free where it is not at the nearest one.
        """
        slack = SAMPLE * 0.5**0.5 if len(self.arm.directions) else 0.0
        return self.setup.problem.geometry.clearance - slack

    @cached_property
    def _static_free(self) -> Bool[np.ndarray, " n"]:
        geometry, poses = self.setup.problem.geometry, self._floor.reshape(-1, 3)
        base, free = self.robot.base, np.ones(len(poses), bool)
        if geometry.floor_polygon is not None:
            free = all_inside(geometry.floor_polygon, place_points(poses, self.robot.footprint))
        rows = np.flatnonzero(free)
        free[rows] = (
            base_hits(poses[rows], base, geometry.static, clearance=self._clearance) == FREE
        )
        return free

    def levels(self, layer: int) -> Int8[np.ndarray, "g y i j"]:
        """Return the level of each node at a layer."""
        out = np.zeros(self.shape, np.int8)
        begin = 0
        for one in self.sets:
            end = begin + len(one.free)
            if layer >= one.first:
                self._fill(one, layer, out[begin:end])
            begin = end
        return out

    def _fill(self, one: GraspSet, layer: int, out: Int8[np.ndarray, "g y i j"]) -> None:
        motion, robot = one.motion, self.robot
        step = int(motion.waypoint_steps[1 + layer - one.first])
        value = int(motion.value[step])
        poses, free = self._floor.reshape(-1, 3), self._static_free.copy()
        rows = np.flatnonzero(free)
        boxes = motion.moving.at(value)
        free[rows] = base_hits(poses[rows], robot.base, boxes, clearance=self._clearance) == FREE
        grasps = np.flatnonzero(one.free[:, layer - one.first])
        tools = motion.Ts_world_tool[:, step]
        if len(self.arm.directions):
            grasp, bases, node, floor = self._sliding_jobs(grasps)
        else:
            grasp, bases, node, floor = self._standing_jobs(grasps, tools, free)
        force, point = motion.hand_loads
        more, _ = replace(motion, more_pull=MOVING_PULL).hand_loads
        jobs = LatticeJobs(
            *map(np.ascontiguousarray, (
                bases, tools[grasp], force[grasp, step], more[grasp, step], point[grasp, step],
                node, floor,
            ))
        )  # fmt: skip
        side, fine = self.shape[2], self._floor.shape[1]
        sliding = Sliding(
            self.arm.directions, np.array([CELL, SAMPLE]),
            np.array([side // 2, fine // 2]), np.array([side, fine]),
        )  # fmt: skip
        rated = np.zeros(out.size, np.int8)
        rate_nodes(
            jobs, value, True, arm_arrays(self.arm.chain, self.arm.ik), chain_arrays(robot.chain),
            sliding, robot_loads(robot).arrays, collision_arrays(arm_spheres(robot), one.world),
            self.arm.samples, free.astype(np.int8), rated,
        )  # fmt: skip
        out[:] = rated.reshape(out.shape)

    def _standing_jobs(
        self, grasps: Int[np.ndarray, " k"], tools: Float[np.ndarray, "g 4 4"],
        free: Bool[np.ndarray, " n"],
    ) -> tuple[np.ndarray, ...]:  # fmt: skip
        """Return grasp, base pose, node and floor sample of each pair to rate."""
        geometry = self.setup.problem.geometry
        cell = np.flatnonzero(free)
        bases = self._floor.reshape(-1, 3)[cell]
        shoulder = bases[:, :2] + rotation(bases[:, 2]) @ geometry.shoulder[:2]
        far = np.linalg.norm(shoulder[None] - tools[grasps, None, :2, 3], axis=-1)
        up = np.maximum(abs(tools[grasps, 2, 3] - geometry.shoulder[2]) - geometry.lift, 0.0)
        near = far**2 + up[:, None] ** 2 <= (geometry.robot.reach + geometry.telescope) ** 2
        k, c = np.nonzero(near)
        return grasps[k], bases[c], grasps[k] * len(free) + cell[c], cell[c]

    def _sliding_jobs(self, grasps: Int[np.ndarray, " k"]) -> tuple[np.ndarray, ...]:
        """Return the same, with bases in the middle of the lines along which they slide."""
        _, count, side, _ = self.shape
        fine, lead = self._floor.shape[1], len(self.arm.directions)
        rows = np.arange(side) if lead == 1 else np.array([self.half])
        k, y, j = (a.ravel() for a in np.meshgrid(grasps, np.arange(count), rows, indexing="ij"))
        bases = self.poses[y, self.half, j]
        across, sample = (j, j * round(CELL / SAMPLE)) if lead == 1 else (0 * j, 0 * j)
        node = (k * count + y) * side * side + across
        return k, bases, node, y * fine * fine + sample


def _grasp_set(
    robot: Robot, motion: TaskMotion, config: PipelineConfig, first: int
) -> GraspSet | None:
    """Return the grasps of a motion whose hand is free at the beginning; None for none."""
    world = collision_world(robot, motion, config)
    steps = motion.waypoint_steps[1:]
    count = len(motion.Ts_world_tool)
    free = hand_hits_along(
        robot, world, motion, motion.Ts_world_tool[:, steps].reshape(-1, 4, 4),
        np.tile(steps, count), np.repeat(motion.grasps.width, len(steps)),
    ).reshape(count, len(steps)) == FREE  # fmt: skip
    # The deepest grasp of each line that is free as far as any of them.
    until = np.where(free.all(1), len(steps), np.argmin(free, axis=1))
    rows = motion.grasps.deepest(until == len(steps)) | motion.grasps.deepest(until > 0)
    if not rows.any():
        return None
    motion = motion.only(rows)
    following = np.full(int(rows.sum()), -1)
    for group in motion.turning.groups:
        members = group[group >= 0]
        ordered = members[np.argsort(motion.turning.angles[members])]
        following[ordered[:-1]] = ordered[1:]
    return GraspSet(motion, world, first, free[rows], following)


def _pushes(query: PlacementQuery, values: Float[np.ndarray, " l"]) -> list[GraspSet | None]:
    """Return the pushes from behind a door that is ajar."""
    scene, robot, task, config = query.scene, query.robot, query.task, query.config
    item = scene.object(task.object)
    assert task.joint is not None
    turns = item.model.joint(task.joint).kind != "prismatic"
    closed = opening_of(item.model, task.joint).closed
    ajar = np.flatnonzero(np.abs(values - closed) >= PUSHED_FROM - 1e-6)
    if task.verb != "open" or not turns or len(ajar) < 2:
        return []
    first = int(ajar[0])
    opened = scene.with_joint(task.object, task.joint, float(values[first]))
    how = replace(config.motion, waypoints=len(values) - first)
    motion = task_motion(opened, robot, task, how, inside=True)
    return [] if motion.refusal else [_grasp_set(robot, motion, config, first)]
