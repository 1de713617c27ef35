"""Example arms of various types for tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from tests.model.collision.exact_hulls import directions

from momapos.core.geometry.transforms import rotation_about
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


def geared(seed: int) -> Chain:
    """Build seven joints with four degrees of freedom; three joints follow with other ratios."""
    rng = np.random.default_rng(seed)
    chain = skew(7, seed, slides=(1, 5))
    return replace(
        chain, names=chain.names[:4], dof=np.array([0, 1, 2, 3, 0, 1, 2]),
        ratio=np.append(np.ones(4), rng.uniform(0.3, 2.0, 3) * [-1.0, 1.0, -1.0]),
        lower=chain.lower[:4], upper=chain.upper[:4], velocity=chain.velocity[:4],
    )  # fmt: skip


def segments(chain: Chain, q: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations and origins of the base and all joints, one motion after the other."""
    R, p = [np.eye(3)], [np.zeros(3)]
    for j, value in enumerate(chain.ratio * q[chain.dof]):
        slides = chain.slides[j]
        p.append(p[-1] + R[-1] @ (chain.d[j] + (value * chain.h[j] if slides else 0.0)))
        R.append(R[-1] if slides else R[-1] @ rotation_about(chain.h[j], np.array(value)))
    return np.array(R), np.array(p)
