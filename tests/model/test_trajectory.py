"""Laws of trajectories: they stay within limits and on the path, and both ends are at rest."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.core.errors import InputError
from momapos.model.trajectory import WINDOW, joined, still, time_path

STEP = 0.004
SPEED, ACCELERATION = np.array([1.0, 0.5, 2.0]), np.array([2.0, 2.0, 4.0])


def wavy(rng: np.random.Generator) -> np.ndarray:
    """Return a smooth random path with small steps."""
    s = np.linspace(0.0, 1.0, 80)[:, None]
    a, b, c = rng.uniform(-1.0, 1.0, (3, 3))
    return a * s + b * np.sin(2 * s) + c * s**2


@pytest.mark.parametrize("seed", range(5))
def test_speed_and_acceleration_stay_within_their_limits(seed: int) -> None:
    timed = time_path(wavy(np.random.default_rng(seed)), SPEED, ACCELERATION, STEP)
    assert (np.abs(timed.v) <= SPEED * 1.01).all()
    assert (np.abs(timed.a) <= ACCELERATION * 1.05).all()
    differences = np.diff(timed.q, axis=0)[:-1] / STEP
    np.testing.assert_allclose(differences, timed.v[:-2], atol=2 * STEP * ACCELERATION.max())


def test_a_trajectory_starts_and_ends_at_rest_at_the_ends_of_its_path() -> None:
    q = wavy(np.random.default_rng(0))
    timed = time_path(q, SPEED, ACCELERATION, STEP)
    np.testing.assert_allclose(timed.q[[0, -1]], q[[0, -1]], atol=1e-6)
    np.testing.assert_allclose(timed.v[[0, -1]], 0.0, atol=1e-2)


def test_a_trajectory_stays_on_its_path_at_a_corner() -> None:
    first, second = np.linspace([0, 0], [1, 0], 26), np.linspace([1, 0], [1, 1], 26)
    timed = time_path(np.concatenate([first, second]), np.ones(2), np.ones(2), STEP)
    off = np.minimum(np.abs(timed.q[:, 1]), np.abs(timed.q[:, 0] - 1.0))
    assert off.max() < 1e-6
    at_corner = np.abs(timed.q - [1.0, 0.0]).sum(1).argmin()
    assert np.abs(timed.v[at_corner]).max() < 0.01


@pytest.mark.parametrize("jerk", [np.inf, 10.0])
def test_a_straight_path_takes_the_time_of_a_trapezoidal_profile_and_of_its_jerk(
    jerk: float,
) -> None:
    q = np.linspace([0.0], [1.0], 30)
    timed = time_path(q, np.array([0.5]), np.array([1.0]), STEP, jerk=np.array([jerk]))
    more = max(WINDOW, 2.0 * 1.0 / jerk)
    assert timed.state_times[-1] == pytest.approx(1.0 / 0.5 + 0.5 / 1.0 + more, abs=0.03)


def rounded() -> np.ndarray:
    """Return two straight motions with a smooth bend between them."""
    t = np.linspace(0.0, 1.0, 40)[:, None]
    bend = np.array([[0.8, 0.0]]) + 0.2 * np.hstack(
        [np.sin(t * np.pi / 2), 1 - np.cos(t * np.pi / 2)]
    )
    ends = np.linspace([0, 0], [0.8, 0], 26), np.linspace([1, 0.2], [1, 1], 26)
    return np.concatenate([ends[0], bend[1:-1], ends[1]])


@pytest.mark.parametrize("jerk", [np.inf, 40.0, 3.0])
@pytest.mark.parametrize("path", [0, 1, 2])
def test_acceleration_is_continuous_and_the_jerk_within_its_limit(path: int, jerk: float) -> None:
    q = rounded() if path == 2 else wavy(np.random.default_rng(path))
    n, fine = q.shape[1], 0.001
    speed, acceleration = SPEED[:n], ACCELERATION[:n]
    timed = time_path(q, speed, acceleration, fine, jerk=np.full(n, jerk))
    assert (np.abs(timed.v) <= 1.01 * speed).all()
    assert (np.abs(timed.a) <= 1.01 * acceleration).all()
    change = np.abs(np.diff(timed.a, axis=0)) / fine
    # Over the window the acceleration changes by at most from one limit to the other; a bend adds.
    assert change.max() <= 1.05 * min(jerk, 4.0 * acceleration.max() / WINDOW)
    assert np.abs(timed.a[[0, -1]]).max() == 0.0
    np.testing.assert_allclose(np.gradient(timed.v, fine, axis=0)[1:-1], timed.a[1:-1], atol=0.1)


def test_a_small_jerk_limit_takes_longer() -> None:
    q = wavy(np.random.default_rng(0))
    times = [
        time_path(q, SPEED, ACCELERATION, STEP, jerk=np.full(3, jerk)).state_times[-1]
        for jerk in (np.inf, 5.0, 0.5)
    ]
    assert times[0] < times[1] < times[2]


def test_a_rounded_corner_takes_less_time_than_a_stop() -> None:
    sharp = np.concatenate([np.linspace([0, 0], [1, 0], 26), np.linspace([1, 0], [1, 1], 26)])
    times = [time_path(q, np.ones(2), np.ones(2), STEP).state_times[-1] for q in (sharp, rounded())]
    assert times[1] < 0.96 * times[0]


def test_the_tool_stays_within_its_speed_limit() -> None:
    q = wavy(np.random.default_rng(1))
    tool = q * [0.3, 0.6, 0.2]
    timed = time_path(q, SPEED, ACCELERATION, STEP, tool=tool, tool_speed=0.1)
    speed = np.linalg.norm(timed.v * [0.3, 0.6, 0.2], axis=1)
    assert 0.08 < speed.max() < 0.102


def test_the_tool_stays_within_its_acceleration_limit_along_each_axis() -> None:
    q, scale = wavy(np.random.default_rng(1)), np.array([0.3, 0.6, 0.2])
    free = time_path(q, SPEED, ACCELERATION, STEP, tool=q * scale)
    most = np.abs(free.a * scale).max() / 4
    timed = time_path(q, SPEED, ACCELERATION, STEP, tool=q * scale, tool_acceleration=most)
    reached = np.abs(timed.a * scale).max()
    assert 0.9 * most < reached < 1.05 * most


def test_paths_with_repeated_states_or_a_single_state_have_trajectories() -> None:
    q = np.repeat(wavy(np.random.default_rng(2)), 2, axis=0)
    assert len(time_path(q, SPEED, ACCELERATION, STEP)) > 10
    assert len(time_path(q[:1], SPEED, ACCELERATION, STEP)) == 1


def test_nan_is_rejected() -> None:
    with pytest.raises(InputError, match="NaN"):
        time_path(np.full((3, 3), np.nan), SPEED, ACCELERATION, STEP)


def test_joined_trajectories_index_their_parts() -> None:
    whole, part = joined([still(np.zeros(2), 3), still(np.ones(2), 2)])
    assert len(whole) == 5
    assert part.tolist() == [0, 0, 0, 1, 1]


def test_every_state_is_passed_at_its_state_time() -> None:
    bend = np.linspace([1, 0, 0], [1, 1, 0.5], 26)
    q = np.concatenate([np.linspace([0, 0, 0], [1, 0, 0], 26), bend])
    timed = time_path(q, SPEED, ACCELERATION, STEP)
    assert (np.diff(timed.state_times) >= 0).all()
    samples = np.arange(len(timed)) * STEP
    there = np.stack([np.interp(timed.state_times, samples, column) for column in timed.q.T], -1)
    np.testing.assert_allclose(there, q, atol=STEP)
