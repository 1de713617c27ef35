"""Static loads are slopes of the potential energy; stability balances moments about an edge."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float
from tests.model.kinematics import arms

from momapos.core.units import GRAVITY
from momapos.model.kinematics.chain import Chain
from momapos.model.kinematics.statics import BASE, LoadArrays, static_loads

DIRECTIONS = 0.4 + np.pi / 2 * np.arange(4)
NORMALS = np.column_stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
EDGES = np.array([0.4, 0.3, 0.25, 0.2])
"""Outward normals of a support area, and distances of its edges from the base's origin [m]."""


def loads_of(chain: Chain, rng: np.random.Generator) -> LoadArrays:
    count = chain.last + 1
    mass, center = rng.uniform(0.5, 4.0, count), rng.uniform(-0.2, 0.2, (count, 3))
    mass[0] = 60.0
    return LoadArrays(mass, center, np.full(chain.size, np.inf), NORMALS, EDGES, 0.0)


def centers(chain: Chain, robot: LoadArrays, q: Float[np.ndarray, " n"]) -> np.ndarray:
    R, p = arms.segments(chain, q)
    return np.asarray(p + (R @ robot.center[..., None])[..., 0])


@pytest.mark.parametrize("seed", range(4))
def test_efforts_are_the_slope_of_the_energy_of_weights_and_of_a_force(seed: int) -> None:
    """Also where one degree of freedom moves several joints, each with a ratio."""
    rng, chain = np.random.default_rng(seed), arms.geared(seed)
    robot = loads_of(chain, rng)
    held, force = rng.uniform(-0.3, 0.3, 3), rng.normal(0.0, 30.0, 3)  # on the last segment

    def point(q: np.ndarray) -> np.ndarray:
        R, p = arms.segments(chain, q)
        return np.asarray(p[-1] + R[-1] @ held)

    def energy(q: np.ndarray) -> float:
        heights = centers(chain, robot, q)[:, 2]
        return float(GRAVITY * robot.mass @ heights - force @ point(q))

    for q in rng.uniform(-1.0, 1.0, (5, chain.size)):
        efforts = static_loads(q[None], chain.arrays, robot, force[None], point(q)[None])[0]
        slope = [(energy(q + step) - energy(q - step)) / 2e-5 for step in 1e-5 * np.eye(chain.size)]
        np.testing.assert_allclose(efforts[0], slope, atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_the_weights_hold_the_robot_down_at_its_nearest_edge(seed: int) -> None:
    """About each edge, the moment of all forces is that of the floor's force at its distance."""
    rng, chain = np.random.default_rng(seed), arms.skew(6, seed, slides=(1,))
    robot = loads_of(chain, rng)
    count = 30
    q = rng.uniform(-1.0, 1.0, (count, chain.size))
    force, point = rng.normal(0.0, 150.0, (count, 3)), rng.normal(0.0, 0.5, (count, 3))
    stability = static_loads(q, chain.arrays, robot, force, point)[1]
    expected = []
    for state, pull, at in zip(q, force, point, strict=True):
        where = np.vstack([centers(chain, robot, state), at])
        forces = np.vstack([-GRAVITY * robot.mass[:, None] * [0.0, 0.0, 1.0], pull])
        inside = []
        for normal, offset in zip(NORMALS, EDGES, strict=True):
            n = np.append(normal, 0.0)
            about = np.cross([0.0, 0.0, 1.0], n)  # along the edge
            moment = np.cross(where - offset * n, forces).sum(0) @ about
            inside.append(moment / forces[:, 2].sum())
        expected.append(min(inside))
    np.testing.assert_allclose(stability, expected, atol=1e-9)
    assert min(expected) < 0.0 < max(expected)


def test_a_lifted_robot_tips_and_one_without_known_wheels_does_not() -> None:
    rng, chain = np.random.default_rng(0), arms.skew(6, 0)
    robot = loads_of(chain, rng)
    q, point = np.zeros((2, chain.size)), np.zeros((2, 3))
    weight = GRAVITY * robot.mass.sum()
    force = np.array([[0.0, 0.0, 1.01 * weight], [0.0, 0.0, 0.5 * weight]])
    lifted, held = static_loads(q, chain.arrays, robot, force, point)[1]
    assert lifted == -np.inf
    assert np.isfinite(held)
    unknown = robot._replace(normals=np.zeros((0, 2)), offsets=np.zeros(0))
    assert (static_loads(q, chain.arrays, unknown, force, point)[1] == np.inf).all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_excess_is_that_of_the_most_loaded_motor(sign: float) -> None:
    """The sign of an effort does not count, and a motor without a limit never exceeds it."""
    rng, chain = np.random.default_rng(3), arms.skew(6, 3)
    robot, q = loads_of(chain, rng), np.zeros((1, chain.size))
    force = np.array([[0.0, 0.0, sign * 200.0]])
    call = (q, chain.arrays, robot, force, np.array([[0.5, 0.5, 0.0]]))
    efforts = np.abs(static_loads(*call)[0][0])
    for k in range(chain.size):
        limit = 10.0 * efforts
        limit[k] = efforts[k] / 1.7
        weak = robot._replace(limit=limit, least_stability=-np.inf)
        _, _, excess, where = static_loads(*call[:2], weak, *call[3:])
        assert (excess[0], where[0]) == (pytest.approx(0.7), k)


def test_a_centimeter_of_tipping_counts_as_a_tenth_of_an_effort_limit() -> None:
    rng, chain = np.random.default_rng(4), arms.skew(6, 4)
    robot, none = loads_of(chain, rng), np.zeros((1, 3))
    q = np.zeros((1, chain.size))
    stability = static_loads(q, chain.arrays, robot, none, none)[1][0]
    for short in (0.01, -0.01):
        near = robot._replace(least_stability=stability + short)
        _, _, excess, where = static_loads(q, chain.arrays, near, none, none)
        assert (excess[0], where[0]) == (pytest.approx(10.0 * short), BASE)
