"""Bound what any base could do: a lattice of base poses and grasps at each value of the part."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import TaskError
from momapos.core.compiled import C1, F1, F2, F3, I1, entry, kernel
from momapos.core.geometry import all_inside, place_points, rotation
from momapos.model.collision import (
    FREE,
    CollisionWorld,
    base_hits,
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
    solve_sample,
    state_loads,
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

NONE, REACHED, CLEAR, BORNE, PULLED = 0, 1, 2, 3, 4
"""Levels of a node: no arm state, one that collides, a free one, one that bears the part's
resistance, and one that also bears what a moving base adds."""


class LatticeJobs(NamedTuple):
    """Base poses, each with a grasp, at one value of the part."""

    bases: F2
    """x [m], y [m], yaw [rad]."""
    tools: F3
    """Tool poses in the world (m, 4, 4)."""
    pull: F2
    """Force on the hand in the world [N]."""
    more_pull: F2
    """The same with what a moving base adds."""
    point: F2
    """Where it acts [m]."""
    node: I1
    """Index of the base pose's node, or of the first one on the lines along which it slides."""
    floor: I1
    """The same among the samples of the floor."""


class Sliding(NamedTuple):
    """How the base of a short arm slides to the arm state."""

    directions: F2
    """Unit directions in the frame of the base; none if it stands."""
    cell: F1
    """Edge of the cells, and of the finer samples of the floor [m]."""
    middle: I1
    """Index of the middle row of cells, and of samples."""
    rows: I1
    """Number of rows of cells, and of samples."""


@kernel
def _seen_from(base, force, point, out):
    """Write a force and where it acts in the frame of the base."""
    c, s = np.cos(base[2]), np.sin(base[2])
    x, y = point[0] - base[0], point[1] - base[1]
    out[0, 0], out[0, 1], out[0, 2] = (
        c * force[0] + s * force[1],
        c * force[1] - s * force[0],
        force[2],
    )
    out[1, 0], out[1, 1], out[1, 2] = c * x + s * y, c * y - s * x, point[2]


@kernel
def _tool_from(base, T, R, p):
    """Write a tool pose in the frame of the base."""
    c, s = np.cos(base[2]), np.sin(base[2])
    for k in range(3):
        R[0, k] = c * T[0, k] + s * T[1, k]
        R[1, k] = c * T[1, k] - s * T[0, k]
        R[2, k] = T[2, k]
    x, y = T[0, 3] - base[0], T[1, 3] - base[1]
    p[0], p[1], p[2] = c * x + s * y, c * y - s * x, T[2, 3]


@kernel
def _row(slide, sliding, k):
    """Return the row of cells or samples in which a slide ends; -1 outside."""
    row = int(np.floor(slide / sliding.cell[k] + 0.5)) + sliding.middle[k]
    return row if 0 <= row < sliding.rows[k] else -1


@kernel
def _borne(q, base, force, point, chain, robot, load, bearing):
    """Return whether motors and base bear a force on the hand."""
    _seen_from(base, force, point, load)
    stability = state_loads(q, chain, robot, load[0], load[1], bearing)
    return load_excess(bearing.efforts, stability, robot)[0] <= 0.0


@entry
def rate_nodes(
    jobs: LatticeJobs,
    value: int,
    holding: bool,
    arm: ArmArrays,
    chain: ChainArrays,
    sliding: Sliding,
    robot: LoadArrays,
    room: CollisionArrays,
    samples: int,
    floor: C1,
    levels: C1,
) -> np.ndarray:
    """Raise the levels of nodes to the best of their arm states.

    Args:
        jobs: Base poses and grasps.
        value: Index of the part's value.
        holding: Whether the hand may touch the part.
        arm: The arm, its slides first.
        chain: The arm without slides.
        sliding: The slides.
        robot, room: Masses and limits; spheres and obstacles.
        samples: Number of samples of the locked joints, or of seeds, that are tried.
        floor: 1 at samples of the floor on which the base is free.
        levels: Output, the level of each node.

    Returns:
        The obstacle that one of the arm states of each job hits, or FREE.
    """
    lead, n = len(sliding.directions), len(arm.limits.lower)
    hits = np.full(len(jobs.bases), FREE, np.int64)
    scratch, placed = ik_scratch(arm), scratch_of(len(chain.slides), room.spheres)
    solutions, bearing = np.empty((MAX_BRANCHES, n)), load_scratch(len(chain.slides), n - lead)
    R, p, load, here = np.empty((3, 3)), np.empty(3), np.empty((2, 3)), np.empty(3)
    state = TaskState(value, holding)
    for m in range(len(jobs.bases)):
        base, point = jobs.bases[m], jobs.point[m]
        _tool_from(base, jobs.tools[m], R, p)
        begin_pose(scratch)
        c, s = np.cos(base[2]), np.sin(base[2])
        for sample in range(samples):
            if lead == 0 and levels[jobs.node[m]] == PULLED:
                break
            for b in range(solve_sample(sample, R, p, arm, COARSE, solutions, scratch)):
                q, node, spot = solutions[b], jobs.node[m], jobs.floor[m]
                here[0], here[1], here[2] = base[0], base[1], base[2]
                inside = True
                for k in range(lead):
                    row, fine = _row(q[k], sliding, 0), _row(q[k], sliding, 1)
                    inside &= row >= 0 and fine >= 0
                    node += row * (sliding.rows[0] if k == 0 else 1)
                    spot += fine * (sliding.rows[1] if k == 0 else 1)
                    x, y = sliding.directions[k, 0] * q[k], sliding.directions[k, 1] * q[k]
                    here[0] += c * x - s * y
                    here[1] += s * x + c * y
                if not inside or levels[node] == PULLED:
                    continue
                levels[node] = max(levels[node], REACHED)
                if floor[spot] == 0:
                    continue
                q_arm, best = q[lead:], CLEAR
                if _borne(q_arm, here, jobs.pull[m], point, chain, robot, load, bearing):
                    best = BORNE
                    if _borne(q_arm, here, jobs.more_pull[m], point, chain, robot, load, bearing):
                        best = PULLED
                if best <= levels[node]:
                    continue
                hit = check_one(q_arm, here, state, chain, room, placed)
                if hit == FREE:
                    levels[node] = best
                else:
                    hits[m] = hit
    return hits


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


ALONG, AROUND = "along", "around"
"""A base that keeps its yaw, and one that also turns, while the hand holds."""
WITHOUT_FORCES, WITHOUT_OBSTACLES = "any without forces", "any without obstacles"


@dataclass(frozen=True)
class Use:
    """A use of the base, and what its nodes must be."""

    name: str
    level: int
    """Least level of a node."""
    moves: str = ""
    """How the base moves while the hand holds: `ALONG`, `AROUND`, or not at all."""
    moving_level: int = PULLED
    """Least level of nodes while it moves."""
    rigid: bool = False
    """Whether the hand keeps its grasp without turning about it."""
    stops: bool = False
    """Whether it may drive elsewhere where the part stays, as often as it needs."""


USES = (
    Use("fixed", BORNE),
    Use("moving", PULLED, ALONG),
    Use("turning", PULLED, AROUND),
    Use("stops", BORNE, stops=True),
    Use("any", BORNE, AROUND, PULLED, stops=True),
    Use("moving rigid", PULLED, ALONG, rigid=True),
    Use("moving without its pull", BORNE, ALONG, BORNE),
    Use(WITHOUT_FORCES, CLEAR, AROUND, CLEAR, stops=True),
    Use(WITHOUT_OBSTACLES, REACHED, AROUND, REACHED, stops=True),
)
"""The last four say what stops the others."""


@dataclass(frozen=True, eq=False)
class Neighbors:
    """Which cells the base may change between."""

    lattice: Lattice

    @cached_property
    def along(self) -> Int[np.ndarray, "k 2"]:
        """Steps between cells of one yaw, each once."""
        every = np.array([[1, 0], [0, 1], [1, 1], [1, -1]])
        return every if self.lattice.robot.drive == "omni" else every[:1]

    @cached_property
    def around(self) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " e"]]:
        """Pairs of cells at one yaw and at the next one, as indices into their cells.

        Where the base ends is not on the lattice: all cells around count as its end.
        """
        lattice = self.lattice
        side, turn = lattice.shape[2], float(lattice.yaws[1])
        i, j = (a.ravel() for a in np.indices((side, side)))
        ends = []
        for length in self._arcs(turn):
            chord = length * np.sinc(turn / 2 / np.pi) / CELL
            x = i - lattice.half + chord * np.cos(turn / 2)
            y = j - lattice.half + chord * np.sin(turn / 2)
            c, s = np.cos(turn), np.sin(turn)
            ends.append(np.stack([c * x + s * y, c * y - s * x], axis=-1) + lattice.half)
        low = np.floor(np.concatenate(ends) + 1e-9).astype(np.int64)
        corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        to = (low[:, None] + corners).reshape(-1, 2)
        start = np.tile(np.repeat(i * side + j, 4), len(ends))
        inside = ((to >= 0) & (to < side)).all(1)
        pairs = np.unique(
            np.column_stack([start, to[:, 0] * side + to[:, 1]])[inside], axis=0
        )  # fmt: skip
        return pairs[:, 0], pairs[:, 1]

    def _arcs(self, turn: float) -> list[float]:
        """Return the signed lengths of the arcs by which the base turns to the next yaw [m]."""
        robot = self.lattice.robot
        if robot.min_turning_radius <= 0.0 or robot.drive != "car":
            return [0.0]
        least = robot.min_turning_radius * turn
        return [sign * factor * least for sign in (-1, 1) for factor in (1.0, 1.5, 2.0)]


@dataclass(eq=False)
class Reach:
    """What the uses of the base reach, layer by layer."""

    lattice: Lattice
    neighbors: Neighbors

    def __post_init__(self) -> None:
        self.reached: dict[str, Bool[np.ndarray, "g y i j"] | None] = {}
        self.farthest = {use.name: -1 for use in USES}
        self.nodes: list[int] = []

    def add(self, layer: int, levels: Int8[np.ndarray, "g y i j"]) -> bool:
        """Extend all uses by a layer; return whether farther ones matter.

        They do not once no use gets there even without forces.
        """
        self.nodes.append(int((levels >= CLEAR).sum()))
        drivable = self.lattice.drivable[None]
        for use in USES:
            before = self.reached.get(use.name)
            free = levels >= use.level
            if layer == 0:
                now = free & drivable
            elif before is None:
                continue
            else:
                now = self._crossed(before, levels, use) & free
            now = self._spread(now, levels, use, drivable, bool(self.lattice.stays[layer]))
            self.reached[use.name] = now if now.any() else None
            if now.any():
                self.farthest[use.name] = layer
        return self.reached[WITHOUT_FORCES] is not None

    @property
    def why(self) -> str:
        """What stops a base that may do anything: reach, collision or force; "" for nothing."""
        last = len(self.lattice.values) - 1
        if self.farthest["any"] == last:
            return ""
        if self.farthest[WITHOUT_FORCES] == last:
            return "force"
        farther = self.farthest[WITHOUT_OBSTACLES] > self.farthest[WITHOUT_FORCES]
        return "collision" if farther else "reach"

    def _crossed(
        self, before: Bool[np.ndarray, "g y i j"], levels: Int8[np.ndarray, "g y i j"], use: Use
    ) -> Bool[np.ndarray, "g y i j"]:
        """Return where the base may be a layer later."""
        out = before.copy()
        if use.moves:
            moved = levels >= use.moving_level
            out |= _stepped(before, self.neighbors, use) & moved
        return out if use.rigid else out | self._turned(out)

    def _turned(self, reached: Bool[np.ndarray, "g y i j"]) -> Bool[np.ndarray, "g y i j"]:
        """Return the nodes whose grasp is next to one that is reached, as the hand turns."""
        out, begin = np.zeros_like(reached), 0
        for one in self.lattice.sets:
            first = np.flatnonzero(one.following >= 0)
            begin, start = begin + len(one.free), begin
            after = start + one.following[first]
            out[after] |= reached[start + first]
            # A grasp follows at most one other.
            out[start + first] |= reached[after]
        return out

    def _spread(
        self, now: Bool[np.ndarray, "g y i j"], levels: Int8[np.ndarray, "g y i j"], use: Use,
        drivable: Bool[np.ndarray, "1 y i j"], stays: bool,
    ) -> Bool[np.ndarray, "g y i j"]:  # fmt: skip
        """Return the nodes that are reached from others while the part rests."""
        free = levels >= use.level
        if not now.any():
            return now
        if stays and use.stops:
            return np.asarray(now | (free & drivable))
        if stays and not use.moves:
            now = np.asarray(now | (np.any(now, axis=0, keepdims=True) & free))
        moved = levels >= use.moving_level
        while True:
            more = now if use.rigid else now | (self._turned(now) & free)
            if use.moves:
                more = more | (_stepped(more & moved, self.neighbors, use) & moved)
            if np.array_equal(more, now):
                return now
            now = more


def _stepped(
    reached: Bool[np.ndarray, "g y i j"], neighbors: Neighbors, use: Use
) -> Bool[np.ndarray, "g y i j"]:
    """Return the cells next to those that are reached."""
    out = np.zeros_like(reached)
    for i, j in neighbors.along.tolist():
        ahead, behind = _window(i, j)
        out[(..., *ahead)] |= reached[(..., *behind)]
        out[(..., *behind)] |= reached[(..., *ahead)]
    if use.moves == AROUND:
        start, end = neighbors.around
        grasps, yaws, side, _ = reached.shape
        from_, to = (a.reshape(grasps, yaws, side * side) for a in (reached, out))
        g, y, cell = np.nonzero(from_)
        order, first = np.argsort(start, kind="stable"), np.arange(side * side + 1)
        _scatter(to, g, (y + 1) % yaws, cell, end[order], np.searchsorted(start[order], first))
        order = np.argsort(end, kind="stable")
        _scatter(to, g, (y - 1) % yaws, cell, start[order], np.searchsorted(end[order], first))
    return out


def _scatter(
    out: Bool[np.ndarray, "g y c"],
    g: Int[np.ndarray, " m"],
    y: Int[np.ndarray, " m"],
    cell: Int[np.ndarray, " m"],
    to: Int[np.ndarray, " e"],
    first: Int[np.ndarray, " c_plus_1"],
) -> None:
    """Mark the cells to which edges lead, in compressed rows, from some cells."""
    count = first[cell + 1] - first[cell]
    rows = np.repeat(np.arange(len(cell)), count)
    within = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
    out[g[rows], y[rows], to[first[cell[rows]] + within]] = True


def _window(i: int, j: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the slices of a grid that are a step apart."""
    ahead = slice(i, None), slice(j, None) if j >= 0 else slice(None, j)
    behind = slice(None, -i or None), slice(None, -j or None) if j >= 0 else slice(-j, None)
    return ahead, behind
