"""Determine in which direction a part opens, and at which values it is closed and wide open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import apply, invert

from .articulated import Articulated
from .reader import Joint

MIN_SIDE_SHARE = 0.05
"""Zero is well within a joint's range if each side has at least this share of the range [-]."""
MIN_PROTRUSION_DROP = 0.1
"""A part is closed at a limit, not at zero, if it protrudes less there by more than this [m]."""
MIN_BREADTH = 0.1
"""A part whose second extent is smaller is a lever or a tap, which nothing closes [m]."""
MIN_FREE_SIDE = 0.05
"""A part without limits opens to the side on which it protrudes more by at least this [m]."""
TRIAL_ANGLE, TRIAL_TRAVEL = np.pi / 4, 0.2
"""Motion to either side for that comparison: a door is in front or inside [rad], [m]."""


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


@owner_cache()
def opening_of(model: Articulated, joint: str) -> JointOpening:
    """Return at which value a part is closed, and toward which limit it opens.

    A part is closed where its model's `closed` says so. Otherwise it is closed at zero or at the
    limit nearest to zero, unless it protrudes from the rest of its object there and protrudes much
    less at a limit: then it is closed at that limit. It opens toward the farther limit. Without
    limits it opens to the side on which it comes out of its object.
    """
    record = model.joint(joint)
    lower, upper = record.lower, record.upper
    if joint in model.closed:
        closed = model.closed[joint]
    else:
        closed = min(max(0.0, lower), upper)
        if np.isfinite([lower, upper]).all():
            closed = _flush(model, record, (closed, lower, upper))
    if not np.isfinite([lower, upper]).any():
        return JointOpening(closed, np.inf if _comes_out(model, record, closed) else -np.inf)
    return JointOpening(closed, upper if upper - closed >= closed - lower else lower)


def opens_both_ways(model: Articulated, joint: str) -> bool:
    """Check whether a part is closed well within its range, as a swing door is."""
    record, closed = model.joint(joint), opening_of(model, joint).closed
    least = MIN_SIDE_SHARE * (record.upper - record.lower)
    return bool(
        np.isfinite(least) and record.lower < closed - least < closed + least < record.upper
    )


def _flush(model: Articulated, joint: Joint, values: tuple[float, ...]) -> float:
    """Return the first value, or the one at which the part protrudes much less."""
    if _breadth(model, joint) < MIN_BREADTH:
        return values[0]
    out = [_protrusion(model, joint.name, value) for value in values]
    best = int(np.argmin(out))
    return values[best] if out[0] - out[best] > MIN_PROTRUSION_DROP else values[0]


def _comes_out(model: Articulated, joint: Joint, closed: float) -> bool:
    """Return whether a part comes out toward larger values rather than toward smaller ones."""
    trial = TRIAL_TRAVEL if joint.kind == "prismatic" else TRIAL_ANGLE
    up, down = (_protrusion(model, joint.name, closed + s * trial) for s in (1.0, -1.0))
    return down - up < MIN_FREE_SIDE


def _breadth(model: Articulated, joint: Joint) -> float:
    """Return the second extent of what a joint moves, in its child's frame [m]."""
    T_child_root = invert(model.rest_poses[joint.child])
    points = [
        apply(T_child_root @ model.rest_poses[link], hull.vertices)
        for link in model.moved_by(joint.name)
        for hull in model.hulls[link]
    ]
    return float(np.sort(np.ptp(np.concatenate(points), axis=0))[1]) if points else 0.0


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
    outside = np.maximum(rest.min(0) - part, part - rest.max(0)).max(0)
    return float(np.maximum(outside, 0.0).sum())
