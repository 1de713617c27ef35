"""Configuration of the classical segmenter."""

from __future__ import annotations

BACK_THICKNESS = 0.2
"""Maximum thickness of a back, including its inclination [m]."""
MIN_SMALL_POINTS = 14
"""The same for objects on a surface [-]."""
MAX_OVERHANG = 0.09
"""Fronts and handles protrude by up to this from under a top or from a front [m]."""
SEAT = (0.6, 0.35)
"""Tops lower [m] and smaller [m2] than this are seats, and objects on them are backs."""
MIN_SLAB_LENGTH = 1.2
"""Tops at least this long are countertops across several pieces of furniture [m]."""
TOUCHING = 0.05
"""Furniture closer than this is one piece, unless planes divide it [m]."""
TOUCHING_SMALL = 0.025
"""The same for objects on a surface [m]; less in a cloud whose points are closer."""
SPACING_PERCENT = 95.0
"""Share of points that are this close: meshes have few points on planes and many at edges [%]."""
MIN_POINTS = 25
"""Smaller groups of points are noise [-]."""
MAX_OBJECT_HEIGHT = 0.5
"""Maximum height of objects on a surface [m]; cabinets hang above it."""
MIN_LIFT = 0.015
"""Points this far above a surface do not belong to it [m]."""
MAX_LIP = 0.07
"""Fronts end at most this far below their top [m]."""
SLAB_THICKNESS = 0.04
"""Thickness of a countertop [m]. It is an object of its own."""
MIN_CLOSED = 0.45
"""Furniture is open, like a table, if surfaces cover less than this share of each side [-]."""
MAX_OPEN_FLOOR = 0.1
"""A corner is empty if the floor is seen on more than this share of it [-]."""
MIN_TALL_TOP = 1.2
"""Tops above this are hardly visible: fronts define such furniture [m]."""
MIN_WALL_PROTRUSION = 0.08
"""Objects that protrude less from a wall belong to it [m]."""
MIN_CORNER = 0.35
"""A row is divided where its front ends this far from its own end: the rest is a corner behind
other furniture [m]."""
MAX_BACK_HEIGHT = 0.7
"""Maximum height of a back above its seat [m]."""
MAX_SHELF_DEPTH = 0.4
"""Open furniture at a wall that is less deep is a shelf, not a table [m]."""
