"""Observe a run: collisions, slip and tracking errors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.core.geometry import invert, rotation_angle

from .config import SUBSTEPS, ExecutionConfig
from .feel import SensedForces
from .geoms import ROBOT, Kind
from .run_record import Collision, Load, Slip, Tracking
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float

_MAX_JOINT_SPEED = 1e4
"""Joint speed above which the simulation has diverged [rad/s] or [m/s]."""
_HELD = Kind.PAD | Kind.PART
_RESTS = (Kind.PART | Kind.ROOM, Kind.PART | Kind.FLOOR)
_ROBOT_ROOM = np.array([kind | Kind.ROOM for kind in ROBOT])


@dataclass(eq=False)
class Observer:
    """Observations of a run so far."""

    world: Simulation
    config: ExecutionConfig
    collisions: dict[tuple[str, str], Collision] = field(default_factory=dict)
    reaching: bool = True
    """Whether the hand is on its way to the grasp; afterwards contacts of the pads are normal."""
    clearance: float = np.inf
    slip: Slip = field(default_factory=Slip)
    load: Load = field(default_factory=Load)
    base_shift: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    _T_part_tool: Float[np.ndarray, "4 4"] | None = None
    _worst: float = 0.0
    _squares: float = 0.0
    _samples: int = 0
    _effort: float = 0.0

    def __post_init__(self) -> None:
        limits = self.world.model.jnt_actfrcrange
        joints = self.world.model.actuator_trnid[self.world.arm_motor, 0]
        self._limit = np.where(limits[joints, 1] > 0, limits[joints, 1], np.inf)
        joint = self.world.model.body_jntadr[self.world.part_body]
        self._loose = self.world.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE

    @property
    def diverged(self) -> bool:
        """Whether the state is not finite, or its speed is implausible."""
        data = self.world.data
        return not (np.abs(data.qvel).max() < _MAX_JOINT_SPEED and np.isfinite(data.qpos.sum()))

    @property
    def tracking(self) -> Tracking:
        """Tracking errors of the motors."""
        rms = float(np.sqrt(self._squares / max(self._samples, 1)))
        return Tracking(self._worst, rms, self._effort)

    def hold(self) -> None:
        """Start measuring slip, and accept contacts between pads and part."""
        self.reaching = False
        self._T_part_tool = invert(self.world.T_world_part) @ self.world.T_world_tool

    def let_go(self) -> None:
        """Stop measuring slip."""
        self._T_part_tool = None

    def record_step(
        self,
        wanted: Float[np.ndarray, " n"],
        base: Float[np.ndarray, "3"],
        time: float,
        stage: str,
        touch: SensedForces,
    ) -> None:
        """Record the present state.

        Args:
            wanted: Set-points of the arm [rad] or [m].
            base: Set-points of the base's joints.
            time: Time since the start of the run [s].
            stage: Stage of the run.
            touch: Forces on the hand.
        """
        data, world = self.world.data, self.world
        error = np.abs(data.qpos[world.arm_q] - wanted)
        self._worst = max(self._worst, float(error.max()))
        self._squares += float((error**2).mean())
        self._samples += 1
        effort = np.abs(data.qfrc_actuator[world.arm_v]) / self._limit
        self._effort = max(self._effort, float(effort.max()))
        self.base_shift = np.maximum(self.base_shift, np.abs(data.qpos[world.base_q] - base))
        if data.ncon:
            self._note_contacts(time, stage)
        if self._T_part_tool is not None:
            self._note_hold(self._T_part_tool, touch)

    def _note_hold(self, T_before: Float[np.ndarray, "4 4"], touch: SensedForces) -> None:
        T = invert(self.world.T_world_part) @ self.world.T_world_tool
        moved = float(np.linalg.norm(T[:3, 3] - T_before[:3, 3]))
        angle = float(rotation_angle(T_before[:3, :3], T[:3, :3]))
        self.slip = Slip(max(self.slip.position, moved), max(self.slip.angle, angle))
        force, torque = touch.size
        self.load = Load(max(self.load.force, force), max(self.load.torque, torque))

    def _note_contacts(self, time: float, stage: str) -> None:
        """Record contacts with a force as collisions, and the others as clearance."""
        contact, kinds = self.world.data.contact, self.world.kinds
        geoms, dist = contact.geom, contact.dist
        both = kinds[geoms[:, 0]] | kinds[geoms[:, 1]]
        room = (both[:, None] == _ROBOT_ROOM).any(1)
        self.clearance = min(self.clearance, float(dist[room].min(initial=np.inf)))
        pushing = (contact.efc_address >= 0) & (self.reaching | (both != _HELD))
        if self._loose:  # it may rest on the room and the floor
            pushing &= (both != _RESTS[0]) & (both != _RESTS[1])
        if not pushing.any():
            return
        touched: dict[tuple[str, str], tuple[float, float]] = {}
        wrench = np.empty(6)
        for i in np.flatnonzero(pushing).tolist():
            mujoco.mj_contactForce(self.world.model, self.world.data, i, wrench)
            names = sorted(self.world.names[g] for g in geoms[i])
            force, depth = touched.get((names[0], names[1]), (0.0, 0.0))
            touched[names[0], names[1]] = (force + float(wrench[0]), max(depth, -float(dist[i])))
        for pair, (force, depth) in touched.items():
            self._note_collision(pair, force, depth, time, stage)

    def _note_collision(
        self, pair: tuple[str, str], force: float, depth: float, time: float, stage: str
    ) -> None:
        seen = self.collisions.get(pair)
        if seen is None:
            seen = Collision(*pair, force=0.0, depth=0.0, seconds=0.0, first=time, stage=stage)
        self.collisions[pair] = replace(
            seen,
            force=max(seen.force, force),
            depth=max(seen.depth, depth),
            seconds=seen.seconds + self.config.timestep * SUBSTEPS,
        )

    def hardest(self) -> tuple[Collision, ...]:
        """Return all collisions, the hardest first."""
        return tuple(sorted(self.collisions.values(), key=lambda c: -c.force))
