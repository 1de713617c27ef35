"""The colours of all pictures, told apart without red and green (after Okabe and Ito, and Tol)."""

from __future__ import annotations

INK = "#1d2731"
SOFT_INK = "#5c6873"
FAINT = "#dfe3e6"

FLOOR, FLOOR_EDGE = "#fbfaf8", "#b9b4ab"
FURNITURE, FURNITURE_EDGE = "#e8e5df", "#8f8a81"
TARGET, TARGET_EDGE = "#f3e3bd", "#8a6a1f"
WALL = "#b5b0a7"

POTENTIAL = ("#d6e9f8", "#7fb8e0", "#1f6fb0")
"""Low, middle, high."""
PART, PART_EDGE = "#e69f00", "#a36a00"
WAYPOINT = "#cc3311"
ARM = "#2b3a48"
GOOD, BAD = "#008060", "#a5371e"
