"""Measure the worst loads of a motion: joint efforts, and the margin to tipping over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import GRAVITY
from momapos.core.geometry import apply, invert
from momapos.model.records import MOVING_PULL, Motion, MotionLoads, Task
from momapos.model.scene import ResistanceConfig, SceneObject, object_mass, resistance_along

from .path_checks import DensePath
from .report import Check, Limits, at_most
from .robot_efforts import RobotEfforts

if TYPE_CHECKING:
    from jaxtyping import Float

MIN_LEVER = 0.02
"""Travel of the hand per unit of the joint below which the pull does not grow [m/rad]."""

MIN_TIME = 1e-3
"""Time between two states below which the part is not taken as faster [s]."""


@dataclass(frozen=True, eq=False)
class HandLoad:
    """What the task's object does to the hand."""

    item: SceneObject
    task: Task
    resistance: ResistanceConfig
    """Assumed where the scene gives no resistance."""

    @property
    def mass(self) -> float | None:
        """Return the mass of the object in the hand [kg]; None if the task moves a joint."""
        if self.task.joint is not None:
            return None
        return object_mass(self.item, self.resistance)[0]

    def along(
        self, motion: Motion, path: DensePath, Ts_world_tool: Float[np.ndarray, "s 4 4"]
    ) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "s 3"]]:
        """Return the force on the hand [N] and where it acts [m] at each state, in the world."""
        point = Ts_world_tool[:, :3, 3].copy()
        if self.task.joint is None:
            return self._weight(path, Ts_world_tool, point)
        force = np.zeros_like(point)
        for hold in motion.grasps:
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
