"""How importance is measured; nothing heavy is imported, so that commands can show it at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, Optional, get_args

from momapos.core import InputError

MOST = 10_000
"""Bound of every count, so that a typing error does not run for hours [-]."""
ScorerName = Literal["reach", "deepwalk", "distance", "size", "names"]

WeightsName = Literal["scaled", "printed"]


@dataclass(frozen=True)
class GraphConfig:
    """Which objects of a room are related."""

    contact: float = 0.02
    """Vertical gap or overlap of two surfaces that touch [m]."""
    neighbors: int = 4
    """Nearest objects of each that count as near [-]."""
    near: float = 1.0
    """Farthest gap between the boxes of two objects that are near [m]."""
    floor: float = 0.1
    """Centers closer than this from above count as this far apart [m]."""

    def __post_init__(self) -> None:
        if not (0 < self.contact < math.inf and 0 < self.floor < math.inf):
            raise InputError("contact and floor must be lengths above 0 m")
        if not (self.neighbors >= 0 and self.near >= 0):
            raise InputError("neighbors and near must not be negative")


@dataclass(frozen=True)
class ImportanceConfig:
    """How objects are scored against the target."""

    scorer: Optional[ScorerName] = None  # noqa: UP045 (see cli.options)
    """reach: large for its distance from where the hand goes; deepwalk: the paper's; distance: near
    the target; size: large for its distance from the target; names: by words alone. None: deepwalk
    for the paper's method of placement, else reach."""
    alpha: float = 0.45
    """Objects with a score of at least this are in S, from 0 to 1 [-]."""
    k0: float = 0.5
    """Weight of distance against size in the walks, from 0 to 1 [-]."""
    weights: Optional[WeightsName] = None  # noqa: UP045 (see cli.options)
    """Weights of the walks. printed: k0 / distance + (1 - k0) size in meters, as the paper has it;
    scaled: both terms in (0, 1]. None: printed for the paper's method of placement, else scaled."""
    walks: int = 15
    """Walks that begin at each object [-]."""
    length: int = 20
    """Objects in a walk [-]."""
    window: int = 4
    """Objects before and after in a walk that count as company [-]."""
    dimensions: int = 64
    """Length of an object's vector [-]."""
    epochs: int = 3
    """Passes over the walks [-]."""
    vectors: Optional[str] = None  # noqa: UP045 (see cli.options)
    """File of word vectors for names, as GloVe and word2vec write them as text: a word and its
    numbers a line. None: vectors learnt from the built-in kitchens."""
    graph: GraphConfig = field(default_factory=GraphConfig)

    def __post_init__(self) -> None:
        for name in ("alpha", "k0"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise InputError(f"{name} must be between 0 and 1, not {value:g}")
        for name, least in (
            ("walks", 1), ("length", 2), ("window", 1), ("dimensions", 1), ("epochs", 1),
        ):  # fmt: skip
            value = getattr(self, name)
            if not least <= value <= MOST:
                raise InputError(f"{name} must be between {least} and {MOST}, not {value}")
        if self.weights is not None and self.weights not in get_args(WeightsName):
            raise InputError(
                f"no weights {self.weights!r}; there are {', '.join(get_args(WeightsName))}"
            )
        if self.scorer is not None and self.scorer not in get_args(ScorerName):
            raise InputError(
                f"no scorer {self.scorer!r}; there are {', '.join(get_args(ScorerName))}"
            )
        if self.vectors is not None and self.scorer != "names":
            raise InputError("word vectors are for the scorer names; add --scorer names")
