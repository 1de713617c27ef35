"""Convert `<link>` elements of a checked URDF to records, scaled to meters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast
from xml.etree.ElementTree import Element

import numpy as np

from momapos.core import UrdfError
from momapos.core.geometry import pose, pose_wxyz

from .urdf_records import Geometry, Link

if TYPE_CHECKING:
    from jaxtyping import Float

SHAPES = {
    "box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",),
    "capsule": ("radius", "length"), "mesh": ("filename",),
}  # fmt: skip
"""Shapes of a URDF and their required attributes."""
MAX_MASS = 1e6
"""Largest mass of a link [kg]."""
_NO_ORIGIN = Element("origin")


def numbers(element: Element, key: str, default: str = "") -> list[float]:
    """Return the numbers of an attribute; commas count as spaces."""
    return [float(word) for word in element.get(key, default).replace(",", " ").split()]


def origin_pose(element: Element | None, scale: float = 1.0) -> Float[np.ndarray, "4 4"]:
    """Return the pose of an `<origin>`, by `rpy` or, from URDF 1.1 on, by `quat_xyzw`.

    Args:
        element: The element; None for the identity.
        scale: Factor of its translation [-].
    """
    origin = _NO_ORIGIN if element is None else element
    xyz = np.array(numbers(origin, "xyz", "0 0 0")) + 0.0  # without negative zeros
    if origin.get("quat_xyzw") is not None:
        x, y, z, w = numbers(origin, "quat_xyzw")
        T = pose_wxyz(tuple(xyz), (w, x, y, z))
    else:
        T = pose(xyz, _rotation(*numbers(origin, "rpy", "0 0 0")))
    T[:3, 3] *= scale
    return T


def _rotation(roll: float, pitch: float, yaw: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of roll, pitch and yaw about fixed axes [rad].

    Products of sines and cosines, not of quaternions as in `pose_rpy`: quarter turns, which most
    angles of URDFs are, keep the digits that other URDF readers give them.
    """
    (si, sj, sk), (ci, cj, ck) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    R = np.array([
        [cj * ck, sj * (si * ck) - ci * sk, sj * (ci * ck) + si * sk],
        [cj * sk, sj * (si * sk) + ci * ck, sj * (ci * sk) - si * ck],
        [-sj, cj * si, cj * ci],
    ])  # fmt: skip
    return R + 0.0


def capsule_shapes(
    radius: float, length: float, T: Float[np.ndarray, "4 4"], name: str = ""
) -> list[Geometry]:
    """Return a capsule along z as a cylinder and two balls, which is exact.

    Args:
        radius: Radius [m].
        length: Length of the straight part [m]; a capsule without one is a ball.
        T: Pose of the capsule.
        name: Name of all shapes.
    """
    if length == 0.0:
        return [Geometry("sphere", (radius,), T, name)]
    ends = (pose(np.array([0.0, 0.0, z])) for z in (length / 2, -length / 2))
    balls = [Geometry("sphere", (radius,), T @ end, name) for end in ends]
    return [Geometry("cylinder", (radius, length), T, name), *balls]


class LinkReader:
    """Converts `<link>` elements to records, and collects the names of their meshes in order."""

    def __init__(self, path: Path, scale: float) -> None:
        self.path, self.scale = path, scale
        self.meshes: list[str] = []

    def link(self, element: Element) -> Link:
        """Return the record of a link.

        Raises:
            UrdfError: Its mass, or the size of a shape, is unusable.
        """
        name = element.get("name", "")
        shapes = [
            tuple(s for part in element.findall(tag) for s in self._shapes(name, part))
            for tag in ("collision", "visual")
        ]
        return Link(name, shapes[0], shapes[1], *self._inertial(name, element))

    def _shapes(self, link: str, part: Element) -> Sequence[Geometry]:
        """Return the shapes of a `<collision>` or `<visual>`: one, or those of a capsule."""
        shape = cast("Element", part.find("geometry"))[0]
        T, s = origin_pose(part.find("origin"), self.scale), self.scale
        name, kind = part.get("name", ""), shape.tag
        if kind == "mesh":
            self.meshes.append(shape.get("filename", ""))
            size = s * np.broadcast_to(numbers(shape, "scale", "1"), 3)
        else:
            size = s * np.array([v for key in SHAPES[kind] for v in numbers(shape, key)])
        sizes = np.abs(size)
        if not (np.isfinite(sizes).all() and (sizes[:1] if kind == "capsule" else sizes).min() > 0):
            raise UrdfError(f"{self.path}: a {kind} of link {link!r} has size {tuple(size)}")
        if kind == "capsule":
            return capsule_shapes(float(size[0]), float(size[1]), T, name)
        return [Geometry(kind, tuple(size), T, name)]  # type: ignore[arg-type]

    def _inertial(
        self, name: str, link: Element
    ) -> tuple[float, tuple[float, float, float]] | tuple[()]:
        """Return mass [kg] and center of mass [m]; nothing without a mass > 0."""
        mass = link.find("inertial/mass")
        text = None if mass is None else mass.get("value")
        if text is None:
            return ()
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not abs(value) <= MAX_MASS:
            raise UrdfError(
                f"{self.path}: link {name!r}: value={text!r:.80} in <mass> must be a finite number "
                f"of at most {MAX_MASS:g}"
            )
        x, y, z = origin_pose(link.find("inertial/origin"), self.scale)[:3, 3].tolist()
        return (value, (x, y, z)) if value > 0 else ()
