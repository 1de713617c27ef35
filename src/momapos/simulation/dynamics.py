"""Masses, inertias and effort limits of a robot, from its URDF."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import UrdfError, read_xml
from momapos.model.urdf import MAX_URDF_BYTES, Geometry, Hull, Mimic, hull_of, origin_pose

if TYPE_CHECKING:
    from jaxtyping import Float

_MATRIX = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass and inertia of a link."""

    mass: float
    """[kg]"""
    T_link_inertia: Float[np.ndarray, "4 4"]
    """Frame of `matrix`; its origin is the center of mass."""
    matrix: tuple[float, float, float, float, float, float]
    """xx, yy, zz, xy, xz, yz [kg m^2]."""


@dataclass(frozen=True)
class Dynamics:
    """Masses, effort limits and mimic joints of a URDF."""

    inertias: Mapping[str, Inertia]
    """By link; links without a mass are left out."""
    efforts: Mapping[str, float]
    """Maximum torque or force by joint [Nm] or [N]; joints without a limit are left out."""
    mimics: Mapping[str, Mimic]
    """By the name of the following joint."""


def read_dynamics(path: Path) -> Dynamics:
    """Read the inertial data of a URDF that `read_urdf` has accepted.

    Raises:
        UrdfError: A mass, inertia, mimic or effort value is invalid.
    """
    root: Any = read_xml(path, MAX_URDF_BYTES, error=UrdfError)
    inertias = {}
    for link in root.iter("link"):
        inertial = link.find("inertial")
        if inertial is not None and inertial.find("mass") is not None:
            inertias[link.get("name")] = _inertia(inertial, f"{path}: link {link.get('name')!r}")
    efforts, mimics = {}, {}
    for joint in root.iter("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and mimic.get("joint"):
            where = f"{path}: joint {joint.get('name')!r}: mimic"
            factor = _number(mimic.get("multiplier", "1"), where)
            offset = _number(mimic.get("offset", "0"), where)
            mimics[joint.get("name")] = Mimic(mimic.get("joint"), factor, offset)
        limit = joint.find("limit")
        effort = 0.0 if limit is None else float(limit.get("effort", "0").replace(",", " "))
        if 0 < effort < math.inf:
            efforts[joint.get("name")] = effort
    return Dynamics(inertias, efforts, mimics)


def _inertia(element: Any, where: str) -> Inertia:
    mass = _number(element.find("mass").get("value"), f"{where}: mass")
    if mass < 0:
        raise UrdfError(f"{where}: mass {mass:g} is negative")
    origin, matrix = element.find("origin"), element.find("inertia")
    values = [
        _number("0" if matrix is None else matrix.get(key, "0"), f"{where}: {key}")
        for key in _MATRIX
    ]
    return Inertia(mass, origin_pose(origin), tuple(values))  # type: ignore[arg-type]


def _number(text: str | None, where: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or abs(value) > 1e6:
        raise UrdfError(f"{where} {text!r:.80} must be a finite number of magnitude at most 1e6")
    return value


def volume(shape: Geometry) -> float:
    """Return the volume of a shape [m^3]; for a mesh, of its convex hull."""
    if shape.kind == "box":
        return float(np.prod(shape.size))
    if shape.kind == "cylinder":
        return math.pi * shape.size[0] ** 2 * shape.size[1]
    if shape.kind == "sphere":
        return 4 / 3 * math.pi * shape.size[0] ** 3
    return hull_volume(hull_of(shape))


def hull_volume(hull: Hull) -> float:
    """Return the volume of a convex hull [m^3]."""
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", np.cross(a, b), c)) / 6
