"""Single-mesh furniture for tests: touching boxes as triangles."""

from __future__ import annotations

from itertools import pairwise
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


def table(leg: float = 0.05) -> tuple[Box, ...]:
    """Return a table with four legs and a top of 1.2 x 0.8 m, 0.7 m high."""
    corners = [(x, y) for x in (-0.6, 0.6 - leg) for y in (-0.4, 0.4 - leg)]
    legs: list[Box] = [((x, y, 0.0), (x + leg, y + leg, 0.66)) for x, y in corners]
    return (*legs, ((-0.6, -0.4, 0.66), (0.6, 0.4, 0.7)))


SHELVES: tuple[Box, ...] = (
    ((-0.2, -0.4, 0.0), (0.2, -0.38, 1.2)),
    ((-0.2, 0.38, 0.0), (0.2, 0.4, 1.2)),
    ((0.18, -0.38, 0.0), (0.2, 0.38, 1.2)),
    *(((-0.2, -0.38, z), (0.18, 0.38, z + 0.02)) for z in (0.0, 0.58, 1.18)),
)
"""A bookcase that is open to -x, with three shelves."""


def prism(radius: float, height: float, corners: int = 40) -> Float[np.ndarray, "t 3 3"]:
    """Return the triangles of an upright prism that stands on the origin."""
    import trimesh

    body = trimesh.creation.cylinder(radius, height, sections=corners)
    return np.array(body.triangles) + np.array([0.0, 0.0, height / 2])


def collada(triangles: Float[np.ndarray, "t 3 3"], asset: str = "") -> str:
    """Return triangles as a COLLADA file, with the content of its `asset` element."""
    points = triangles.reshape(-1, 3)
    numbers, order = " ".join(f"{v:.9g}" for v in points.ravel()), range(len(points))
    params = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f'<asset>{asset}</asset><library_geometries><geometry id="g"><mesh><source id="s">'
        f'<float_array id="a" count="{points.size}">{numbers}</float_array><technique_common>'
        f'<accessor source="#a" count="{len(points)}" stride="3">{params}</accessor>'
        '</technique_common></source><vertices id="v"><input semantic="POSITION" source="#s"/>'
        f'</vertices><triangles count="{len(triangles)}"><input semantic="VERTEX" source="#v" '
        f'offset="0"/><p>{" ".join(map(str, order))}</p></triangles></mesh></geometry>'
        '</library_geometries><library_visual_scenes><visual_scene id="vs"><node id="n">'
        '<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#vs"/></scene></COLLADA>'
    )


def arch(height: float = 0.05, length: float = 0.2, radius: float = 0.007) -> np.ndarray:
    """Return the triangles of a round bow along x that stands out of y = -0.02 toward -y."""
    import trimesh

    angle = np.linspace(0.0, np.pi, 25)
    x, y = length / 2 * np.cos(angle), -0.02 - height * np.sin(angle)
    path = np.stack([x, y, np.zeros_like(x)], axis=1)
    tubes = [
        trimesh.creation.cylinder(radius, segment=ends, sections=10) for ends in pairwise(path)
    ]
    return np.concatenate([np.array(tube.triangles) for tube in tubes])
