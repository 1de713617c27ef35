"""Check that a motion turns the latch of its part first, as the scene says."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from momapos.model.records import Motion

from .moved_part import MovedPart
from .path_checks import MAX_FREE_MOTION, MAX_STEP_BACK
from .report import Check, Limits, at_most, verdict


def known_latch_checks(part: MovedPart, motion: Motion) -> Iterator[Check]:
    """Check that the motion turns a latch if and only if one must be turned."""
    if part.latch is not None:
        name = part.latch.joint.name
        yield verdict("the latch is turned first", motion.latch_q is not None, name)
    elif motion.latch_q is not None:
        yield verdict("the scene has the latch that the plan turns", False, "no latch to turn")
    if motion.latch_q is not None:
        yield verdict("one value of the latch for each state", len(motion.latch_q) == len(motion.q))


def latch_checks(part: MovedPart, motion: Motion, limits: Limits) -> Iterator[Check]:
    """Check that the latch is turned as the scene says, and that the part rests until then."""
    latch, values = part.latch, motion.latch_q
    if latch is None or values is None:
        return
    span = latch.goal - latch.start
    slack = limits.goal * max(abs(span), 1e-9)
    yield at_most(
        "latch starts at the scene's value", abs(values[0] - latch.start), slack, "rad|m",
        f"{values[0]:.4f}, scene {latch.start:.4f}",
    )  # fmt: skip
    back = float((-np.sign(span) * np.diff(values)).max(initial=0.0))
    yield at_most("latch turns monotonically (largest step back)", back, MAX_STEP_BACK, "rad|m")
    excess = max(latch.joint.lower - values.min(), values.max() - latch.joint.upper, 0.0)
    yield at_most("latch within its joint limits (excess)", excess, limits.joint, "rad|m")
    moves = np.abs(np.diff(motion.object_q)) > MAX_FREE_MOTION
    short = (latch.goal - values[:-1])[moves] * np.sign(span)
    yield at_most(
        "latch short of its value while the part moves", short.max(initial=0.0), slack, "rad|m",
        f"{values[-1]:.4f} at the end, scene {latch.goal:.4f}",
    )  # fmt: skip
