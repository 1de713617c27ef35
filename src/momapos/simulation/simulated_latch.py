"""The latch of a part in physics: it locks the closed part until it is turned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco

from momapos.model.records import Latch
from momapos.model.scene import SceneObject, known_resistance, latch_to_turn

from .config import WELD_TIME, FurnitureConfig

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

LOCK = "latch"
"""Name of the constraint that locks the part."""
MAX_CLOSED_OFFSET = 0.01
"""A part within this of its closed value can be locked again [rad] or [m]; see `latch_to_turn`."""


@dataclass(frozen=True)
class SimulatedLatch:
    """A latch, and its addresses in the model.

    It has dry friction and damping, and no spring: where the hand leaves it, it stays.
    """

    joint: str
    """Joint of the latch, in the scene."""
    start: float
    """Value in the scene [rad] or [m]."""
    to: float
    """Value from which on the part is free [rad] or [m]."""
    closed: float
    """Value of the part's joint in the scene [rad] or [m]."""
    value_q: int
    part_q: int
    lock: int

    def turned(self, q: Float[np.ndarray, " q"], tolerance: float) -> bool:
        """Check whether the latch has made its travel, up to a share of it."""
        travel = self.to - self.start
        return bool((float(q[self.value_q]) - self.start) / travel >= 1.0 - tolerance)

    def update(self, data: Any, tolerance: float) -> None:
        """Lock the part while it is closed and the latch is not turned; else release it."""
        near = abs(float(data.qpos[self.part_q]) - self.closed) < MAX_CLOSED_OFFSET
        data.eq_active[self.lock] = near and not self.turned(data.qpos, tolerance)

    def place(self, q: Float[np.ndarray, " q"], value: float) -> None:
        """Set the latch where the robot expects it while the part is at a value."""
        q[self.value_q] = self.start if value == self.closed else self.to


def carriers_of(item: SceneObject, joint: str) -> dict[str, str]:
    """Return the links that a joint moves, each with the link whose body carries it in physics."""
    latch = latch_to_turn(item, joint)
    return item.model.rigid_groups(joint, *(() if latch is None else (latch.joint,)))


def add_lock(spec: Any, part: str) -> None:
    """Add the constraint that keeps a part's joint at its value in the scene.

    Args:
        spec: The world.
        part: The part's joint in it.
    """
    lock = spec.add_equality(
        name=LOCK, type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, active=True
    )
    lock.name1 = part
    lock.data = [0.0] * len(lock.data)
    lock.solref = [WELD_TIME, 1.0]


def add_friction(added: Any, item: SceneObject, latch: Latch, config: FurnitureConfig) -> None:
    """Give the joint of a latch its known or assumed friction and damping."""
    known = known_resistance(item, latch.joint, config)
    assert known.friction is not None
    assert known.damping is not None
    added.frictionloss = known.friction
    added.damping = [known.damping, 0, 0]


def find_latch(model: Any, item: SceneObject, joint: str, part: str) -> SimulatedLatch | None:
    """Return the latch of a compiled world; None if no latch must be turned.

    Args:
        model: The world.
        item: The object in the scene.
        joint: The joint that the task moves.
        part: The same joint in the world.
    """
    latch = latch_to_turn(item, joint)
    if latch is None:
        return None
    values = item.values()
    return SimulatedLatch(
        latch.joint, values[latch.joint], latch.to, values[joint],
        value_q=int(model.joint(f"{part}/{latch.joint}").qposadr[0]),
        part_q=int(model.joint(part).qposadr[0]),
        lock=model.equality(LOCK).id,
    )  # fmt: skip
