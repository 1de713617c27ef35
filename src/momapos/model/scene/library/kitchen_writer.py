"""Write kitchens made of boxes: a URDF per piece, and the scene file."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import InputError, temporary_folder
from momapos.model.records import Confidence, Hypothesis
from momapos.model.scene.confidence import confidence_to_json
from momapos.model.scene.hypotheses import hypotheses_to_json
from momapos.model.scene.model_copies import copy_files
from momapos.model.scene.scene_object import SceneObject

from .box_furniture import Box, FurniturePart, Piece, Vec, centers_and_halves, vec

COPIED_SUFFIX = ".model"
"""Suffix of a folder with the files of an object with its own URDF."""
DENSITY = 400.0  # density of all parts: light wood [kg/m^3]
COLORS = {
    "body": "0.85 0.83 0.78 1",
    "front": "0.55 0.65 0.72 1",
    "handle": "0.2 0.2 0.22 1",
}


def write_kitchen(
    out: Path,
    name: str,
    pieces: Sequence[Piece],
    floor: Sequence[tuple[float, float]] | None,
    start: tuple[float, float, float] | None,
    others: Sequence[SceneObject] = (),
    sure: Mapping[str, tuple[float, float]] | None = None,
) -> Path:
    """Write a scene and its URDF files: all files, or none.

    Args:
        out: The scene file; the URDF files are written to `<stem>_urdf` next to it.
        name: Name of the scene.
        pieces: The furniture; a single box needs no URDF.
        floor: Corners of the floor in the world, counterclockwise [m]; None if unbounded.
        start: Initial pose of the base: x [m], y [m], yaw [rad]; None if unknown.
        others: Objects with their own URDF files, which are copied with their meshes.
        sure: Confidences of a scan in objects and in their labels, by name.

    Returns:
        `out`.

    Raises:
        InputError: The files cannot be written, or the URDF folder contains other files.
    """
    folder = out.parent / f"{out.stem}_urdf"
    foreign = [
        path.name for path in folder.glob("*") if path.suffix not in (".urdf", COPIED_SUFFIX)
    ]
    if foreign:
        raise InputError(f"{folder} is not a folder of URDF files: it contains {foreign[0]}")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(out.parent, out.stem) as temporary:
            new = temporary / "new"
            new.mkdir()
            for piece in pieces:
                if not is_single_box(piece):
                    text = urdf_text(piece)
                    (new / f"{piece.name}.urdf").write_text(text, encoding="utf-8")
            entries = [_object(piece, folder.name) for piece in pieces]
            for item in others:
                target = new / f"{item.name}{COPIED_SUFFIX}"
                source = item.model.urdf.path
                assert source is not None
                urdf = copy_files([item.model], target)[source].relative_to(new)
                entries.append(_copied(item, f"{folder.name}/{urdf.as_posix()}"))
            for entry in entries:
                if sure is not None and entry["name"] in sure:
                    own = next((piece for piece in pieces if piece.name == entry["name"]), None)
                    found = confidence_of(*sure[entry["name"]], own)
                    entry["confidence"] = confidence_to_json(found)
            scene = temporary / "scene.json"
            text = scene_text(name, entries, floor, start)
            scene.write_text(text, encoding="utf-8")
            _swap_in(new, folder, scene, out)
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror or error}") from error
    return out


def _swap_in(new: Path, folder: Path, scene: Path, out: Path) -> None:
    """Move a new folder and scene file to their places; restore the old ones on failure."""
    old = new.with_name("old")
    if folder.exists():
        folder.rename(old)
    try:
        new.rename(folder)
        scene.replace(out)
    except OSError:
        if folder.exists():
            shutil.rmtree(folder)
        if old.exists():
            old.rename(folder)
        raise


def is_single_box(piece: Piece) -> bool:
    """Return whether the scene file can contain the piece without a URDF."""
    return len(piece.parts) == 1 and len(piece.parts[0].boxes) == 1


def scene_text(
    name: str,
    entries: Sequence[Mapping[str, Any]],
    floor: Sequence[tuple[float, float]] | None,
    start: tuple[float, float, float] | None,
) -> str:
    """Return the text of a scene file, one object per line; see `write_kitchen`."""
    text = json.dumps({"format": "momapos-scene", "version": 1, "name": name})[:-1]
    if floor is not None:
        corners = [[round(float(value), 5) + 0.0 for value in corner] for corner in floor]
        text += f',\n "floor": {json.dumps(corners)}'
    if start is not None:
        x, y, yaw = vec(start)
        text += f',\n "start": {json.dumps({"x": x, "y": y, "yaw": yaw})}'
    objects = ",\n".join(f"  {json.dumps(entry)}" for entry in entries)
    return f'{text},\n "objects": [\n{objects}\n ]}}\n'


def _copied(item: SceneObject, urdf: str) -> dict[str, Any]:
    wxyz = Rotation.from_matrix(item.T_world_object[:3, :3]).as_quat(scalar_first=True)
    xyz = vec(item.T_world_object[:3, 3])
    return {
        "name": item.name,
        "category": item.category,
        "pose": {"xyz": xyz, "wxyz": (np.round(wxyz, 9) + 0.0).tolist()},
        "urdf": urdf,
        "scale": item.model.urdf.scale,
        "joints": dict(item.joints),
    }


def _object(piece: Piece, folder: str) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": piece.name, "category": piece.category}
    xyz = np.array(piece.xyz)
    box = piece.parts[0].boxes[0]
    if is_single_box(piece):
        (center,), (half,) = centers_and_halves((box,))
        c, s = np.cos(piece.yaw), np.sin(piece.yaw)
        xyz += [c * center[0] - s * center[1], s * center[0] + c * center[1], center[2]]
    wxyz = [round(float(f(piece.yaw / 2)), 9) + 0.0 for f in (np.cos, np.sin)]
    entry["pose"] = {"xyz": vec(xyz), "wxyz": [wxyz[0], 0.0, 0.0, wxyz[1]]}
    if is_single_box(piece):
        return {**entry, "box": vec(2 * half)}
    joints = {
        joint_name(part): round(part.value, 5) for part in piece.parts if part.motion is not None
    }
    entry |= {"urdf": f"{folder}/{piece.name}.urdf", "scale": 1.0, "joints": joints}
    hypotheses = {
        joint_name(part): hypotheses_to_json(_with_limit(part.hypotheses, part.motion.upper))
        for part in piece.parts
        if part.motion is not None and part.hypotheses
    }
    return {**entry, "hypotheses": hypotheses} if hypotheses else entry


def confidence_of(seen: float, label: float, piece: Piece | None) -> Confidence:
    """Return the confidence of a scan in an object, its label and its parts."""
    parts = [part for part in (piece.parts if piece else ()) if part.motion is not None]
    return Confidence(
        seen,
        label,
        {joint_name(p): p.confidence for p in parts if p.confidence is not None},
        {joint_name(p): p.handle_confidence for p in parts if p.handle_confidence is not None},
    )


def _with_limit(found: Sequence[Hypothesis], upper: float) -> list[Hypothesis]:
    """Return the hypotheses, the first with the limit of the part's own motion."""
    return [replace(found[0], upper=upper), *found[1:]]


def joint_name(part: FurniturePart) -> str:
    """Return the name of the joint that moves a part."""
    if part.motion is None:
        return f"{part.name}_mount"
    return f"{part.name}_{'hinge' if part.motion.kind == 'revolute' else 'slide'}"


def urdf_text(piece: Piece) -> str:
    """Return a piece as a URDF; handles are separate links, fixed to their parts."""
    body = piece.parts[0]
    lines = ['<?xml version="1.0"?>', f'<robot name="{piece.name}">']
    for color, rgba in COLORS.items():
        lines.append(f'  <material name="{color}"><color rgba="{rgba}"/></material>')
    lines += _link(body.name, body.boxes, (0.0, 0.0, 0.0), "body")
    for part in piece.parts[1:]:
        origin = part.motion.pivot if part.motion is not None else (0.0, 0.0, 0.0)
        lines += _link(part.name, part.boxes, origin, "front")
        lines += _joint(part, body.name, origin)
        if part.handle:
            handle = f"{part.name}_handle"
            lines += _link(handle, part.handle, origin, "handle")
            lines += _joint(FurniturePart(handle, ()), part.name, (0.0, 0.0, 0.0))
    return "\n".join([*lines, "</robot>", ""])


def _joint(part: FurniturePart, parent: str, origin: Vec) -> list[str]:
    kind = "fixed" if part.motion is None else part.motion.kind
    lines = [
        f'  <joint name="{joint_name(part)}" type="{kind}">',
        f'    <parent link="{parent}"/><child link="{part.name}"/><origin xyz="{_text(origin)}"/>',
    ]
    if part.motion is not None:
        upper = round(part.motion.upper, 5)
        lines += [
            f'    <axis xyz="{_text(part.motion.axis)}"/>',
            f'    <limit lower="0" upper="{upper}" effort="100" velocity="1"/>',
        ]
    return [*lines, "  </joint>"]


def _link(name: str, boxes: Sequence[Box], origin: Vec, color: str) -> list[str]:
    """Return the lines of a link, with boxes converted from the piece's frame to the link's."""
    lines = [f'  <link name="{name}">', _inertial(boxes, origin)]
    for box, center, half in zip(boxes, *centers_and_halves(boxes), strict=True):
        shape = (
            f'<origin xyz="{_text(center - origin)}"/>'
            f'<geometry><box size="{_text(2 * half)}"/></geometry>'
        )
        lines.append(f'    <visual name="{box.name}">{shape}<material name="{color}"/></visual>')
        lines.append(f"    <collision>{shape}</collision>")
    return [*lines, "  </link>"]


def _inertial(boxes: Sequence[Box], origin: Vec) -> str:
    centers, halves = centers_and_halves(boxes)
    masses = DENSITY * np.prod(2 * halves, axis=1)
    mass = masses.sum()
    center = masses @ centers / mass
    offset = centers - center
    # The inertia of a box with half sizes h equals that of masses at +-h/sqrt(3) on its axes.
    second = np.einsum("n,ni,nj->ij", masses, offset, offset) + np.diag(masses @ halves**2 / 3)
    I = np.trace(second) * np.eye(3) - second  # noqa: E741
    terms = " ".join(
        f'i{"xyz"[i]}{"xyz"[j]}="{I[i, j]:.4g}"' for i in range(3) for j in range(i, 3)
    )
    return (
        f'    <inertial><origin xyz="{_text(center - origin)}"/>'
        f'<mass value="{mass:.4g}"/><inertia {terms}/></inertial>'
    )


def _text(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:g}" for value in vec(values))
