"""Configuration of importance; imports nothing heavy, so that the command line starts quickly."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, Optional

from momapos.core import InputError, check_fields, refuse_above

MAX_COUNT = 10_000
"""Upper bound of every count, so that a typing error does not run for hours [-]."""
ALPHA = 0.45
"""Score of the least important object that is in S by default [-]."""
ScorerName = Literal["reach", "deepwalk", "node2vec", "distance", "size", "names"]
WeightsName = Literal["scaled", "printed"]
EdgesName = Literal["support", "near", "dense"]


@dataclass(frozen=True)
class GraphConfig:
    """Thresholds of the relations between objects."""

    contact: float = 0.02
    """Largest vertical gap or overlap of two surfaces in contact [m]."""
    edges: Optional[EdgesName] = None  # noqa: UP045 (see cli.options)
    """support: only on, in and inside, which the paper names; near: also between objects that are
    near; dense: also between every two objects that nothing carries, as in the authors' code. None:
    support for the scorer deepwalk, dense for node2vec, else near."""
    neighbors: int = 4
    """Number of nearest objects that count as near [-]."""
    near: float = 1.0
    """Largest gap between the boxes of two objects that are near [m]."""
    floor: float = 0.1
    """Lower bound of the horizontal distance between two centers [m]."""

    def __post_init__(self) -> None:
        check_fields(self)
        if not (0 < self.contact < math.inf and 0 < self.floor < math.inf):
            raise InputError("GraphConfig.contact and floor must be finite and above 0 m")
        if not (self.neighbors >= 0 and self.near >= 0):
            raise InputError("GraphConfig.neighbors and near must be at least 0")
        refuse_above(self, MAX_COUNT, "neighbors")


@dataclass(frozen=True)
class ImportanceConfig:
    """How objects are scored relative to the target."""

    scorer: Optional[ScorerName] = None  # noqa: UP045 (see cli.options)
    """reach: size relative to the distance from the hand's path; deepwalk: the paper's scorer;
    node2vec: that of its authors' code; distance: distance to the target; size: size relative to
    that distance; names: words only. None: deepwalk with the paper's placement method, node2vec
    with that of the authors' code, else reach."""
    alpha: Optional[float] = None  # noqa: UP045 (see cli.options)
    """Objects with at least this score are in S, from 0 to 1. None: 0.45, but a plan in a scene of
    at most 50 objects models all of them [-]."""
    exceed: Optional[bool] = None  # noqa: UP045 (see cli.options)
    """Whether a score must exceed alpha. None: yes for the scorer deepwalk, else no."""
    k0: float = 0.5
    """Weight of distance against size in the walks, from 0 to 1 [-]."""
    weights: Optional[WeightsName] = None  # noqa: UP045 (see cli.options)
    """Weights of the walks. printed: k0 / distance + (1 - k0) size in meters, as in the paper;
    scaled: both terms in (0, 1]. None: printed. The scorer node2vec has weights of its own."""
    walks: int = 15
    """Number of walks from each object [-]."""
    length: int = 20
    """Number of objects in a walk [-]."""
    window: int = 4
    """Number of objects before and after in a walk that count as context [-]."""
    dimensions: int = 64
    """Length of an object's vector [-]."""
    epochs: int = 3
    """Number of passes over the walks [-]."""
    vectors: Optional[str] = None  # noqa: UP045 (see cli.options)
    """File of word vectors for the scorer names, in the text format of GloVe and word2vec: a word
    and its numbers per line. None: vectors trained on the built-in kitchens."""
    graph: GraphConfig = field(default_factory=GraphConfig)

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("alpha", "k0"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 1:
                raise InputError(f"ImportanceConfig.{name} must be from 0 to 1, not {value:g}")
        for name, least in (
            ("walks", 1), ("length", 2), ("window", 1), ("dimensions", 1), ("epochs", 1),
        ):  # fmt: skip
            value = getattr(self, name)
            if not least <= value <= MAX_COUNT:
                raise InputError(
                    f"ImportanceConfig.{name} must be from {least} to {MAX_COUNT}, not {value}"
                )
        if self.vectors is not None and self.scorer != "names":
            raise InputError("ImportanceConfig.vectors needs the scorer names; set scorer to it")

    @property
    def resolved(self) -> ImportanceConfig:
        """Return the configuration with the scorer's own settings where none are given."""
        scorer = self.scorer or "reach"
        edges: EdgesName = self.graph.edges or _EDGES.get(scorer, "near")
        return replace(
            self, scorer=scorer, weights=self.weights or "printed",
            alpha=ALPHA if self.alpha is None else self.alpha,
            exceed=scorer == "deepwalk" if self.exceed is None else self.exceed,
            graph=replace(self.graph, edges=edges),
        )  # fmt: skip


_EDGES: dict[ScorerName, EdgesName] = {"deepwalk": "support", "node2vec": "dense"}
"""Edges of the scorers that walk over the graph."""
WALKERS: tuple[ScorerName, ...] = tuple(_EDGES)
"""These scorers."""
