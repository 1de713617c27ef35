"""Units and the up axis of COLLADA meshes."""

from __future__ import annotations

import contextlib
import io
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import ParseError

import numpy as np

from momapos.core import UrdfError

from .urdf_tree import MAX_SIZE

if TYPE_CHECKING:
    from jaxtyping import Float

ROTATIONS = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""Rotations that turn an up axis to z (COLLADA 1.4.1, up_axis)."""


def meters_per_unit(root: Any) -> float:
    """Return the length of a unit of a COLLADA file [m]; 1 if it gives none.

    Raises:
        UrdfError: The length is not a usable number.
    """
    unit = root.find("{*}asset/{*}unit")
    text = "1" if unit is None else unit.get("meter", "1")
    try:
        meters = float(text)
    except ValueError:
        meters = math.nan
    if not 1 / MAX_SIZE <= meters <= MAX_SIZE:
        raise UrdfError(
            f"<unit meter={text!r:.40}> must be a number from {1 / MAX_SIZE:g} to {MAX_SIZE:g}"
        )
    return meters


def up_axis(path: Path, data: bytes) -> str:
    """Return the up axis of a COLLADA file: X_UP, Y_UP or Z_UP; Z_UP if it gives none.

    The format's default is Y_UP, but URDF tools write files without it whose z is up.
    """
    if path.suffix.lower() != ".dae":
        return "Z_UP"
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import iterparse

    # A damaged file is reported where its mesh is read.
    with contextlib.suppress(ParseError, DefusedXmlException, UnicodeDecodeError, LookupError):
        for _, element in iterparse(io.BytesIO(data), forbid_dtd=True):
            name = str(element.tag).rpartition("}")[2]
            if name == "up_axis" and (element.text or "").strip() in ROTATIONS:
                return (element.text or "").strip()
            if name == "asset":
                break
    return "Z_UP"


def turned_up(
    T_link_geometry: Float[np.ndarray, "4 4"], scale: tuple[float, ...], axis: str
) -> tuple[Float[np.ndarray, "4 4"], tuple[float, ...]]:
    """Return pose and scale of a mesh as if its file were turned so that z is up.

    The rotation permutes the axes, and with them the scale.
    """
    R = ROTATIONS[axis]
    T = np.eye(4)
    T[:3, :3] = R
    x, y, z = np.abs(R).T @ np.array(scale)
    return T_link_geometry @ T, (float(x), float(y), float(z))
