"""Single-mesh furniture for tests: touching boxes as triangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

_CORNERS = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T
_FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lower and upper corner [m]."""

PANEL: Box = ((0.0, -0.02, -0.3), (0.56, 0.0, 0.3))
BAR: Box = ((0.5, -0.07, -0.1), (0.516, -0.054, 0.1))
POSTS: tuple[Box, ...] = (
    ((0.5, -0.054, -0.1), (0.516, -0.02, -0.088)),
    ((0.5, -0.054, 0.088), (0.516, -0.02, 0.1)),
)
DOOR_WITH_BOW = (PANEL, BAR, *POSTS)
"""A door that faces -y; its hinge is the z axis, its handle is on the other side."""
BOW = (BAR, *POSTS)
POCKET: Box = ((-0.06, -0.03, 0.03), (0.06, -0.01, 0.08))
FRONT_WITH_POCKET: tuple[Box, ...] = (
    ((-0.3, -0.01, -0.1), (0.3, 0.0, 0.1)),
    ((-0.3, -0.03, -0.1), (-0.06, -0.01, 0.1)),
    ((0.06, -0.03, -0.1), (0.3, -0.01, 0.1)),
    ((-0.06, -0.03, -0.1), (0.06, -0.01, 0.03)),
    ((-0.06, -0.03, 0.08), (0.06, -0.01, 0.1)),
)
"""A drawer's front that faces -y, with a pocket in it."""
LIP: Box = ((-0.3, -0.045, 0.125), (0.3, -0.035, 0.16))
FRONT_WITH_LIP: tuple[Box, ...] = (
    ((-0.3, -0.02, 0.0), (0.3, 0.0, 0.16)),
    ((-0.3, -0.035, 0.14), (0.3, -0.02, 0.16)),
    LIP,
)
"""A drawer's front that faces -y, with a grip profile on top."""


def triangles_of(boxes: tuple[Box, ...]) -> Float[np.ndarray, "t 3 3"]:
    """Return the surface triangles of boxes."""
    low, high = np.array(boxes).transpose(1, 0, 2)
    corners = low[:, None] + _CORNERS * (high - low)[:, None]
    return corners[:, _FACES].reshape(-1, 3, 3)


def points_on(
    triangles: Float[np.ndarray, "t 3 3"], count: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Sample random points on a surface, the same number on each triangle."""
    weights = rng.dirichlet(np.ones(3), (len(triangles), count))
    return np.einsum("tnk,tki->tni", weights, triangles).reshape(-1, 3)


def points_in(box: Box, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Sample random points in a box."""
    return rng.uniform(*np.array(box), (count, 3))


def write_obj(path: Path, triangles: Float[np.ndarray, "t 3 3"]) -> None:
    """Write triangles as an OBJ file."""
    corners = "".join("v {:.6f} {:.6f} {:.6f}\n".format(*x) for x in triangles.reshape(-1, 3))
    faces = "".join(f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}\n" for k in range(len(triangles)))
    path.write_text(corners + faces)
