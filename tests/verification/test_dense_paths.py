"""The checked states of a motion: straight between those of the plan, in small steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

from momapos.model.records.plans import Motion
from momapos.verification.path_checks import count_cuts, count_states, dense_path

STEP = 0.02


def motion_of(seed: int, *, home: bool, base: bool) -> Motion:
    rng = np.random.default_rng(seed)

    def walk(count: int, columns: int) -> Float[np.ndarray, "count columns"]:
        return np.cumsum(rng.normal(0.0, 0.05, (count, columns)), axis=0)

    q = walk(9, 6)
    return Motion(
        walk(5, 6), q, np.cumsum(rng.uniform(0.0, 0.3, 9)), np.tile(np.eye(4), (9, 1, 1)),
        home=q[-1] + walk(4, 6) if home else None, latch_q=walk(9, 1)[:, 0],
        base=walk(9, 3) if base else None,
    )  # fmt: skip


@pytest.mark.parametrize("home", [False, True])
@pytest.mark.parametrize("base", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_the_checked_states_are_on_straight_motions_in_small_steps(
    seed: int, home: bool, base: bool
) -> None:
    motion = motion_of(seed, home=home, base=base)
    path = dense_path(motion, STEP)
    assert count_states(motion, STEP) == len(path.q)
    held = motion.q if motion.home is None else np.vstack([motion.q, motion.home])
    rest = len(held) - len(motion.q)
    moving = [held]
    if motion.base is not None:
        others = np.column_stack([motion.base, motion.object_q])
        moving.append(np.vstack([others, np.tile(others[-1], (rest, 1))]))
    for rows, planned in (
        (slice(path.approach), [motion.approach]),
        (slice(path.approach, None), moving),
    ):
        at = path.at[rows]
        assert (at[0], at[-1]) == (0.0, len(planned[0]) - 1)
        assert (np.diff(at) > 0.0).all()
        assert set(range(len(planned[0]))) <= set(at.tolist())
        steps = np.abs(np.diff(path.q[rows], axis=0)).max(1)
        assert steps.max() <= STEP + 1e-12
        columns = np.column_stack(planned)
        exact = np.array([np.interp(at, np.arange(len(c)), c) for c in columns.T]).T
        np.testing.assert_allclose(path.q[rows], exact[:, :6], atol=1e-12)
        # No more states than needed: the pieces between two states of the plan are the fewest.
        largest = np.abs(np.diff(columns, axis=0)).max(1)
        counts = np.bincount(at[:-1].astype(int))
        np.testing.assert_array_equal(counts, np.maximum(1.0, np.ceil(largest / STEP - 1e-9)))
    after = path.at[path.approach :]
    for found, values in ((path.object_q, motion.object_q), (path.latch_q, motion.latch_q)):
        assert found is not None
        assert values is not None
        assert (found[: path.approach] == values[0]).all()
        np.testing.assert_allclose(
            found[path.approach :], np.interp(after, np.arange(9), values), atol=1e-12
        )
    if motion.base is not None:
        assert path.base is not None
        assert (path.base[: path.approach] == motion.base[0]).all()
        for k in range(3):
            there = np.interp(after, np.arange(9), motion.base[:, k])
            np.testing.assert_allclose(path.base[path.approach :, k], there, atol=1e-12)
    assert path.at[path.planned].tolist() == list(range(len(held)))


def test_a_motion_without_an_approach_begins_with_its_manipulation() -> None:
    motion = replace(motion_of(0, home=False, base=False), approach=np.zeros((0, 6)))
    path = dense_path(motion, STEP)
    assert path.approach == 0
    assert count_states(motion, STEP) == len(path.q)
    assert path.where(0) == "manipulation state 0.00"


@pytest.mark.parametrize(
    ("travel", "least", "cuts"), [(0.0, 8, 8), (1.0, 8, 56), (0.16, 8, 8), (0.17, 8, 16)]
)
def test_a_path_is_cut_into_a_multiple_of_a_number(travel: float, least: int, cuts: int) -> None:
    values = np.array([0.3, 0.3 + travel, 0.3 + travel / 2])
    assert count_cuts(values, STEP, least) == cuts
