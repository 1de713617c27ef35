"""Biased random walks over the scene graph."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import F1, F2, I1, entry

from .relations import KINDS
from .scene_graph import SceneGraph

if TYPE_CHECKING:
    from jaxtyping import Float, Int


MIN_DISTANCE, MIN_SPREAD = 1e-3, 1e-9
"""Lower bounds of the distance of two objects [m], and of the spread of its inverse [1/m]."""
MIN_WEIGHT = 1e-5
"""What the authors' code adds to each weight, so that the farthest pair has one [-]."""


@dataclass(frozen=True, eq=False)
class Transitions:
    """Transition probabilities of a walk: the neighbors of each object, row by row."""

    start: Int[np.ndarray, " n_plus_1"]
    target: Int[np.ndarray, " m"]
    probability: Float[np.ndarray, " m"]
    """Sums to 1 over each row that is not empty."""

    def dense(self) -> Float[np.ndarray, "n n"]:
        """Return the matrix P(i, j); rows of objects without neighbors are 0."""
        n = len(self.start) - 1
        matrix = np.zeros((n, n))
        matrix[np.repeat(np.arange(n), np.diff(self.start)), self.target] = self.probability
        return matrix


def transitions(graph: SceneGraph, *, k0: float, printed: bool = False) -> Transitions:
    """Compute P(i, j) = w(i, j) / sum over the neighbors u of w(i, u).

    MoMa-Pos, section III-A, gives w = k0 / dist_xy(i, j) + (1 - k0) size(j). The terms have
    different units, which makes k0 hard to interpret. Scaled, each is in (0, 1]: the first relative
    to the closest pair of neighbors, the second to the largest object. Edges are undirected;
    otherwise a cup on a table would be a dead end.

    Args:
        graph: Relations, distances and sizes.
        k0: Weight of the distance against the size, in [0, 1].
        printed: Use the paper's terms, in 1/m and m, instead of the scaled ones.
    """
    edges = graph.adjacency
    edge = edges.data - 1
    closest = 1.0 if printed else graph.dist_xy.min(initial=np.inf)
    largest = 1.0 if printed else graph.size.max()
    near, large = closest / graph.dist_xy[edge], graph.size[edges.indices] / largest
    weight = k0 * near + (1 - k0) * large
    row = np.repeat(np.arange(len(graph)), np.diff(edges.indptr))
    total = np.bincount(row, weight, minlength=len(graph))
    return Transitions(
        edges.indptr.astype(np.int64), edges.indices.astype(np.int64), weight / total[row]
    )


def authors_transitions(graph: SceneGraph) -> Transitions:
    """Return the transition probabilities of the authors' public code.

    Every two objects on the floor are related, with 10 times their inverse distance scaled to
    [0, 1] over the graph. What is carried leads to its support only, with the weight 1.

    Source: Project_MoMa-Pos, `utils_EdgeBuilder.py` and `utils_Graph.py`.
    """
    near = graph.kind == KINDS.index("near")
    child, parent = graph.child[near], graph.parent[near]
    center = graph.upright.center
    inverse = 1 / np.maximum(np.linalg.norm(center[child] - center[parent], axis=1), MIN_DISTANCE)
    spread = max(float(np.ptp(inverse)), MIN_SPREAD) if len(inverse) else 1.0
    floor = 10.0 * (inverse - inverse.min(initial=np.inf)) / spread + MIN_WEIGHT
    rows = np.r_[child, parent, graph.child[~near]]
    columns = np.r_[parent, child, graph.parent[~near]]
    weight = np.r_[floor, floor, np.ones(np.count_nonzero(~near))]
    order = np.lexsort((columns, rows))
    rows, columns, weight = rows[order], columns[order], weight[order]
    start = np.searchsorted(rows, np.arange(len(graph) + 1))
    total = np.bincount(rows, weight, minlength=len(graph))
    return Transitions(start.astype(np.int64), columns.astype(np.int64), weight / total[rows])


@entry
def _walk(start: I1, target: I1, cumulative: F1, first: I1, draws: F2) -> np.ndarray:
    out = np.empty((len(first), draws.shape[1] + 1), np.int64)
    for w in range(len(first)):
        here = first[w]
        out[w, 0] = here
        for s in range(draws.shape[1]):
            low, high = start[here], start[here + 1]
            if high > low:
                next_edge = low + np.searchsorted(cumulative[low:high], draws[w, s], side="right")
                here = target[min(next_edge, high - 1)]
            out[w, s + 1] = here
    return out


def walk(
    steps: Transitions, first: Int[np.ndarray, " w"], length: int, rng: np.random.Generator
) -> Int[np.ndarray, "w length"]:
    """Walk from each given object; without neighbors, a walk stays at its object.

    Args:
        steps: Transition probabilities.
        first: First object of each walk.
        length: Number of objects in a walk.
        rng: Source of the random steps.
    """
    row = np.repeat(np.arange(len(steps.start) - 1), np.diff(steps.start))
    total = np.r_[0.0, np.cumsum(steps.probability)]
    cumulative = total[1:] - total[steps.start[row]]
    draws = rng.random((len(first), length - 1))
    return _walk(steps.start, steps.target, cumulative, np.asarray(first, np.int64), draws)
