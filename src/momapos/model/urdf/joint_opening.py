"""Determine in which direction a part opens, and at which values it is closed and wide open."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from momapos.core.geometry import apply

from .articulated import Articulated
from .reader import Joint

MIN_SIDE_SHARE = 0.05
"""Zero is well within a joint's range if each side has at least this share of the range [-]."""
MIN_PROTRUSION_DROP = 0.1
"""A part is closed at a limit, not at zero, if it protrudes less there by more than this [m]."""
_MAX_CACHED = 4096


@dataclass(frozen=True)
class JointOpening:
    """Joint values of the closed and the wide-open part [rad] or [m]."""

    closed: float
    wide: float
    """The limit toward which the joint opens; infinite for a continuous joint."""

    @property
    def sign(self) -> float:
        """Return the direction in which the joint opens, 1 or -1."""
        return 1.0 if self.wide >= self.closed else -1.0


@lru_cache(maxsize=_MAX_CACHED)
def opening_of(model: Articulated, joint: str) -> JointOpening:
    """Return at which value a part is closed, and toward which limit it opens.

    A part is closed at zero, or at the limit nearest to zero. Some files have their zero halfway:
    if zero is well within the range, and the part protrudes much less from the rest of its object
    at a limit, it is closed there. It opens toward the farther limit.
    """
    record = model.joint(joint)
    lower, upper = record.lower, record.upper
    closed = min(max(0.0, lower), upper)
    if np.isfinite([lower, upper]).all() and _well_within(record):
        closed = _flush(model, record, (closed, lower, upper))
    return JointOpening(closed, upper if upper - closed >= closed - lower else lower)


def _well_within(joint: Joint) -> bool:
    least = MIN_SIDE_SHARE * (joint.upper - joint.lower)
    return joint.lower < -least and joint.upper > least


def _flush(model: Articulated, joint: Joint, values: tuple[float, ...]) -> float:
    """Return the first value, or the one at which the part protrudes much less."""
    out = [_protrusion(model, joint.name, value) for value in values]
    best = int(np.argmin(out))
    return values[best] if out[0] - out[best] > MIN_PROTRUSION_DROP else values[0]


def _protrusion(model: Articulated, joint: str, value: float) -> float:
    """Return how far a part protrudes from the bounding box of the rest of its object [m]."""
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
