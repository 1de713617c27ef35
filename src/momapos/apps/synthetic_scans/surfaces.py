"""Read the triangles and colors of a model's shapes from its files; draw materials without colors.

A kitchen has one kind of cabinet front and one kind of steel, so the draw is per category and room,
with small differences between objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.spatial import ConvexHull

from momapos.core import UrdfError, read_xml
from momapos.core.geometry import apply
from momapos.model.scene.library import COLORS
from momapos.model.urdf import (
    MAX_URDF_BYTES,
    Geometry,
    Mesh,
    mesh_bytes,
    mesh_triangles,
    parse_mesh,
)

if TYPE_CHECKING:
    from jaxtyping import Float


Paint = tuple[float, float, float] | None
"""sRGB color in [0, 1]; None if no file has one."""
CIRCLE_CORNERS = 48
"""Corners of the polygon for a circle [-]."""
MAX_TRIANGLES = 2_000_000
"""Maximum number of triangles of one mesh file [-]."""
_CORNERS = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T


@dataclass(frozen=True, eq=False)
class SurfacePatch:
    """Triangles of one color."""

    triangles: Float[np.ndarray, "n 3 3"]
    """Corners in the frame of the shape's link [m]."""
    paint: Paint
    closed: bool
    """Whether the triangles enclose a body, counterclockwise seen from outside."""


def patches(shape: Geometry, paint: Paint) -> list[SurfacePatch]:
    """Return the triangles of a shape in the frame of its link, one patch per color.

    Args:
        shape: A box, cylinder, sphere or mesh.
        paint: Color in its URDF, which overrides those of a mesh file.

    Raises:
        UrdfError: The mesh can't be read.
    """
    if shape.kind != "mesh":
        triangles = _primitive(shape)
        return [SurfacePatch(_placed(triangles, shape), paint, closed=True)]
    assert shape.mesh is not None
    found = _mesh(shape.mesh)
    size = np.array(shape.size)
    return [
        SurfacePatch(_placed(triangles * size, shape), paint or own, closed=False)
        for triangles, own in found
        if len(triangles)
    ]


def _placed(triangles: Float[np.ndarray, "n 3 3"], shape: Geometry) -> Float[np.ndarray, "n 3 3"]:
    return apply(shape.T_link_geometry, triangles.reshape(-1, 3)).reshape(-1, 3, 3)


def _primitive(shape: Geometry) -> Float[np.ndarray, "n 3 3"]:
    if shape.kind == "box":
        points = _CORNERS * np.array(shape.size)
    elif shape.kind == "cylinder":
        radius, length = shape.size
        angle = np.linspace(0, 2 * np.pi, CIRCLE_CORNERS, endpoint=False)
        ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
        ends = [
            np.column_stack([ring, np.full(CIRCLE_CORNERS, z)]) for z in (-length / 2, length / 2)
        ]
        points = np.concatenate(ends)
    else:
        import trimesh

        ball = trimesh.creation.icosphere(3, shape.size[0])
        return np.array(ball.vertices)[np.array(ball.faces)]
    hull = ConvexHull(points)
    triangles = points[hull.simplices]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward, ::-1]
    return triangles


# ------------------------------------------------------------------------------------------ meshes


def _mesh(path: Path | Mesh) -> list[tuple[Float[np.ndarray, "_ 3 3"], Paint]]:
    if isinstance(path, Mesh):
        return [(mesh_triangles(path), None)]
    data = mesh_bytes(path)
    if path.suffix.lower() == ".obj":
        found = _obj(path, data.decode("utf-8-sig", errors="replace"))
    else:
        mesh = parse_mesh(path, data)
        try:
            triangles = np.array(mesh.vertices, float)[np.array(mesh.faces, int)]
        except (ValueError, IndexError, AttributeError) as error:
            raise UrdfError(f"{path}: not a usable mesh (it has no valid faces)") from error
        found = [(triangles, None)]
    count = sum(len(triangles) for triangles, _ in found)
    if count > MAX_TRIANGLES:
        raise UrdfError(f"{path}: {count} triangles; the limit is {MAX_TRIANGLES}")
    if not all(np.isfinite(triangles).all() for triangles, _ in found):
        raise UrdfError(f"{path}: the mesh has NaN or infinite vertices")
    return found


def _obj(path: Path, text: str) -> list[tuple[Float[np.ndarray, "_ 3 3"], Paint]]:
    """Read the triangles of an OBJ file by material; textured materials have no paint."""
    points: list[list[float]] = []
    faces: dict[str, list[list[int]]] = {}
    current = faces.setdefault("", [])
    paints: dict[str, Paint] = {}
    try:
        for line in text.splitlines():
            head, _, rest = line.strip().partition(" ")
            if head == "v":
                points.append([float(word) for word in rest.split()[:3]])
            elif head == "f":
                ring = [int(word.split("/", 1)[0]) for word in rest.split()]
                ring = [k - 1 if k > 0 else len(points) + k for k in ring]
                current += [[ring[0], b, c] for b, c in pairwise(ring[1:])]
            elif head == "usemtl":
                current = faces.setdefault(rest.strip(), [])
            elif head == "mtllib":
                paints.update(_mtl(path.parent, rest.strip()))
        vertices = np.array(points, float).reshape(-1, 3)
        index = {name: np.array(rows, int).reshape(-1, 3) for name, rows in faces.items()}
        if any(len(rows) and rows.min() < 0 for rows in index.values()):
            raise ValueError("a face refers to a vertex before the first")
        return [(vertices[rows], paints.get(name)) for name, rows in index.items()]
    except (ValueError, IndexError, OverflowError) as error:
        raise UrdfError(f"{path}: not a usable OBJ mesh ({error})") from error


def _mtl(folder: Path, name: str) -> dict[str, Paint]:
    """Read the diffuse colors of a material file in the folder of its mesh, if it exists."""
    file = folder / Path(name).name
    if not name or not file.is_file() or file.stat().st_size > 1_000_000:
        return {}
    paints: dict[str, Paint] = {}
    textured: set[str] = set()
    current = ""
    for line in file.read_text("utf-8-sig", errors="replace").splitlines():
        head, _, rest = line.strip().partition(" ")
        if head == "newmtl":
            current = rest.strip()
        elif head == "Kd":
            paints[current] = _paint(rest)
        elif head == "map_Kd":
            textured.add(current)
    return {name: paint for name, paint in paints.items() if name not in textured}


def _paint(text: str) -> Paint:
    try:
        r, g, b = (min(max(float(word), 0.0), 1.0) for word in text.split()[:3])
    except ValueError:
        return None
    return r, g, b


# --------------------------------------------------------------------------------- paint of a URDF


def urdf_paints(path: Path | None) -> dict[str, list[Paint]]:
    """Return the colors of the visual shapes of each link, in the file's order.

    The colors of momapos' own kitchens mark the kinds of parts, so they don't count as paint.

    Args:
        path: A URDF that was read before, so that it is valid; None for a box without a file.
    """
    if path is None:
        return {}
    robot: Any = read_xml(path, MAX_URDF_BYTES, error=UrdfError)
    named = {m.get("name"): _rgba(m) for m in robot.iter("material") if m.find("color") is not None}
    return {
        link.get("name"): [
            _material(visual.find("material"), named)
            for visual in link.findall("visual")
            if visual.find("geometry") is not None
        ]
        for link in robot.findall("link")
    }


def _material(element: Any, named: dict[str, Paint]) -> Paint:
    if element is None:
        return None
    own = element.find("color") is not None
    return _rgba(element) if own else named.get(element.get("name"))


def _rgba(material: Any) -> Paint:
    text = material.find("color").get("rgba", "")
    return None if COLORS.get(material.get("name")) == text else _paint(text)


Role = Literal["body", "front", "handle"]
"""Role of a shape in its object: fixed body, moving front, or handle."""
RGB = tuple[float, float, float]


@dataclass(frozen=True)
class Material:
    """Color and grain of a surface."""

    color: RGB
    """sRGB color, in [0, 1]."""
    strength: float = 0.03
    """Relative brightness amplitude of the grain [-]."""
    frequency: RGB = (40.0, 40.0, 40.0)
    """Frequency of the grain along x, y, z [1/m]."""


WOOD = (55.0, 55.0, 3.0)
BOARDS = (2.5, 40.0, 40.0)
FINE = (180.0, 180.0, 180.0)
BRUSHED = (4.0, 4.0, 220.0)

CABINET = (
    Material((0.93, 0.92, 0.90), 0.02),
    Material((0.88, 0.84, 0.74), 0.02),
    Material((0.76, 0.60, 0.42), 0.16, WOOD),
    Material((0.46, 0.31, 0.20), 0.20, WOOD),
    Material((0.60, 0.66, 0.58), 0.03),
    Material((0.30, 0.36, 0.46), 0.04),
    Material((0.66, 0.67, 0.68), 0.03),
)
APPLIANCE = (
    Material((0.72, 0.73, 0.74), 0.05, BRUSHED),
    Material((0.94, 0.94, 0.94), 0.01),
    Material((0.62, 0.63, 0.65), 0.06, BRUSHED),
    Material((0.16, 0.16, 0.17), 0.03),
)
STONE = (
    Material((0.42, 0.42, 0.43), 0.22, FINE),
    Material((0.85, 0.84, 0.82), 0.10, FINE),
    Material((0.22, 0.21, 0.21), 0.25, FINE),
    Material((0.66, 0.58, 0.48), 0.18, FINE),
    Material((0.62, 0.45, 0.29), 0.18, BOARDS),
)
WALL = (
    Material((0.92, 0.91, 0.88), 0.025, (9.0, 9.0, 9.0)),
    Material((0.86, 0.87, 0.84), 0.025, (9.0, 9.0, 9.0)),
    Material((0.84, 0.80, 0.74), 0.025, (9.0, 9.0, 9.0)),
)
FLOOR = (
    Material((0.62, 0.48, 0.35), 0.22, BOARDS),
    Material((0.52, 0.51, 0.50), 0.12, (25.0, 25.0, 25.0)),
    Material((0.70, 0.66, 0.60), 0.10, (25.0, 25.0, 25.0)),
)
BRIGHT = (
    Material((0.80, 0.16, 0.14)),
    Material((0.16, 0.36, 0.72)),
    Material((0.95, 0.75, 0.15)),
    Material((0.20, 0.55, 0.30)),
    Material((0.85, 0.42, 0.14)),
    Material((0.55, 0.22, 0.55)),
)
METAL = (
    Material((0.20, 0.20, 0.21), 0.03),
    Material((0.30, 0.29, 0.28), 0.05),
    Material((0.12, 0.12, 0.12), 0.02),
    Material((0.48, 0.48, 0.49), 0.06),
)
KINDS: tuple[tuple[tuple[str, ...], tuple[Material, ...]], ...] = (
    (("fridge", "oven", "microwave", "dishwasher", "hood", "range", "stove"), APPLIANCE),
    (("counter", "basin"), STONE),
    (("wall",), WALL),
    (("cabinet", "sink", "island", "drawer", "table", "chair", "shelf", "furniture"), CABINET),
)
"""Words in a category, and the materials of such objects; the first match counts."""


class Palette:
    """The materials of one room."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._seed = int(rng.integers(2**63))

    def floor(self) -> Material:
        """Draw the material of the floor."""
        return self._draw(FLOOR, "floor")

    def material(self, name: str, category: str, role: Role, paint: Paint) -> Material:
        """Draw the material of a part.

        Args:
            name: Name of the object.
            category: Category of the object.
            role: Role of the part in the object.
            paint: Color in the object's files; None if they have none.
        """
        kinds = KINDS if category != "wall_cabinet" else KINDS[3:]
        offered = next((m for words, m in kinds if any(w in category for w in words)), None)
        if paint is not None:
            base = Material(paint)
        elif offered is None:
            base = self._draw(BRIGHT, category, name)
        elif role == "handle":
            base = self._draw(METAL, "handle", "" if offered is CABINET else category)
        else:
            # The cabinets of a kitchen have one material; the appliances often differ.
            base = self._draw(offered, "" if offered is CABINET else category)
        shift = self._rng("tint", name).normal(0.0, 0.004, 3)
        shift += self._rng("shade", name, role).normal(0.0, 0.015)
        shade = 0.93 if role == "body" and offered in (CABINET, APPLIANCE) else 1.0
        r, g, b = np.clip(shade * np.array(base.color) + shift, 0.02, 0.98).tolist()
        return Material((r, g, b), base.strength, base.frequency)

    def _draw(self, offered: Sequence[Material], *words: str) -> Material:
        return offered[int(self._rng(*words).integers(len(offered)))]

    def _rng(self, *words: str) -> np.random.Generator:
        """Return a generator seeded by names, so that an added object changes no other."""
        return np.random.default_rng([self._seed, *"\0".join(words).encode()])


def linear(color: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Convert an sRGB color to linear light (gamma 2.2)."""
    return np.asarray(color, float) ** 2.2
