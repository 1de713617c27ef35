"""Outcomes of the candidates, grouped into the few kinds that a figure can show."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import PoseStatus
from momapos.planning.placement import Search

if TYPE_CHECKING:
    from jaxtyping import Float, Int


@dataclass(frozen=True)
class MarkerKind:
    """Outcomes that share a marker."""

    name: str
    statuses: tuple[PoseStatus, ...]
    color: str
    marker: str
    filled: bool = False
    size: float = 2.6
    """Size of the marker [pt]."""
    obvious: bool = False
    """Whether the room alone explains it; such candidates are drawn under the furniture."""


_S = PoseStatus
KINDS = (
    MarkerKind("beyond the arm's reach", (_S.BEYOND_ARM,), "#c9ced3", ".", size=2.2, obvious=True),
    MarkerKind(
        "base",
        (
            _S.BASE_BLOCKED, _S.BASE_PATH_BLOCKED, _S.BASE_COLLISION, _S.OFF_FLOOR, _S.NO_ROUTE,
            _S.NO_PASSAGE, _S.NO_ROUTE_AT_HOME, _S.AREA_IN_THE_WAY, _S.NO_ROUTE_CARRYING,
        ),
        "#a3aab1", "x", size=2.2, obvious=True,
    ),
    MarkerKind(
        "out of reach",
        (
            _S.OUT_OF_REACH, _S.TOO_FEW_JOINTS, _S.OUT_OF_REACH_ANYWHERE,
            _S.WAYPOINT_OUT_OF_REACH, _S.NO_GRASP_IN_REACH,
        ),
        "#4f6d8f", "o",
    ),
    MarkerKind("not checked", (_S.NOT_TRIED, _S.PATH_FOUND), "#6f7a83", ".", size=2.8),
    MarkerKind(
        "other",
        (
            _S.FILTERED, _S.NOT_KEPT_IN, _S.NOT_KEPT_OUT, _S.NOT_FACING, _S.TOO_LONG_A_DRIVE,
            _S.TASK_INFEASIBLE, _S.LITTLE_ROOM, _S.NOT_FOR_ALL,
        ),
        "#555555", "*", size=3.4,
    ),
    MarkerKind("arm hits", (_S.ARM_COLLISION, _S.HOME_COLLISION), "#b52ad6", "^", size=3.2),
    MarkerKind("no continuous path", (_S.NO_CONTINUOUS_PATH,), "#7a4a1e", "s"),
    MarkerKind("too much load", (_S.OVERLOAD, _S.TIPS_OVER), "#ff9d6e", "v", size=3.2),
    MarkerKind("no approach", (_S.NO_APPROACH, _S.NO_WAY_HOME), "#7d7a1f", "D"),
    MarkerKind("exact check", (_S.EXACT_CHECK,), "#330000", "P", size=3.6),
    MarkerKind("feasible", (_S.FEASIBLE,), "#009e73", "o", filled=True, size=5.0),
)  # fmt: skip
"""Kinds in the order of the checks that fail, which is also the drawing order."""
KIND_OF = {status: index for index, kind in enumerate(KINDS) for status in kind.statuses}
"""Index of the kind that a status belongs to."""
_NOWHERE = (PoseStatus.OUT_OF_REACH_ANYWHERE, PoseStatus.TASK_INFEASIBLE)


@dataclass(frozen=True, eq=False)
class Outcomes:
    """All candidates of a search."""

    poses: Float[np.ndarray, "n 3"]
    kind: Int[np.ndarray, " n"]
    """Index into `KINDS`."""
    counts: dict[tuple[int, str], int]
    """Number of candidates by kind and summary."""


def outcomes(search: Search) -> Outcomes:
    """Group the candidates of a search by kind."""
    poses = np.concatenate([np.zeros((0, 3)), *search.poses])
    seen = [outcome for block in search.outcomes for outcome in block]
    counts = Counter((KIND_OF[outcome.status], outcome.summary) for outcome in seen)
    kind = np.array([KIND_OF[outcome.status] for outcome in seen], int)
    # If no pose can be sampled, the search reports it as one candidate without a pose.
    placed = np.array([outcome.status not in _NOWHERE for outcome in seen], bool)
    return Outcomes(poses[placed], kind[placed], dict(counts))


def thin(
    points: Float[np.ndarray, "n 2"], rank: Int[np.ndarray, " n"], most: int
) -> Int[np.ndarray, " k"]:
    """Return the indices of all points, or of the highest-ranked point in each cell of a grid.

    Args:
        points: Positions [m].
        rank: Priority of each point.
        most: Maximum number of points; the cells grow until it is met.
    """
    cell = 0.0
    chosen = np.arange(len(points))
    while len(chosen) > most:
        cell += 0.05
        cells = np.floor(points / cell).astype(np.int64)
        off_center = np.abs(points / cell - cells - 0.5).max(1).round(2)
        order = np.lexsort((off_center, -rank, cells[:, 1], cells[:, 0]))
        step = np.diff(cells[order], axis=0, prepend=cells[order[:1]] - 1)
        chosen = order[(step != 0).any(1)]
    return np.sort(chosen)
