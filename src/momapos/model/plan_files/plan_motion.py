"""Write and read the arm's motion of a plan file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import FileFormatError
from momapos.model.records import Motion

from . import plan_members as members
from .holds import holds_to_dict, read_holds

if TYPE_CHECKING:
    from jaxtyping import Float


def motion_to_dict(motion: Motion | None) -> dict[str, Any]:
    """Return the members of a plan file that describe the arm's motion."""
    if motion is None:
        return {"approach": [], "approach_times": None, "manipulation": None, "home": None}
    return {
        "approach": motion.approach.tolist(),
        "approach_times": _list(motion.approach_times),
        "manipulation": {
            "q": motion.q.tolist(),
            "object_q": motion.object_q.tolist(),
            **({} if motion.base is None else {"base": motion.base.tolist()}),
            **({} if motion.latch_q is None else {"latch_q": motion.latch_q.tolist()}),
            "times": _list(motion.times),
            "T_world_tool": motion.Ts_world_tool.tolist(),
            **holds_to_dict(motion.holds),
        },
        "home": _list(motion.home),
    }


def _list(values: Float[np.ndarray, "..."] | None) -> Any:
    return None if values is None else values.tolist()


def read_motion(data: members.Plan, path: Path) -> Motion | None:
    """Check and return the arm's motion; None if the plan has none."""
    motion, n = data.manipulation, len(data.joints)
    if motion is None:
        return None
    approach = read_array(data.approach, (n,), path, "approach")
    q = read_array(motion.q, (n,), path, "manipulation.q")
    object_q = read_array(motion.object_q, (), path, "manipulation.object_q")
    Ts_world_tool = read_array(motion.T_world_tool, (4, 4), path, "manipulation.T_world_tool")
    latch_q = None
    if motion.latch_q is not None:
        latch_q = read_array(motion.latch_q, (), path, "manipulation.latch_q")
        if len(latch_q) != len(q):
            raise FileFormatError(f"{path}: manipulation.latch_q must have {len(q)} values")
    base = None
    if motion.base is not None:
        base = read_array(motion.base, (3,), path, "manipulation.base", "x, y and yaw")
        base[:, 2] = np.unwrap(base[:, 2])
        if len(base) != len(q):
            raise FileFormatError(f"{path}: manipulation.base must have {len(q)} poses")
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
        approach_times=_times(data.approach_times, len(approach), path, "approach_times"),
        times=_times(motion.times, len(motion.q), path, "manipulation.times"),
        holds=read_holds(motion, path),
        latch_q=latch_q,
        base=base,
        home=None if data.home is None else read_array(data.home, (n,), path, "home"),
    )


def _times(
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
    """Return rows of numbers as an array.

    Args:
        rows: The rows.
        shape: Shape of each row; () for numbers.
        path: The plan file, for messages.
        key: Name of the member, for messages.
        each: What the numbers of a row stand for.

    Raises:
        FileFormatError: The rows have another shape.
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
