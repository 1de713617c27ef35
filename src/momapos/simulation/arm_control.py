"""The arm's controller: an admittance at the tool.

It knows the plan, the robot's own joints and the force at its hand; never where the part is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from .avoidance import Bounds, no_bounds
from .config import ComplianceConfig
from .feel import Touch
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float

_DAMPING = _SINGULAR = 0.05
"""Damping of the inverse at singular states of the arm, and the singular value where it begins:
there the joints rather stay near the plan [m]."""
_TURN = np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])
"""A turn of the hand by 1 rad counts as this way: where the arm cannot do both, it rather turns
than leave the part's way [m]."""
_ROUNDS = 4
"""How often bounds that are met are kept, and what they leave is asked again [-]."""
_SAME = 1e-5
"""Damping of the inverse of bounds [-]."""
_NULL_RATE = 2.0
"""Joints that the tool's pose leaves free return to the plan at this rate [1/s]."""


class ArmKinematics:
    """The robot's own arm, by its joints alone, on a base that stands where it should."""

    def __init__(self, world: Simulation) -> None:
        self._world = world
        self._data = mujoco.MjData(world.model)
        self._data.qpos[:] = world.data.qpos
        self._data.qpos[world.base_q] = 0.0
        self._jacobian = np.zeros((6, world.model.nv))

    def at(
        self, q: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "6 n"]]:
        """Pose of the tool in the world, and its Jacobian: linear rows, then angular ones."""
        model, data, tool = self._world.model, self._data, self._world.tool_body
        data.qpos[self._world.arm_q] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, self._jacobian[:3], self._jacobian[3:], tool)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.xmat[tool].reshape(3, 3), data.xpos[tool]
        return T, self._jacobian[:, self._world.arm_v]


def twist_between(
    T: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "6"]:
    """The move from one pose to another: way [m], then turn as a vector [rad], in the world."""
    quat, turn = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, (other[:3, :3] @ T[:3, :3].T).ravel())
    mujoco.mju_quat2Vel(turn, quat, 1.0)
    return np.concatenate([other[:3, 3] - T[:3, 3], turn])


EVERYWHERE = np.eye(3)
"""Projects on all directions."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Where the arm should be at one step."""

    q: Float[np.ndarray, " n"]
    """[rad] or [m]"""
    v: Float[np.ndarray, " n"]
    T: Float[np.ndarray, "4 4"]
    """Pose of the tool."""
    twist: Float[np.ndarray, "6"]
    """Its speed, linear and angular [m/s], [rad/s]."""
    yields: Float[np.ndarray, "3 3"]
    """Projects a force on the directions in which the hand gives way."""
    loose: Float[np.ndarray, "3 3"]
    """Projects an offset on the directions in which the hand makes it up slowly."""
    here: Float[np.ndarray, "3"] | None = None
    """Where the tool really is, by the joints; None where that makes no difference [m]."""
    bounds: Bounds | None = None
    """Of the joints' speeds; None for none but the joints' limits."""


class CompliantArm:
    """Set-points of the motors that follow a reference and give way to the force at the hand."""

    def __init__(self, world: Simulation, config: ComplianceConfig, step: float) -> None:
        self.kinematics, self._world = ArmKinematics(world), world
        self.config, self.step = config, step
        self.q = world.data.qpos[world.arm_q].copy()
        self.v, self.a = np.zeros(len(self.q)), np.zeros(len(self.q))
        joints = world.model.actuator_trnid[world.arm_motor, 0]
        limited = world.model.jnt_limited[joints].astype(bool)
        limits = world.model.jnt_range[joints]
        self._low = np.where(limited, limits[:, 0], -np.inf)
        self._high = np.where(limited, limits[:, 1], np.inf)
        slides = world.model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE
        self._bears = np.where(slides, config.arm_force, config.arm_torque)
        self._wrench, self._load = np.zeros(6), np.zeros(len(self.q))

    def feel(self, touch: Touch) -> None:
        """Take in the force at the hand, through a low-pass filter."""
        share = self.step / (self.config.filter_time + self.step)
        self._wrench += share * (np.concatenate([touch.force, touch.torque]) - self._wrench)
        self._load += share * (touch.arm - self._load)

    @property
    def wrench(self) -> Float[np.ndarray, "6"]:
        """Filtered force [N] and torque about the tool's origin [Nm] on the hand, in the world."""
        return self._wrench

    @property
    def load(self) -> float:
        """Load of the joints that the hand does not explain, as a share of what they may bear."""
        return float((np.abs(self._load) / self._bears).max())

    def go(
        self,
        q: Float[np.ndarray, " n"],
        v: Float[np.ndarray, " n"],
        a: Float[np.ndarray, " n"] | None = None,
    ) -> None:
        """Be at a state, at a speed, whatever the hand feels."""
        self.q, self.v, self.a = q, v, np.zeros_like(q) if a is None else a

    def stop(self) -> None:
        """Stay where the arm really is, so that nothing presses on."""
        self.go(self._world.data.qpos[self._world.arm_q].copy(), np.zeros_like(self.q))

    def follow(self, reference: Reference) -> None:
        """Move on by a step."""
        config = self.config
        T, J = self.kinematics.at(self.q)
        off = twist_between(T, reference.T)
        if reference.here is not None:  # along the way the arm makes up what its motors lag behind
            sure = np.eye(3) - reference.yields
            off[:3] += sure @ (T[:3, 3] - reference.here)
        stiff = off[:3] - reference.loose @ off[:3]
        line = config.follow_rate * stiff + config.return_rate * (off[:3] - stiff)
        line += reference.yields @ self._wrench[:3] / config.damping
        turn = config.turn_return_rate * off[3:] + self._wrench[3:] / config.turn_damping
        twist = np.concatenate([_at_most(line, config.speed), _at_most(turn, config.turn_speed)])
        free = reference.v + _NULL_RATE * (reference.q - self.q)
        # The motors are led by the plan's speed alone: led by what the hand gives way they quiver.
        self.go(self._moved(J, reference.twist + twist, free, reference.bounds), reference.v)

    def _moved(
        self,
        J: Float[np.ndarray, "6 n"],
        twist: Float[np.ndarray, "6"],
        free: Float[np.ndarray, " n"],
        bounds: Bounds | None,
    ) -> Float[np.ndarray, " n"]:
        """The state after a step at a twist, as near as the bounds of the joints' speeds allow.

        A bound that is met is kept exactly, and what it leaves does the rest.
        """
        count = len(free)
        bounds = bounds or no_bounds(count)
        rows = np.concatenate([np.eye(count), -np.eye(count), bounds.rows])
        to_limits = (self._low - self.q, self.q - self._high)
        least = np.concatenate([*np.minimum(to_limits, 0.0) / self.step, bounds.least])
        v, met = free, np.zeros(len(rows), bool)
        J, twist = J * _TURN[:, None], twist * _TURN
        for _ in range(_ROUNDS):
            kept = _kept(rows[met])
            rest = np.eye(count) - kept @ rows[met]
            v = kept @ least[met] + rest @ free
            v = v + _damped_inverse(J @ rest) @ (twist - J @ v)
            over = rows @ v < least - 1e-9
            if not (over & ~met).any():
                break
            met |= over
        v = v * min(1.0, self.config.joint_speed / max(float(np.abs(v).max()), 1e-12))
        return np.clip(self.q + self.step * v, self._low, self._high)


def _kept(rows: Float[np.ndarray, "c n"]) -> Float[np.ndarray, "n c"]:
    """Inverse of the rows of bounds that are met, damped where they say almost the same."""
    gram = rows @ rows.T + _SAME * np.eye(len(rows))
    return np.asarray(np.linalg.solve(gram, rows).T)


def _damped_inverse(J: Float[np.ndarray, "6 n"]) -> Float[np.ndarray, "n 6"]:
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    damping = _DAMPING * np.sqrt(np.clip(1.0 - (sigma[-1] / _SINGULAR) ** 2, 0.0, 1.0))
    return np.asarray((Vt.T * (sigma / (sigma**2 + damping**2 + 1e-12))) @ U.T)


def _at_most(vector: Float[np.ndarray, "3"], length: float) -> Float[np.ndarray, "3"]:
    return vector * min(1.0, length / max(float(np.linalg.norm(vector)), 1e-12))
