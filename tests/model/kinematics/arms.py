"""Example arms of various types for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from tests.model.collision.exact_hulls import directions

from momapos.model.kinematics.chain import Chain

UP, LEFT, AHEAD = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)


def arm(
    axes: Sequence[Sequence[float]],
    steps: Sequence[Sequence[float]],
    tool: Sequence[float],
    *,
    slides: Sequence[int] = (),
    reach: float = 2.6,
) -> Chain:
    """Build a chain from axes and offsets; prismatic joints move 0 to 0.5 m."""
    n = len(axes)
    sliding = np.isin(np.arange(n), slides)
    names = tuple(f"j{i}" for i in range(n))
    h = np.array(axes, float)
    return Chain(
        names=names, joints=names, dof=np.arange(n), ratio=np.ones(n), offset=np.zeros(n),
        h=h / np.linalg.norm(h, axis=1, keepdims=True), d=np.array(steps, float), slides=sliding,
        lower=np.where(sliding, 0.0, -reach), upper=np.where(sliding, 0.5, reach),
        velocity=np.ones(n), tool_offset=np.array(tool, float), tool_rotation=np.eye(3),
    )  # fmt: skip


def spherical_shoulder() -> Chain:
    """Build seven joints; the first three axes meet and the last two do not, as in a Panda."""
    right, down = (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)
    return arm(
        [UP, LEFT, UP, right, UP, right, down],
        [(0, 0, 0.333), (0, 0, 0), (0, 0, 0.316), (0.0825, 0, 0), (-0.0825, 0, 0.384), (0, 0, 0),
         (0.088, 0, 0)],
        (0, 0, -0.21),
    )  # fmt: skip


def skew(count: int, seed: int, slides: Sequence[int] = ()) -> Chain:
    """Build joints whose axes are skew, the first in any direction."""
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.08, 0.25, (count, 3)) * rng.choice([-1, 1], (count, 3))
    return arm(directions(count, rng), steps, rng.uniform(0.05, 0.1, 3), slides=slides)


def lift_and_telescope() -> Chain:
    """Build an arm with five degrees of freedom: a lift, a telescope and three wrist joints."""
    return arm(
        [UP, (0.0, -1.0, 0.0), UP, (0.0, -1.0, 0.0), AHEAD],
        [(0, 0, 0.3), (0, -0.2, 0), (0.1, -0.1, 0), (0, 0, -0.05), (0, 0, 0)],
        (0.25, 0, 0),
        slides=(0, 1),
    )
