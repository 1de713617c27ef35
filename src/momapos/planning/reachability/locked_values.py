"""Choose the values at which a redundant arm's joints are locked, in the order of trying them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from momapos.model.kinematics import Chain, IkArrays, IkModel, build_ik, ik_arrays

from .arm_axes import ArmAxes
from .map_kernels import ShoulderSamples, arc_mask

Samples = tuple[IkArrays, ShoulderSamples]
MAX_SAMPLES = 100_000
"""Largest number of IK samples; never reached, so that the samples form a full grid [-]."""
HALVINGS = 2
"""How often the spacing of the first joint's values is halved where they disagree [-]."""


def locked_samples(chain: Chain, frame: ArmAxes, count: int, heights: int) -> Samples:
    """Build the IK model of the freed arm, with its samples in the order of trying them.

    If IK locks the first joint of a redundant arm, the locked value determines which azimuths a
    sample can serve. Straight ahead comes first, then the values farthest to the sides; values
    between two that agree add nothing. Then values in between are tried where the result changes,
    at half the spacing each time.

    Args:
        chain: The arm with its first turning joint freed.
        frame: Its first and last axis.
        count: Number of values of a redundant turning joint that are always tried [-].
        heights: Number of values of a torso [-].

    Returns:
        The IK model for the kernels, and the value at which each sample locks the first joint.
    """
    first = frame.first
    # So many values of a turning joint give `heights` values of a torso.
    ik = build_ik(chain, samples_per_joint=2 * heights - 1, max_samples=MAX_SAMPLES)
    if first in ik.active:
        # A map needs only one solution: seeds are not tried.
        ik = replace(build_ik(chain, samples_per_joint=count), tries=0)
        zero = np.zeros(len(ik.samples), np.int64)
        return ik_arrays(ik), ShoulderSamples(zero.astype(np.uint64), zero, zero)
    values = count << HALVINGS
    # Straight ahead is 0. The spacing at which a value first appears decides when it is tried.
    offset = np.arange(values) - values // 2
    step = np.where(offset % (1 << HALVINGS) == 0, 0, offset & -offset)
    pan = offset * (2 * np.pi / values)
    order = np.lexsort((pan, np.where(offset == 0, -np.inf, -np.abs(pan)), -step, step > 0))
    ik, repeat = _turned(replace(ik, tries=0), frame, pan[order])
    order = np.repeat(order, repeat)
    return ik_arrays(ik), ShoulderSamples(
        _arcs(pan[order], frame, np.pi / values), order, step[order]
    )


def _turned(ik: IkModel, frame: ArmAxes, pan: np.ndarray) -> tuple[IkModel, int]:
    """Turn the samples at one value of the first joint to other values; return also their number.

    Turning the model is a hundred times faster than deriving it at every value.
    """
    held = ik.samples[:, frame.first]
    one = np.flatnonzero(held == held.min())
    angle = frame.turn * (pan - held.min())
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(len(pan))
    R = np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1]]).transpose(2, 0, 1)
    samples = np.tile(ik.samples[one], (len(pan), 1, 1))
    samples[..., frame.first] = pan[:, None]

    def point(p: np.ndarray) -> np.ndarray:
        return np.einsum("vij,s...j->vs...i", R, p - frame.axis) + frame.axis

    turned = {
        "samples": samples,
        "h": np.einsum("vij,saj->vsai", R, ik.h[one]),
        "o": point(ik.o[one]),
        "wrist": point(ik.wrist[one]),
        "R_tool": np.einsum("vij,sjk->vsik", R, ik.R_tool[one]),
        "p_tool": point(ik.p_tool[one]),
    }
    flat = {name: a.reshape(-1, *a.shape[2:]) for name, a in turned.items()}
    return replace(ik, **flat), len(one)


def _arcs(pan: np.ndarray, frame: ArmAxes, slack: float) -> np.ndarray:
    """Return the azimuths that values of the first joint can serve, with half a step of slack.

    On average, the last value that works is half a step before the last one that would work.
    """
    lower, upper = frame.limits[0] - slack, frame.limits[1] + slack
    return np.array([arc_mask(q, float(frame.turn), lower, upper) for q in pan], np.uint64)
