"""Which way a part opens: where its joint is shut, and where it ends when it is wide open."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from momapos.core.geometry import apply

from .articulated import Articulated
from .reader import Joint

INSIDE = 0.05
"""Zero lies well within a joint's range when both sides hold this share of it [-]."""
FLUSH = 0.1
"""A part is shut at a limit and not at zero where it sticks out less by more than this [m]."""
_MODELS = 4096


@dataclass(frozen=True)
class Opening:
    """The two ends of a part's way [rad] or [m]."""

    closed: float
    wide: float
    """The limit that the joint opens toward; infinite for one that turns without end."""

    @property
    def sign(self) -> float:
        """Direction in which the joint opens, 1 or -1."""
        return 1.0 if self.wide >= self.closed else -1.0


@lru_cache(maxsize=_MODELS)
def opening_of(model: Articulated, joint: str) -> Opening:
    """Where a part is shut, and toward which limit it opens.

    A part is shut at zero, or at the limit nearest to zero. Some files have their zero halfway:
    where zero lies well within the range, and the part sticks much less out of the rest of its
    object at a limit, it is shut there. It opens toward the farther limit.
    """
    record = model.joint(joint)
    lower, upper = record.lower, record.upper
    closed = min(max(0.0, lower), upper)
    if np.isfinite([lower, upper]).all() and _well_within(record):
        closed = _flush(model, record, (closed, lower, upper))
    return Opening(closed, upper if upper - closed >= closed - lower else lower)


def _well_within(joint: Joint) -> bool:
    least = INSIDE * (joint.upper - joint.lower)
    return joint.lower < -least and joint.upper > least


def _flush(model: Articulated, joint: Joint, values: tuple[float, ...]) -> float:
    """The first value, or the one at which the part sticks much less out of its object."""
    out = [_protrusion(model, joint.name, value) for value in values]
    best = int(np.argmin(out))
    return values[best] if out[0] - out[best] > FLUSH else values[0]


def _protrusion(model: Articulated, joint: str, value: float) -> float:
    """How far a part sticks out of the upright box around the rest of its object [m]."""
    poses = model.link_poses({joint: value})
    moved = set(model.moved_by(joint))

    def corners(names: list[str]) -> np.ndarray:
        points = [apply(poses[n], hull.vertices) for n in names for hull in model.hulls[n]]
        return np.concatenate(points) if points else np.zeros((0, 3))

    part = corners([name for name in model.links if name in moved])
    rest = corners([name for name in model.links if name not in moved])
    if not len(part) or not len(rest):
        return 0.0
    beside = np.maximum(rest.min(0) - part, part - rest.max(0)).max(0)
    return float(np.maximum(beside, 0.0).sum())
