"""The colours of all pictures, told apart without red and green (after Okabe and Ito, and Tol)."""

from __future__ import annotations

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
ARM = "#2b3a48"
GOOD, BAD = "#008060", "#a5371e"
