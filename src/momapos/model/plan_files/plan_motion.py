"""Read the motion of a plan file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import FileFormatError
from momapos.model.records import Motion

from .holds import read_holds
from .plan_members import Plan

if TYPE_CHECKING:
    from jaxtyping import Float


def read_motion(data: Plan, path: Path) -> Motion | None:
    """Read the motion of a plan; None if it has none.

    Raises:
        FileFormatError: The numbers of states do not fit each other.
    """
    motion, n = data.manipulation, len(data.joints)
    if motion is None:
        return None
    approach = read_array(data.approach, (n,), path, "approach")
    q = read_array(motion.q, (n,), path, "manipulation.q")
    object_q = read_array(motion.object_q, (), path, "manipulation.object_q")
    Ts_world_tool = read_array(motion.T_world_tool, (4, 4), path, "manipulation.T_world_tool")
    if not len(q) == len(object_q) == len(Ts_world_tool):
        raise FileFormatError(
            f"{path}: manipulation has {len(q)} q, {len(object_q)} object_q and "
            f"{len(Ts_world_tool)} T_world_tool; each state needs one of each"
        )
    return Motion(
        approach=approach,
        q=q,
        object_q=object_q,
        Ts_world_tool=Ts_world_tool,
        approach_times=_read_times(data.approach_times, len(approach), path, "approach_times"),
        times=_read_times(motion.times, len(motion.q), path, "manipulation.times"),
        holds=read_holds(motion, path),
        home=None if data.home is None else read_array(data.home, (n,), path, "home"),
    )


def _read_times(
    times: list[float] | None, count: int, path: Path, key: str
) -> Float[np.ndarray, " m"] | None:
    if times is None:
        return None
    values = read_array(times, (), path, key)
    if len(values) != count or (np.diff(values) < 0).any():
        raise FileFormatError(f"{path}: {key} must be {count} non-decreasing times [s]")
    return values


def read_array(
    rows: Sequence[Any], shape: tuple[int, ...], path: Path, key: str, each: str = "one per joint"
) -> Float[np.ndarray, "..."]:
    """Read rows of numbers.

    Args:
        rows: The rows; none give an empty array.
        shape: Shape of each row.
        path, key: File and member, for messages.
        each: What a row holds.

    Raises:
        FileFormatError: A row has another shape.
    """
    if not rows:
        return np.empty((0, *shape))
    size = " x ".join(map(str, shape))
    try:
        array = np.array(rows, float)
    except ValueError as error:
        raise FileFormatError(f"{path}: {key} has rows of different length; need {size}") from error
    if array.shape[1:] != shape:
        found = " x ".join(map(str, array.shape[1:]))
        raise FileFormatError(
            f"{path}: {key} has rows of {found} numbers; need {size}"
            + (f", {each}" if len(shape) == 1 else "")
        )
    return array
