"""Measure the worst loads of a motion: joint efforts, and the margin to tipping over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import GRAVITY, owner_cache
from momapos.core.geometry import (
    apply,
    contains,
    convex_hull,
    edge_distances,
    edge_normals,
    invert,
    pose_planar,
)
from momapos.model.records import MOVING_PULL, Motion, MotionLoads, Task
from momapos.model.robots import support_outline
from momapos.model.scene import ResistanceConfig, SceneObject, object_mass, resistance_along
from momapos.model.urdf import Articulated

from .exact_shapes import Shapes
from .link_bodies import LinkBodies
from .path_checks import DensePath
from .report import Check, Limits, at_most

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


_BLOCK = 64
"""Number of outlines that are compared with an area together [-]."""
_BALL = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
"""Directions in which a ball extends a shape [rad]."""


def outside(
    polygon: Float[np.ndarray, "k 2"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Return the signed distance of points from a polygon [m], negative inside."""
    distance = edge_distances(points, polygon)
    return np.asarray(np.where(contains(polygon, points), -distance, distance))


def farthest_outside(
    polygon: Float[np.ndarray, "k 2"], shapes: Shapes, Ts: Float[np.ndarray, "s b 4 4"]
) -> tuple[float, int]:
    """Return how far any shape extends outside a polygon [m], and at which of its poses.

    Args:
        polygon: The polygon.
        shapes: The shapes.
        Ts: Their world poses.

    Returns:
        The distance, 0 if all are inside, and the index of the poses.
    """
    middle = outside(polygon, Ts[..., :2, 3].reshape(-1, 2)).reshape(Ts.shape[:2])
    near = middle + np.linalg.norm(shapes.half, axis=1) > 0.0
    worst, where = 0.0, 0
    for index in np.flatnonzero(near.any(0)).tolist():
        states = np.flatnonzero(near[:, index])
        T, outline = Ts[states, index], shapes.outline(index)
        points = outline @ T[:, :2, :3].transpose(0, 2, 1) + T[:, None, :2, 3]
        gaps = outside(polygon, points.reshape(-1, 2)).reshape(points.shape[:2]).max(1)
        state = int(gaps.argmax())
        if gaps[state] + shapes.ball[index] > worst:
            worst, where = float(gaps[state] + shapes.ball[index]), int(states[state])
    return worst, where


def outline_of(shapes: Shapes, Ts: Float[np.ndarray, "b 4 4"]) -> Float[np.ndarray, "k 2"]:
    """Return the convex outline of shapes on the floor, counterclockwise, at their poses [m]."""
    rim = np.column_stack([np.cos(_BALL), np.sin(_BALL)])
    points = [
        ((outline @ T[:3, :3].T + T[:3, 3])[:, None, :2] + ball * rim).reshape(-1, 2)
        for outline, ball, T in zip(shapes.outlines, shapes.ball, Ts, strict=True)
    ]
    return convex_hull(np.concatenate(points))


def depths_in(
    area: Float[np.ndarray, "k 2"], outlines: Float[np.ndarray, "n m 2"]
) -> Float[np.ndarray, " n"]:
    """Return how deep convex outlines and an area are in each other [m]; 0 where they are apart.

    The depth is that of a corner of the outline in the area, or of the middle of the part of an
    edge of the area that is in the outline. So a small area in a large outline counts, and a strip
    across it.
    """
    blocks = [outlines[k : k + _BLOCK] for k in range(0, len(outlines), _BLOCK)]
    return np.concatenate([np.zeros(0), *(_depths_in(area, block) for block in blocks)])


def _depths_in(
    area: Float[np.ndarray, "k 2"], outlines: Float[np.ndarray, "n m 2"]
) -> Float[np.ndarray, " n"]:
    corners = outlines.reshape(-1, 2)
    within = np.where(contains(area, corners), edge_distances(corners, area), 0.0)
    normal = edge_normals(outlines)
    level = (normal * outlines).sum(-1)
    # Where an edge of the area, from 0 to 1, is on the inner side of every edge of an outline.
    beyond = np.einsum("nmi,ki->nmk", normal, area) - level[..., None]
    rise = np.einsum("nmi,ki->nmk", normal, np.roll(area, -1, axis=0) - area)
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = -beyond / rise
    first = np.where(rise < 0.0, cut, np.where((rise > 0.0) | (beyond <= 0.0), 0.0, np.inf))
    last = np.where(rise > 0.0, cut, 1.0)
    first, last = np.maximum(first.max(1), 0.0), np.minimum(last.min(1), 1.0)
    middle = np.where(first <= last, (first + last) / 2, 0.0)
    depth = -(beyond + middle[:, None] * rise).max(1)
    crossed = np.where(first <= last, depth, 0.0).max(1)
    return np.maximum(np.maximum(within.reshape(len(outlines), -1).max(1), crossed), 0.0)


_DOWN = np.array([0.0, 0.0, -GRAVITY])
"""Acceleration by gravity [m/s^2]."""


@dataclass(frozen=True, eq=False)
class RobotEfforts:
    """The masses of a robot's bodies, and the effort limits of its arm."""

    mass: Float[np.ndarray, " b"]
    """[kg]"""
    center: Float[np.ndarray, "b 3"]
    """Center of each mass in the body's frame [m]."""
    names: tuple[str, ...]
    """The joints with a motor: those of the arm that do not follow another."""
    limits: Float[np.ndarray, " n"]
    """Their effort limits [Nm] or [N]; infinite if the file has none."""
    joints: tuple[tuple[int, int, float, bool], ...]
    """For each joint of the arm: its body, its motor, its ratio to it, and whether it slides."""
    axes: Float[np.ndarray, "m 3"]
    """Axis of each of these joints in its body's frame."""
    beyond: Bool[np.ndarray, "m b"]
    """The bodies that each of them moves."""
    support: Float[np.ndarray, "k 2"] | None
    """Outline of the wheels' contacts in the base frame [m]; None if unknown."""

    def efforts(
        self,
        Ts: Float[np.ndarray, "s b 4 4"],
        force: Float[np.ndarray, "s 3"],
        point: Float[np.ndarray, "s 3"],
    ) -> Float[np.ndarray, "s n"]:
        """Return what each motor must exert at rest [Nm] or [N].

        It balances the forces on all bodies that its joints move, by the principle of virtual work.

        Args:
            Ts: World poses of the bodies at each state.
            force: Force on the hand or on what it holds, in the world [N].
            point: Where it acts [m].
        """
        centers = np.einsum("sbij,bj->sbi", Ts[..., :3, :3], self.center) + Ts[..., :3, 3]
        out = np.zeros((len(Ts), len(self.names)))
        for (body, motor, ratio, slides), axis, beyond in zip(
            self.joints, self.axes, self.beyond, strict=True
        ):
            along = Ts[:, body, :3, :3] @ axis
            if slides:
                work = -GRAVITY * self.mass[beyond].sum() * along[:, 2] + (along * force).sum(1)
            else:
                origin = Ts[:, body, :3, 3]
                moment = self.mass[beyond] @ (centers[:, beyond] - origin[:, None])
                down = _cross(moment, _DOWN)
                work = (along * (down + _cross(point - origin, force))).sum(1)
            out[:, motor] -= ratio * work
        return out

    def stability(
        self,
        base_pose: Sequence[float] | Float[np.ndarray, "s 3"],
        Ts: Float[np.ndarray, "s b 4 4"],
        force: Float[np.ndarray, "s 3"],
        point: Float[np.ndarray, "s 3"],
    ) -> Float[np.ndarray, " s"] | None:
        """Return how far inside the support the floor's reaction acts at each state [m].

        None if masses or wheels are unknown; negative where the robot tips over. The base is at
        one pose or at a pose per state.
        """
        if self.support is None:
            return None
        centers = np.einsum("sbij,bj->sbi", Ts[..., :3, :3], self.center) + Ts[..., :3, 3]
        weight = GRAVITY * self.mass.sum()
        moment = _cross(centers, _DOWN).transpose(0, 2, 1) @ self.mass
        moment += _cross(point, force)
        up = weight - force[:, 2]
        # The reaction (0, 0, up) at (x, y, 0) has the moment (y up, -x up, 0).
        reaction = np.column_stack([moment[:, 1], -moment[:, 0]]) / up[:, None]
        T = pose_planar(np.array(base_pose))
        local = np.einsum("...i,...ij->...j", reaction - T[..., :2, 3], T[..., :2, :2])
        return np.where(up > 0.0, -outside(self.support, local), -np.inf)


def _cross(
    a: Float[np.ndarray, "*batch 3"], b: Float[np.ndarray, "*#batch 3"]
) -> Float[np.ndarray, "*batch 3"]:
    """Return the cross product; `np.cross` takes several times as long for few vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


@owner_cache(8)
def robot_efforts(
    model: Articulated, bodies: LinkBodies, base_link: str, arm_joints: tuple[str, ...]
) -> RobotEfforts:
    """Return the masses of a robot's bodies and the effort limits of its arm.

    Args:
        model: The robot.
        bodies: Its bodies.
        base_link: Link on the floor.
        arm_joints: All joints that the arm moves.
    """
    mass, center = _body_masses(model, bodies)
    records = [model.joint(name) for name in arm_joints]
    motors = [joint.name for joint in records if joint.mimic is None]
    joints, beyond = [], np.zeros((len(records), len(bodies)), bool)
    for k, joint in enumerate(records):
        body = bodies.of_joint[joint.name]
        leader = joint.name if joint.mimic is None else joint.mimic.joint
        ratio = 1.0 if joint.mimic is None else joint.mimic.ratio
        joints.append((body, motors.index(leader), ratio, joint.kind == "prismatic"))
        beyond[k] = [_is_beyond(bodies, other, body) for other in range(len(bodies))]
    moved = set(np.flatnonzero(beyond.any(0)).tolist())
    standing = [link for link, body in bodies.of_link.items() if body not in moved]
    on_base = sum(model.urdf.links[link].mass for link in standing)
    return RobotEfforts(
        mass=mass,
        center=center,
        names=tuple(motors),
        limits=np.array([model.joint(name).effort for name in motors]),
        joints=tuple(joints),
        axes=np.array([joint.axis for joint in records]),
        beyond=beyond,
        support=support_outline(model, base_link, standing) if on_base > 0 else None,
    )


def _body_masses(
    model: Articulated, bodies: LinkBodies
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, "b 3"]]:
    mass, moment = np.zeros(len(bodies)), np.zeros((len(bodies), 3))
    for name, body in bodies.of_link.items():
        link, T = model.urdf.links[name], bodies.T_body_link[name]
        mass[body] += link.mass
        moment[body] += link.mass * (T[:3, :3] @ link.center + T[:3, 3])
    return mass, moment / np.maximum(mass, 1e-12)[:, None]


def _is_beyond(bodies: LinkBodies, body: int, joint_body: int) -> bool:
    """Check whether a body moves with the joint of another one."""
    while body not in (joint_body, -1):
        body = bodies.parent[body]
    return body == joint_body


MIN_LEVER = 0.02
"""Travel of the hand per unit of the joint below which the pull does not grow [m/rad]."""

MIN_TIME = 1e-3
"""Time between two states below which the part is not taken as faster [s]."""


@dataclass(frozen=True, eq=False)
class CarriedLoad:
    """What the task's object does to the hand."""

    item: SceneObject
    task: Task
    resistance: ResistanceConfig
    """Assumed where the scene gives no resistance."""

    @property
    def mass(self) -> float | None:
        """Return the mass of the object in the hand [kg]; None if there is none."""
        if self.task.joint is not None or self.task.poses:
            return None
        return object_mass(self.item, self.resistance)[0]

    def along(
        self, motion: Motion, path: DensePath, Ts_world_tool: Float[np.ndarray, "s 4 4"]
    ) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "s 3"]]:
        """Return the force on the hand [N] and where it acts [m] at each state, in the world."""
        point = Ts_world_tool[:, :3, 3].copy()
        if self.mass is not None:
            return self._weight(path, Ts_world_tool, point)
        force = np.zeros_like(point)
        for hold in () if self.task.poses else motion.grasps:
            held = slice(hold.first, hold.last + 1)
            moves = motion.base is not None and bool(np.ptp(motion.base[held], axis=0).any())
            pull = self._pull(
                motion.object_q[held],
                motion.Ts_world_tool[held, :3, 3],
                MOVING_PULL if moves else 0.0,
                None if motion.times is None else motion.times[held],
            )
            at = path.at[path.approach :]
            rows = path.approach + np.flatnonzero((at >= hold.first) & (at <= hold.last))
            known = np.arange(hold.first, hold.first + len(pull))
            for k in range(3):
                force[rows, k] = np.interp(path.at[rows], known, pull[:, k])
        return force, point

    def _pull(
        self,
        values: Float[np.ndarray, " v"],
        hand: Float[np.ndarray, "v 3"],
        more: float,
        times: Float[np.ndarray, " v"] | None,
    ) -> Float[np.ndarray, "v 3"]:
        """Return the force of a part on the hand that moves it, opposite to the hand's path.

        `more` is a further force [N]. `times` are those of the plan [s], for the part's damping.
        """
        assert self.task.joint is not None
        change = np.gradient(values) if len(values) > 1 else np.zeros(1)
        if len(values) < 2 or not (np.abs(change) > 1e-9).any():
            return np.zeros((len(values), 3))
        moves = np.abs(change) > 1e-9
        travel = np.gradient(hand, axis=0) / np.where(moves, change, np.inf)[:, None]
        lever = np.maximum(np.linalg.norm(travel, axis=1), MIN_LEVER)
        speed = None
        if times is not None:
            speed = change / np.maximum(np.gradient(times), MIN_TIME)
        along = resistance_along(
            self.item, self.task.joint, values, lever, self.resistance, speed
        ).along
        against = (along / lever**2 + more / lever) * np.sign(values[-1] - values[0])
        return -against[:, None] * travel

    def _weight(
        self,
        path: DensePath,
        Ts_world_tool: Float[np.ndarray, "s 4 4"],
        point: Float[np.ndarray, "s 3"],
    ) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "s 3"]]:
        """Return the weight of a carried object, which acts at its center of mass."""
        assert self.mass is not None
        _, center = object_mass(self.item, self.resistance)
        in_tool = invert(Ts_world_tool[path.approach]) @ self.item.T_world_object
        local = apply(in_tool, center[None])[0]
        place = self.task.verb == "place"
        carried = slice(path.approach + 1) if place else slice(path.approach, None)
        force = np.zeros_like(point)
        force[carried, 2] = -GRAVITY * self.mass
        point[carried] = apply(Ts_world_tool[carried], local[None])[:, 0]
        return force, point


@dataclass(frozen=True, eq=False)
class MeasuredLoads:
    """The loads of a motion at every state."""

    robot: RobotEfforts
    needs: Float[np.ndarray, "s n"]
    """What each motor must exert [Nm] or [N]."""
    stability: Float[np.ndarray, " s"] | None
    """See `RobotEfforts.stability`; None if unknown."""
    grasp: Float[np.ndarray, " s"]
    """See `HandChecker.pull_shares`."""

    @property
    def shares(self) -> Float[np.ndarray, "s n"]:
        """Return the share of each effort limit; 0 where the file has none."""
        return np.abs(self.needs) / self.robot.limits

    def record(self, payload: float | None) -> MotionLoads:
        """Return the worst loads, for a plan."""
        known = np.isfinite(self.robot.limits)
        worst = self.shares.max(0, initial=0.0)
        named = zip(self.robot.names, worst.tolist(), known.tolist(), strict=True)
        return MotionLoads(
            {name: share for name, share, is_known in named if is_known},
            None if self.stability is None else float(self.stability.min()),
            payload,
        )

    def checks(self, path: DensePath, limits: Limits) -> tuple[Check, ...]:
        """Return the checks of efforts and stability."""
        state, motor = np.unravel_index(int(self.shares.argmax()), self.shares.shape)
        worst, words, name = float(self.shares[state, motor]), "", ""
        if worst > limits.effort:
            name = self.robot.names[motor]
            need, most = abs(self.needs[state, motor]), self.robot.limits[motor]
            words = f"{name} needs {need:.3g} of {most:.3g} at {path.where(int(state))}"
        found = [at_most("joint effort", 100 * worst, 100 * limits.effort, "%", words, name)]
        most = float(self.grasp.max(initial=0.0))
        words = f"what the grasp transmits, at {path.where(int(self.grasp.argmax()))}"
        found.append(
            at_most("pull on the grasp", 100 * most, 100.0, "%", words if most > 1.0 else "")
        )
        if self.stability is not None:
            lean, most = -float(self.stability.min()), -limits.stability
            where = path.where(int(self.stability.argmin())) if lean > most else ""
            found.append(at_most("tipping over", 1000 * lean, 1000 * most, "mm", where, "the base"))
        return tuple(found)
