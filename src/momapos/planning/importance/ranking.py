"""Which objects deserve a kinematic model, for a task with one of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.model.scene import Scene

from .config import ImportanceConfig
from .scene_graph import SceneGraph, build_graph
from .scorers import LEAST, SCORERS

if TYPE_CHECKING:
    from jaxtyping import Float

DIGITS = 6
"""Decimals of a score [-]."""


@dataclass(frozen=True, eq=False)
class Importance:
    """All objects of a scene, the most important first; the target leads."""

    target: str
    names: tuple[str, ...]
    scores: Float[np.ndarray, " n"]
    """In (0, 1], falling; the target's is 1."""
    alpha: float
    scorer: str
    seed: int
    graph: SceneGraph

    def __repr__(self) -> str:
        count, chosen = len(self.names), len(self.selected())
        return f"<Importance for {self.target!r} by {self.scorer}: {chosen} of {count} in S>"

    @cached_property
    def by_name(self) -> dict[str, float]:
        """The score of each object."""
        return dict(zip(self.names, map(float, self.scores), strict=True))

    @cached_property
    def _rows(self) -> list[int]:
        """Place of each object in the graph."""
        place = {name: i for i, name in enumerate(self.graph.names)}
        return [place[name] for name in self.names]

    @cached_property
    def relations(self) -> tuple[str, ...]:
        """What each is to the target: on, in, inside, carries, contains, near; else ""."""
        words = self.graph.relations(self.graph.index(self.target))
        return tuple(words[i] for i in self._rows)

    @cached_property
    def steps(self) -> tuple[int, ...]:
        """Relations on the shortest way to the target; -1 where there is none."""
        steps = self.graph.steps(self.graph.index(self.target))
        return tuple(int(steps[i]) for i in self._rows)

    def selected(self, alpha: float | None = None) -> tuple[str, ...]:
        """The set S: names with a score of at least alpha, most important first.

        Args:
            alpha: Threshold in [0, 1]; the configured one by default. At 0 everything is in S.

        Raises:
            InputError: The threshold is outside.
        """
        limit = self.alpha if alpha is None else alpha
        if not 0 <= limit <= 1:
            raise InputError(f"alpha must be between 0 and 1, not {limit:g}")
        return self.names[: int(np.count_nonzero(self.scores >= limit))]

    def score(self, name: str) -> float:
        """The score of one object.

        Raises:
            UnknownNameError: There is none; the message offers the nearest.
        """
        self.graph.index(name)
        return float(self.scores[self.names.index(name)])


def rank(
    scene: Scene,
    target: str,
    config: ImportanceConfig | None = None,
    *,
    path: Float[np.ndarray, "k 3"] | None = None,
    seed: int = 0,
) -> Importance:
    """Score every object of a scene against the target (MoMa-Pos, section III-A).

    Args:
        scene: The room.
        target: Name of the object that the task is about.
        config: How to score.
        path: Where the hand goes, in the world [m]; only the scorer `reach` looks at it.
        seed: Same seed, same scores.

    Raises:
        UnknownNameError: There is no such object; the message offers the nearest.
        InputError: The seed is no integer from 0 to 2**32 - 1.
    """
    config = config or ImportanceConfig()
    if not 0 <= seed < 2**32:
        raise InputError(f"seed must be between 0 and 4294967295, not {seed}")
    scene.object(target)
    graph = build_graph(scene, config.graph)
    chosen = graph.index(target)
    scorer = config.scorer or "reach"
    scores = SCORERS[scorer](graph, chosen, config, seed, path)
    # The last digits are the processor's.
    scores = np.clip(np.round(scores, DIGITS), LEAST, 1.0)
    scores[chosen] = 1.0
    others = np.arange(len(graph)) != chosen
    order = np.lexsort((np.arange(len(graph)), graph.gaps(chosen), -scores, others))
    return Importance(
        target=target,
        names=tuple(graph.names[i] for i in order),
        scores=scores[order],
        alpha=config.alpha,
        scorer=scorer,
        seed=seed,
        graph=graph,
    )
