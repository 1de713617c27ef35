"""Furniture of boxes for tests: a carcass that is open to -x, with parts of any kind in front."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from momapos.model.scene.scene import Scene, SceneObject

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Edge lengths and center of a box in its link's frame [m]."""


def link(name: str, *boxes: Box, handle: Box | None = None, handle_name: str = "handle") -> str:
    """Return a link of boxes; the handle's shape has a name of its own."""
    shapes = [*((box, "") for box in boxes), *([(handle, handle_name)] if handle else [])]
    elements = "".join(
        f'<collision name="{text}"><origin xyz="{x} {y} {z}"/>'
        f'<geometry><box size="{a} {b} {c}"/></geometry></collision>'
        for ((a, b, c), (x, y, z)), text in shapes
    )
    return f'<link name="{name}">{elements}</link>'


def joint(
    name: str,
    kind: str,
    ends: tuple[str, str],
    xyz: tuple[float, float, float],
    axis: tuple[float, float, float],
    limits: tuple[float, float],
    mimic: str = "",
) -> str:
    """Return a joint; `mimic` holds the attributes of a <mimic> element."""
    follows = f"<mimic {mimic}/>" if mimic else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{ends[0]}"/><child link="{ends[1]}"/>'
        f'<origin xyz="{xyz[0]} {xyz[1]} {xyz[2]}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
        f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="9" velocity="1"/>{follows}</joint>'
    )


def carcass(width: float = 0.6, height: float = 0.9, depth: float = 0.5) -> str:
    """Return the link `body`: a box without a front, its middle above the origin."""
    x, y, t = depth / 2, width / 2, 0.02
    return link(
        "body",
        ((t, width, height), (x - t / 2, 0.0, height / 2)),
        ((depth, t, height), (0.0, y - t / 2, height / 2)),
        ((depth, t, height), (0.0, t / 2 - y, height / 2)),
        ((depth, width, t), (0.0, 0.0, t / 2)),
        ((depth, width, t), (0.0, 0.0, height - t / 2)),
    )


def furniture_room(folder: Path, parts: Sequence[str], name: str = "cupboard") -> Scene:
    """Write furniture into a folder, and return a room in which it stands at x = 0.8 m."""
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="{name}">{"".join(parts)}</robot>')
    item = SceneObject.from_urdf(name, path, (0.8, 0.0, 0.0), category="cabinet")
    return Scene(name, (item,), start=np.array([-1.5, 0.0, 0.0]))
