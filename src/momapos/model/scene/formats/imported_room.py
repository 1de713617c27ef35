"""A room imported from another format, and what the readers of the formats share."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import FileFormatError, resolved, shown, unknown_name
from momapos.core.geometry import pose, pose_wxyz
from momapos.model.urdf import Geometry, Mesh, Urdf

if TYPE_CHECKING:
    from jaxtyping import Float


DECIMALS = 6
"""Decimals of the vertices of a written mesh [m]."""


@dataclass(frozen=True, eq=False)
class RoomObject:
    """An object of an imported room."""

    name: str
    T_world_object: Float[np.ndarray, "4 4"]
    urdf: Urdf
    """Its links and joints; mesh shapes name keys of the room's `meshes`."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """Values of joints that are not at rest [rad] or [m]."""
    extras: Mapping[str, Any] = field(default_factory=dict)
    """Further members of its entry in a momapos scene, such as the category."""


@dataclass(frozen=True)
class ImportReport:
    """Counts of what was kept, approximated and dropped in the conversion."""

    kept: Counter[str] = field(default_factory=Counter)
    approximated: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    """Further remarks."""

    def lines(self) -> list[str]:
        """Return the report as text, one line for each nonempty part."""
        parts = (
            ("kept", self.kept), ("approximated", self.approximated), ("dropped", self.dropped)
        )  # fmt: skip
        lines = [
            f"{word}: {', '.join(f'{count} {what}' for what, count in found.items() if count)}"
            for word, found in parts
            if found.total()
        ]
        return [*lines, *(f"note: {text}" for text in self.notes)]

    def as_json(self) -> dict[str, Any]:
        """Return the report as plain values."""
        return {
            "kept": dict(self.kept),
            "approximated": dict(self.approximated),
            "dropped": dict(self.dropped),
            "notes": list(self.notes),
        }


@dataclass(frozen=True, eq=False)
class ImportedRoom:
    """A room imported from another format."""

    name: str
    objects: tuple[RoomObject, ...]
    meshes: Mapping[Path, Mesh]
    report: ImportReport
    extras: Mapping[str, Any] = field(default_factory=dict)
    """Further members of a momapos scene: `floor`, `start`, `areas`."""

    def without(self, names: Collection[str]) -> ImportedRoom:
        """Return the room without some objects.

        Raises:
            UnknownNameError: An object does not exist; the message suggests similar names.
        """
        known = [item.name for item in self.objects]
        for name in names:
            if name not in known:
                raise unknown_name("object", name, known, f"room {self.name}")
        if names:
            self.report.dropped["objects, as requested"] += len(set(names))
        return replace(self, objects=tuple(o for o in self.objects if o.name not in names))

    def final_report(self) -> ImportReport:
        """Return the report, including the present content of the room as kept."""
        joints = [joint for item in self.objects for joint in item.urdf.joints if joint.movable]
        links = [link for item in self.objects for link in item.urdf.links.values()]
        slides = sum(joint.kind == "prismatic" for joint in joints)
        kept = Counter({
            "objects": len(self.objects),
            "hinges": len(joints) - slides,
            "slides": slides,
            "mimic joints": sum(joint.mimic is not None for joint in joints),
            "collision shapes": sum(len(link.collisions) for link in links),
            "visual shapes": sum(len(link.visuals) for link in links),
        })  # fmt: skip
        return replace(self.report, kept=kept + self.report.kept)


class Names:
    """Makes valid and unique names for our files."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    def __call__(self, wanted: str, otherwise: str) -> str:
        """Return a printable name without `/`, as similar to the wanted one as possible."""
        text = "".join(c if c.isprintable() and c != "/" else "_" for c in wanted.strip())[:200]
        name = text = text or otherwise
        number = 1
        while name in self._used:
            number += 1
            name = f"{text}_{number}"
        self._used.add(name)
        return name


MIN_FLOOR_NORMAL_Z = 0.999
"""Minimum z of a unit normal for a plane to be a floor [-]."""
PLANE_THICKNESS = 0.02
"""Thickness of the box that replaces a bounded plane [m]."""
_BALL_RINGS = 12
"""Number of rings of the ball mesh [-]."""


def plane(x: float, y: float, T: Float[np.ndarray, "4 4"], name: str = "") -> Geometry:
    """Return a box behind a bounded plane with normal z.

    Args:
        x: Edge along x [m].
        y: Edge along y [m].
        T: Pose of the plane.
        name: Name of the shape.
    """
    return Geometry(
        "box", (x, y, PLANE_THICKNESS), T @ pose(np.array([0.0, 0.0, -PLANE_THICKNESS / 2])), name
    )


def ellipsoid(
    half: tuple[float, float, float], T: Float[np.ndarray, "4 4"], name: str = ""
) -> tuple[Geometry, Path, Mesh]:
    """Return an ellipsoid as a scaled ball mesh, with the file name and content of that mesh.

    Args:
        half: Half axes [m].
        T: Pose of the ellipsoid.
        name: Name of the shape.
    """
    file = Path("ball.obj")
    return Geometry("mesh", half, T, name, file), file, _ball()


def prism(
    polygon: Float[np.ndarray, "k 2"], height: float, error: Callable[[str], FileFormatError]
) -> Mesh:
    """Return the convex hull of an extruded polygon as a mesh, with z from -height/2 to height/2.

    Args:
        polygon: Its corners [m].
        height: Its extent along z [m].
        error: Makes the error for a polygon that encloses no area.
    """
    from scipy.spatial import QhullError

    ends = [np.pad(polygon, ((0, 0), (0, 1)), constant_values=z) for z in (-height / 2, height / 2)]
    try:
        return _hull_mesh(np.concatenate(ends))[0]
    except QhullError as reason:
        raise error("the polygon of a prism encloses no area") from reason


def _hull_mesh(points: Float[np.ndarray, "n 3"]) -> tuple[Mesh, Float[np.ndarray, " f"]]:
    """Return the convex hull as a mesh that is counterclockwise seen from outside, and the
    distances of its faces from the origin [m]."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    normals, faces = hull.equations[:, :3], hull.simplices.astype(np.int64)
    a0, b0, c0 = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("fi,fi->f", np.cross(b0 - a0, c0 - a0), normals) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(points, faces), -hull.equations[:, 3]


def _ball() -> Mesh:
    polar = np.linspace(0.0, np.pi, _BALL_RINGS + 1)[1:-1]
    around = np.linspace(0.0, 2 * np.pi, 2 * _BALL_RINGS, endpoint=False)
    p, a = (grid.ravel() for grid in np.meshgrid(polar, around, indexing="ij"))
    rings = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=1)
    points = np.vstack([rings, [[0, 0, 1], [0, 0, -1]]])
    mesh, away = _hull_mesh(points)
    return Mesh(points / np.abs(away).min(), mesh.faces)


def find_inside(name: str, places: Sequence[Path], root: Path, source: Path) -> Path:
    """Return the first of some places that is a file inside the root.

    Args:
        name: Name in the source, for messages.
        places: Possible paths.
        root: Folder that must contain the file after resolving links.
        source: File that contains the name.

    Raises:
        FileFormatError: The file is outside the root, is missing, or has an invalid name.
    """
    try:
        inside = [place for place in map(resolved, places) if place.is_relative_to(root)]
        found = next((place for place in inside if place.is_file()), None)
    except (FileFormatError, OSError) as error:  # too long, cyclic links, a NUL
        raise FileFormatError(f"{source}: {name!r:.80} is not a valid path") from error
    if found is not None:
        return found
    if not inside:
        raise FileFormatError(
            f"{source}: {name!r:.200} leaves {root}; if you trust the file, set root to a folder "
            "that contains both"
        )
    raise FileFormatError(f"{source}: {name!r:.200} does not exist below {root}")


MAX_NUMBER = 1e6
"""Maximum magnitude of a number [-]."""
MAX_LIST = 1_000_000
"""Maximum length of a list [-]."""


class Message:
    """The fields of a message; each error names the field."""

    def __init__(self, value: Any, where: str) -> None:
        if not isinstance(value, dict):
            raise FileFormatError(f"{where} must be a mapping, not {shown(value)}")
        self.value, self.where = value, where

    def __contains__(self, key: str) -> bool:
        return self.value.get(key) is not None

    def error(self, text: str) -> FileFormatError:
        """Return an error about this message."""
        return FileFormatError(f"{self.where}: {text}")

    def part(self, key: str) -> Message:
        """Return a message in a field; an empty one if the field is missing."""
        value = self.value.get(key)
        return Message({} if value is None else value, f"{self.where}: {key}")

    def values(self, key: str) -> list[Any]:
        """Return the list in a field; an empty one if the field is missing."""
        value = self.value.get(key)
        value = [] if value is None else value
        if not isinstance(value, list) or len(value) > MAX_LIST:
            raise self.error(f"{key} must be a list, not {shown(value)}")
        return value

    def parts(self, key: str) -> Iterator[Message]:
        """Yield the messages in a list."""
        for number, value in enumerate(self.values(key)):
            yield Message(value, f"{self.where}: {key} {number}")

    def text(self, key: str) -> str:
        """Return the text in a field; "" if it is missing."""
        value = self.value.get(key)
        if value is None:
            return ""
        if isinstance(value, list | dict):
            raise self.error(f"{key} must be text, not {shown(value)}")
        return str(value)[:1000]

    def numbers(self, key: str, count: int | None, names: str = "") -> Float[np.ndarray, " n"]:
        """Return numbers in a field.

        Args:
            key: The field, which must exist.
            count: How many there must be; None for any number.
            names: Letters of the fields, if the numbers may also be a message, such as "xyz".
        """
        return as_numbers(self.value.get(key), count, f"{self.where}: {key}", names)

    def pose(self, first: str = "position", then: str = "orientation") -> Float[np.ndarray, "4 4"]:
        """Return the pose that this message is.

        A missing part or a quaternion of zeros means none, as in MoveIt.
        """
        xyz = self.numbers(first, 3, "xyz") if first in self else np.zeros(3)
        x, y, z, w = self.numbers(then, 4, "xyzw") if then in self else np.zeros(4)
        length = math.hypot(x, y, z, w)
        if length == 0:
            w = length = 1.0
        if not 0.9 < length < 1.1:
            raise self.error(f"{then} has length {length:g}; it must be 1")
        return pose_wxyz(tuple(xyz.tolist()), (w, x, y, z))


def as_numbers(value: Any, count: int | None, where: str, names: str = "") -> np.ndarray:
    """Return a list or a message of finite numbers.

    Raises:
        FileFormatError: It has others, or another number of them.
    """
    if isinstance(value, dict) and set(value) <= set(names):
        value = [value.get(name, 0.0) for name in names]
    rows = value if isinstance(value, list) and len(value) <= MAX_LIST else [None]
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in rows)
    array = np.array(rows, float) if numeric else np.full(1, np.nan)
    if (count not in (None, len(rows))) or not (np.abs(array) <= MAX_NUMBER).all():
        wanted = "finite numbers" if count is None else f"{count} finite numbers"
        raise FileFormatError(f"{where} must be {wanted}, not {shown(value)}")
    return array
