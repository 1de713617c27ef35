"""Rank the objects of a scene by their importance for a task, and grow the set S of key objects."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, expect, finite_array, whole_number
from momapos.model.records import KeyObjects
from momapos.model.scene import Scene
from momapos.planning.grasps import hand_path

from .config import ImportanceConfig
from .scene_graph import SceneGraph, build_graph
from .scorers import MIN_SCORE, SCORERS

if TYPE_CHECKING:
    from jaxtyping import Float


DIGITS = 6
"""Decimals of a score [-]."""


@dataclass(frozen=True, eq=False)
class Importance:
    """All objects of a scene, most important first, starting with the target."""

    target: str
    names: tuple[str, ...]
    scores: Float[np.ndarray, " n"]
    """In (0, 1], in descending order; the target's is 1."""
    alpha: float
    scorer: str
    seed: int
    graph: SceneGraph
    exceed: bool = False
    """Whether the scores of S exceed alpha, instead of reaching it."""

    def __repr__(self) -> str:
        count, chosen = len(self.names), len(self.selected())
        return f"<Importance for {self.target!r} by {self.scorer}: {chosen} of {count} in S>"

    @cached_property
    def by_name(self) -> dict[str, float]:
        """Scores by object name."""
        return dict(zip(self.names, map(float, self.scores), strict=True))

    @cached_property
    def _rows(self) -> list[int]:
        place = {name: i for i, name in enumerate(self.graph.names)}
        return [place[name] for name in self.names]

    @cached_property
    def relations(self) -> tuple[str, ...]:
        """Relation of each object to the target: on, in, inside, carries, contains, near or ""."""
        words = self.graph.relations(self.graph.index(self.target))
        return tuple(words[i] for i in self._rows)

    @cached_property
    def steps(self) -> tuple[int, ...]:
        """Number of relations on the shortest path to the target, -1 without a path."""
        steps = self.graph.steps(self.graph.index(self.target))
        return tuple(int(steps[i]) for i in self._rows)

    def selected(self, alpha: float | None = None) -> tuple[str, ...]:
        """Return the set S: the target and names with a score of at least alpha, in order.

        With `exceed`, the score must be above alpha.

        Args:
            alpha: Threshold in [0, 1]; None for the configured one. At 0 all objects are in S.

        Raises:
            InputError: The threshold is outside [0, 1].
        """
        limit = self.alpha if alpha is None else alpha
        if not 0 <= limit <= 1:
            raise InputError(f"alpha must be between 0 and 1, not {limit:g}")
        return self.names[: int(np.count_nonzero(self.scores >= self.lowest_score(limit)))]

    def lowest_score(self, alpha: float) -> float:
        """Return the lowest score with which an object is in S, for a threshold alpha [-].

        It is at most 1, so that the target is always in S.
        """
        return min(float(np.nextafter(alpha, 2.0)), 1.0) if self.exceed else alpha

    def score(self, name: str) -> float:
        """Return the score of one object.

        Raises:
            UnknownNameError: There is no such object; the message suggests the nearest name.
        """
        self.graph.index(name)
        return float(self.scores[self.names.index(name)])


def rank(
    scene: Scene,
    target: str,
    config: ImportanceConfig | None = None,
    *,
    joint: str | None = None,
    path: Float[np.ndarray, "k 3"] | None = None,
    seed: int = 0,
) -> Importance:
    """Score every object of a scene relative to the target (MoMa-Pos, section III-A).

    Walls of the room have no score; they are always modeled as what they are.

    Args:
        scene: The scene.
        target: Name of the task's object.
        config: How to score.
        joint: The target's joint that the task moves; by default all with a handle.
        path: Positions of the hand, in the world frame [m]; by default those at which it opens the
            joint, or the middle of a target without one. Only the scorer `reach` uses them.
        seed: Same seed, same scores.

    Raises:
        UnknownNameError: There is no such object or joint; the message suggests the nearest name.
        InputError: The seed is no integer from 0 to 2**32 - 1, or the target is a wall.
    """
    expect("scene", scene, Scene, "load_scene reads one")
    expect("target", target, str)
    config = ImportanceConfig() if config is None else config
    expect("config", config, ImportanceConfig)
    config = config.resolved
    if path is not None:
        path = finite_array("path", path, (None, 3))
    seed = whole_number("seed", seed, 0, 2**32 - 1)
    if scene.object(target).wall is not None:
        raise InputError(f"{target!r} is a wall of the room; no task is about it")
    graph = build_graph(scene.furniture, config.graph)
    chosen = graph.index(target)
    scorer, alpha = config.scorer, config.alpha
    assert scorer is not None
    assert alpha is not None
    if joint is not None:
        scene.object(target).joint(joint)
    if path is None and scorer == "reach":
        path = hand_path(scene, target, joint)
    scores = SCORERS[scorer](graph, chosen, config, seed, path)
    # Rounded, because the last digits depend on the processor.
    scores = np.clip(np.round(scores, DIGITS), MIN_SCORE, 1.0)
    scores[chosen] = 1.0
    others = np.arange(len(graph)) != chosen
    order = np.lexsort((np.arange(len(graph)), graph.gaps(chosen), -scores, others))
    return Importance(
        target=target,
        names=tuple(graph.names[i] for i in order),
        scores=scores[order],
        alpha=alpha,
        scorer=scorer,
        seed=seed,
        graph=graph,
        exceed=bool(config.exceed),
    )


@dataclass(frozen=True)
class Selection:
    """The objects that have a kinematic model; all others are boxes."""

    ranked: Importance
    alpha: float
    """Current threshold [-]."""
    joined: frozenset[str] = frozenset()
    """Objects that a check has added, regardless of their score."""
    rounds: int = 0
    """Number of times that a plan was checked again because objects were added [-]."""

    @property
    def names(self) -> tuple[str, ...]:
        """S, most important first."""
        scored = set(self.ranked.selected(self.alpha))
        return tuple(n for n in self.ranked.names if n in scored or n in self.joined)

    @property
    def boxes(self) -> tuple[str, ...]:
        """All other objects, most important first."""
        chosen = set(self.names)
        return tuple(n for n in self.ranked.names if n not in chosen)

    def join(self, names: Iterable[str]) -> Selection:
        """Return the selection with more objects, regardless of their score."""
        return replace(self, joined=self.joined | frozenset(names))

    def relax_alpha(self) -> Selection:
        """Lower alpha until S is twice as large or contains all objects (MoMa-Pos, Lemma 1)."""
        wanted = min(2 * len(self.names), len(self.ranked.names))
        for score in self.ranked.scores:
            lower = replace(self, alpha=min(self.alpha, float(score)))
            if len(lower.names) >= wanted:
                return lower
        return replace(self, alpha=0.0)

    def record(self) -> KeyObjects:
        """Return the record for the plan."""
        ranked = self.ranked
        return KeyObjects(ranked.scorer, self.alpha, self.names, ranked.by_name, self.rounds)


def everything(ranked: Importance) -> Selection:
    """Select all objects."""
    return Selection(ranked, 0.0)


def start_of(ranked: Importance) -> Selection:
    """Select the objects above the configured threshold."""
    return Selection(ranked, ranked.alpha)
