"""The colors of all figures, safe for color blindness (after Okabe and Ito, and Tol)."""

from __future__ import annotations

from dataclasses import dataclass

INK = "#1d2731"
SOFT_INK = "#5c6873"
FAINT = "#dfe3e6"

FLOOR, FLOOR_EDGE = "#fbfaf8", "#b9b4ab"
FURNITURE, FURNITURE_EDGE = "#e8e5df", "#8f8a81"
TARGET, TARGET_EDGE = "#f5ead1", "#8a6a1f"
WALL = "#b5b0a7"

POTENTIAL = ("#cfe6f7", "#7ab6e0", "#2a7ab8")
"""Low, middle, high."""
PART_BEFORE, PART, PART_EDGE = "#fbe0a6", "#e69f00", "#946000"
WAYPOINT = "#cc3311"
HANDLE = "#aa4499"
ARM = "#2b3a48"
GOOD, BAD = "#008060", "#a5371e"

SELECTED, UNSELECTED, SELECTED_BAR = "#2a7ab8", "#ffffff", "#bcd7ec"
"""Nodes of the scene graph in S and not in S; bars of scores in S."""


@dataclass(frozen=True)
class LineStyle:
    """Style of a line."""

    color: str
    width: float
    dashes: tuple[float, tuple[float, ...]] | str = "-"
    alpha: float = 1.0


RELATIONS = {
    "on": LineStyle("#1d2731", 1.4),
    "in": LineStyle("#d55e00", 1.6, (0, (4, 1.5))),
    "inside": LineStyle("#7a1fa2", 1.8, (0, (1.2, 1.2))),
    "near": LineStyle("#8a96a0", 0.6, "-", 0.65),
}
