"""Admittance control of the arm at the tool.

The controller knows the plan, the robot's joints and the force at the hand, not where the part is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from .avoidance import Bounds, no_bounds
from .config import (
    ARM_FORCE,
    ARM_TORQUE,
    FILTER_TIME,
    FOLLOW_RATE,
    RETURN_RATE,
    TURN_DAMPING,
    TURN_RETURN_RATE,
    TURN_SPEED,
    ComplianceConfig,
)
from .feel import SensedForces
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float

_DAMPING = _MIN_SINGULAR_VALUE = 0.05
"""Damping of the pseudoinverse near singularities, and the singular value below which it starts
[m]; there the joints stay closer to the plan."""
_TWIST_WEIGHTS = np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])
"""Length that 1 rad of hand rotation counts as [m]: if the arm cannot meet both, it deviates in
rotation rather than in position."""
_MAX_ITERATIONS = 4
"""Iterations of the active-set solver for joint speed bounds [-]."""
_BOUND_DAMPING = 1e-5
"""Damping of the inverse of the active bounds [-]."""
_NULL_RATE = 2.0
"""Rate at which joints return to the plan in the null space of the tool pose [1/s]."""


class ArmKinematics:
    """Kinematics of the arm from its joints and the odometry of its base alone."""

    def __init__(self, world: Simulation) -> None:
        self._world = world
        self._data = mujoco.MjData(world.model)
        self._data.qpos[:] = world.data.qpos
        self._jacobian = np.zeros((6, world.model.nv))
        self.base, self.base_velocity = np.zeros(3), np.zeros(3)
        """Pose and velocity of the base by odometry, as of its joints."""

    def at(
        self, q: Float[np.ndarray, " n"], base: Float[np.ndarray, "3"] | None = None
    ) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "6 n"]]:
        """Return the tool pose in the world and its Jacobian: linear rows, then angular rows.

        Args:
            q: Arm state [rad] or [m].
            base: Values of the base's joints; None for where it is.
        """
        model, data, tool = self._world.model, self._data, self._world.tool_body
        data.qpos[self._world.base_q] = self.base if base is None else base
        data.qpos[self._world.arm_q] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, self._jacobian[:3], self._jacobian[3:], tool)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.xmat[tool].reshape(3, 3), data.xpos[tool]
        return T, self._jacobian[:, self._world.arm_v]

    @property
    def carried(self) -> Float[np.ndarray, "6"]:
        """Twist of the tool from the motion of the base alone, at the last state of `at`."""
        return np.asarray(self._jacobian[:, self._world.base_v] @ self.base_velocity)


def twist_between(
    T: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "6"]:
    """Return the twist from one pose to another in the world: translation [m], rotation [rad]."""
    quat, turn = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, (other[:3, :3] @ T[:3, :3].T).ravel())
    mujoco.mju_quat2Vel(turn, quat, 1.0)
    return np.concatenate([other[:3, 3] - T[:3, 3], turn])


EVERYWHERE = np.eye(3)
"""Projector on all directions."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Target of the arm for one control step."""

    q: Float[np.ndarray, " n"]
    """[rad] or [m]"""
    v: Float[np.ndarray, " n"]
    T: Float[np.ndarray, "4 4"]
    """Tool pose."""
    twist: Float[np.ndarray, "6"]
    """Tool velocity, linear and angular [m/s], [rad/s]."""
    yields: Float[np.ndarray, "3 3"]
    """Projector of forces on the directions in which the hand is compliant."""
    loose: Float[np.ndarray, "3 3"]
    """Projector of offsets on the directions in which the hand recovers slowly."""
    here: Float[np.ndarray, "3"] | None = None
    """Measured tool position by the joints [m]; None to ignore the motors' lag."""
    bounds: Bounds | None = None
    """Bounds on the joint speeds; None for the joint limits alone."""


class CompliantArm:
    """Motor set-points that follow a reference and yield to the force at the hand."""

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
        self._bears = np.where(slides, ARM_FORCE, ARM_TORQUE)
        self._wrench, self._load = np.zeros(6), np.zeros(len(self.q))
        self.missing = np.zeros(3)
        """What the last step toward a reference lacks of the hand's velocity, for which the arm has
        too few joints [m/s]."""

    def update_forces(self, touch: SensedForces) -> None:
        """Update the low-pass filtered force at the hand."""
        share = self.step / (FILTER_TIME + self.step)
        self._wrench += share * (np.concatenate([touch.force, touch.torque]) - self._wrench)
        self._load += share * (touch.arm - self._load)

    @property
    def wrench(self) -> Float[np.ndarray, "6"]:
        """Filtered force [N] and torque about the tool's origin [Nm] on the hand, in the world."""
        return self._wrench

    @property
    def load(self) -> float:
        """Joint load that the hand does not explain, as a share of the allowed load."""
        return float((np.abs(self._load) / self._bears).max())

    def go(
        self,
        q: Float[np.ndarray, " n"],
        v: Float[np.ndarray, " n"],
        a: Float[np.ndarray, " n"] | None = None,
    ) -> None:
        """Set position and velocity, regardless of the force at the hand."""
        self.q, self.v, self.a = q, v, np.zeros_like(q) if a is None else a

    def stop(self) -> None:
        """Hold the measured position, so that nothing is pressed further."""
        self.go(self._world.data.qpos[self._world.arm_q].copy(), np.zeros_like(self.q))

    def follow(self, reference: Reference) -> None:
        """Move by one step toward a reference."""
        config = self.config
        T, J = self.kinematics.at(self.q)
        off = twist_between(T, reference.T)
        if reference.here is not None:  # compensate the motors' lag along the path
            sure = np.eye(3) - reference.yields
            off[:3] += sure @ (T[:3, 3] - reference.here)
        stiff = off[:3] - reference.loose @ off[:3]
        line = FOLLOW_RATE * stiff + RETURN_RATE * (off[:3] - stiff)
        line += reference.yields @ self._wrench[:3] / config.damping
        turn = TURN_RETURN_RATE * off[3:] + self._wrench[3:] / TURN_DAMPING
        twist = np.concatenate([_clip_length(line, config.speed), _clip_length(turn, TURN_SPEED)])
        twist -= self.kinematics.carried
        free = reference.v + _NULL_RATE * (reference.q - self.q)
        twist += reference.twist
        q = self._moved(J, twist, free, reference.bounds)
        self.missing = (twist - J @ (q - self.q) / self.step)[:3]
        # Feed forward only the plan's speed: feeding forward the compliant motion oscillates.
        self.go(q, reference.v)

    def _moved(
        self,
        J: Float[np.ndarray, "6 n"],
        twist: Float[np.ndarray, "6"],
        free: Float[np.ndarray, " n"],
        bounds: Bounds | None,
    ) -> Float[np.ndarray, " n"]:
        """Return the state after one step at a twist, as close as the joint speed bounds allow.

        Active bounds hold exactly; the remaining degrees of freedom follow the twist.
        """
        count = len(free)
        bounds = bounds or no_bounds(count)
        rows = np.concatenate([np.eye(count), -np.eye(count), bounds.rows])
        to_limits = (self._low - self.q, self.q - self._high)
        least = np.concatenate([*np.minimum(to_limits, 0.0) / self.step, bounds.least])
        v, met = free, np.zeros(len(rows), bool)
        J, twist = J * _TWIST_WEIGHTS[:, None], twist * _TWIST_WEIGHTS
        for _ in range(_MAX_ITERATIONS):
            kept = _bound_inverse(rows[met])
            rest = np.eye(count) - kept @ rows[met]
            v = kept @ least[met] + rest @ free
            v = v + _damped_inverse(J @ rest) @ (twist - J @ v)
            over = rows @ v < least - 1e-9
            if not (over & ~met).any():
                break
            met |= over
        v = v * min(1.0, self.config.joint_speed / max(float(np.abs(v).max()), 1e-12))
        return np.clip(self.q + self.step * v, self._low, self._high)


def _bound_inverse(rows: Float[np.ndarray, "c n"]) -> Float[np.ndarray, "n c"]:
    """Return the damped inverse of the active bounds, which may be nearly parallel."""
    gram = rows @ rows.T + _BOUND_DAMPING * np.eye(len(rows))
    return np.asarray(np.linalg.solve(gram, rows).T)


def _damped_inverse(J: Float[np.ndarray, "6 n"]) -> Float[np.ndarray, "n 6"]:
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    damping = _DAMPING * np.sqrt(np.clip(1.0 - (sigma[-1] / _MIN_SINGULAR_VALUE) ** 2, 0.0, 1.0))
    return np.asarray((Vt.T * (sigma / (sigma**2 + damping**2 + 1e-12))) @ U.T)


def _clip_length(vector: Float[np.ndarray, "3"], length: float) -> Float[np.ndarray, "3"]:
    return vector * min(1.0, length / max(float(np.linalg.norm(vector)), 1e-12))
