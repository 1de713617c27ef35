"""Write kitchens made of boxes: a URDF per piece, and the scene file.

Frame of a piece: x right, y to its back, z up, seen from the front. With closed joints (0), all
parts are axis-aligned boxes in that frame.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import InputError, temporary_folder
from momapos.core.geometry import apply, pose, rotation_about
from momapos.model.records import Confidence, Hypothesis
from momapos.model.scene.model_copies import copy_files
from momapos.model.scene.object_reader import confidence_to_json, hypotheses_to_json
from momapos.model.scene.scene_object import SceneObject

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


MAX_TOUCH_OVERLAP = 5e-4  # maximum overlap that counts as touching [m]
HANDLE_THICKNESS, HANDLE_STAND_OFF = (
    0.02,
    0.04,
)  # thickness of a handle, and its distance from the door [m]

Vec = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in the frame of its closed piece."""

    name: str
    low: Vec
    """Lower corner [m]."""
    high: Vec
    """Upper corner [m]."""


@dataclass(frozen=True)
class JointMotion:
    """Motion of a part relative to the body; 0 is closed."""

    kind: Literal["revolute", "prismatic"]
    pivot: Vec
    """Point on the axis, in the frame of the piece [m]."""
    axis: Vec
    """Unit vector along a coordinate axis of the piece."""
    upper: float
    """Upper joint limit [rad] or [m]."""


@dataclass(frozen=True)
class FurniturePart:
    """A rigid part: the body, a door, a drawer."""

    name: str
    boxes: tuple[Box, ...]
    motion: JointMotion | None = None
    """None for a part fixed to the body."""
    handle: tuple[Box, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()
    """Possible motions, the most probable first, which is `motion`; empty if the motion is
    known."""
    confidence: float | None = None
    """Confidence in the part and its motion, in [0, 1]; None if known."""
    handle_confidence: float | None = None
    """Confidence in the handle, in [0, 1]; None if known, or without a handle."""
    value: float = 0.0
    """Opening in the room [rad] or [m]."""


@dataclass(frozen=True)
class Piece:
    """A piece of furniture; its first part is the body."""

    name: str
    category: str
    xyz: Vec
    """Origin of its frame in the world [m]."""
    yaw: float
    """Rotation of its frame about the world's z axis [rad]."""
    parts: tuple[FurniturePart, ...]


def vec(values: Iterable[float]) -> Vec:
    """Return a triple of plain floats, rounded to 10 micrometers, without negative zeros."""
    x, y, z = (round(float(value), 5) + 0.0 for value in values)
    return x, y, z


def union(name: str, boxes: Sequence[Box]) -> Box:
    """Return the bounding box of boxes."""
    low = np.min([box.low for box in boxes], axis=0)
    high = np.max([box.high for box in boxes], axis=0)
    return Box(name, vec(low), vec(high))


def solid(name: str, category: str, size: Vec, center: Vec, yaw: float = 0.0) -> Piece:
    """Return a piece of one box, with its frame at the center."""
    half = tuple(value / 2 for value in size)
    box = Box(name, vec(-value for value in half), vec(half))
    return Piece(name, category, center, yaw, (FurniturePart("body", (box,)),))


def bar_handle(
    part: str,
    x: float,
    z: float,
    length: float,
    *,
    upright: bool,
    front: float,
    bar: float = HANDLE_THICKNESS,
    stand_off: float = HANDLE_STAND_OFF,
) -> tuple[Box, ...]:
    """Return a bar on two posts.

    Args:
        part: Name of its part.
        x: Center [m].
        z: Center [m].
        length: Length of the bar [m].
        upright: Along z; otherwise along x.
        front: y coordinate of the mounting surface [m].
        bar: Thickness of the bar [m].
        stand_off: Distance of the bar from the surface [m].
    """
    along = np.array([0.0, 0.0, 1.0] if upright else [1.0, 0.0, 0.0])
    across = np.array([1.0, 0.0, 0.0] if upright else [0.0, 0.0, 1.0])
    center = np.array([x, front - stand_off - bar / 2, z])
    half = along * length / 2 + across * bar / 2 + np.array([0.0, bar / 2, 0.0])
    post = min(0.0075, bar / 2)
    boxes = [Box(f"{part}_handle_bar", vec(center - half), vec(center + half))]
    for end, sign in (("a", -1.0), ("b", 1.0)):
        foot = np.array([x, front - stand_off / 2, z]) + sign * along * (length / 2 - bar)
        half = np.array([post, stand_off / 2, post])
        boxes.append(Box(f"{part}_handle_post_{end}", vec(foot - half), vec(foot + half)))
    return tuple(boxes)


def part_poses(
    piece: Piece, part: FurniturePart, values: Float[np.ndarray, " s"]
) -> Float[np.ndarray, "s 4 4"]:
    """Return the transforms from a part's closed points in the piece's frame to the world.

    Args:
        piece: The piece of furniture.
        part: One of its parts.
        values: Joint values [rad] or [m]; without effect on a fixed part.
    """
    T_world_piece = pose(piece.xyz, rotation_about(np.array([0.0, 0.0, 1.0]), piece.yaw))
    Ts_piece_part = np.tile(np.eye(4), (len(values), 1, 1))
    if part.motion is not None and part.motion.kind == "prismatic":
        Ts_piece_part[:, :3, 3] = values[:, None] * np.asarray(part.motion.axis)
    elif part.motion is not None:
        R, pivot = (
            rotation_about(np.asarray(part.motion.axis), values),
            np.asarray(part.motion.pivot),
        )
        Ts_piece_part[:, :3, :3] = R
        Ts_piece_part[:, :3, 3] = pivot - R @ pivot
    return T_world_piece @ Ts_piece_part


def centers_and_halves(
    boxes: Sequence[Box],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return the centers and half sizes of boxes [m], in the frame of their piece."""
    low, high = np.array([b.low for b in boxes]), np.array([b.high for b in boxes])
    return (low + high) / 2, (high - low) / 2


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Boxes in the world."""

    R: Float[np.ndarray, "n 3 3"]
    centers: Float[np.ndarray, "n 3"]
    halves: Float[np.ndarray, "n 3"]

    def bounds(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Return the lower and upper corners of their world-aligned bounding boxes [m]."""
        half = np.einsum("nij,nj->ni", np.abs(self.R), self.halves)
        return self.centers - half, self.centers + half


def obstacles(pieces: Iterable[Piece], without: tuple[str, str] | None = None) -> Obstacles:
    """Collect the boxes of closed furniture, except one part given by piece and name."""
    Rs, centers, halves = [], [], []
    for piece in pieces:
        for part in piece.parts:
            boxes = (*part.boxes, *part.handle)
            if boxes and (piece.name, part.name) != without:
                T = part_poses(piece, part, np.zeros(1))[0]
                center, half = centers_and_halves(boxes)
                Rs.append(np.tile(T[:3, :3], (len(boxes), 1, 1)))
                centers.append(apply(T, center))
                halves.append(half)
    return Obstacles(np.concatenate(Rs), np.concatenate(centers), np.concatenate(halves))


def hits(
    piece: Piece, part: FurniturePart, values: Float[np.ndarray, " s"], others: Obstacles
) -> Bool[np.ndarray, " s"]:
    """Return whether a part overlaps other boxes at each joint value [rad] or [m].

    Only the boxes' own axes are tested as separating axes. This is exact for boxes that share an
    axis, as all do here except a few small objects; for these it may report false hits.
    """
    Ts = part_poses(piece, part, values)
    center, h = centers_and_halves((*part.boxes, *part.handle))
    R, c = Ts[:, :3, :3], apply(Ts, center)
    reach = np.einsum("sij,mj->smi", np.abs(R), h)
    low, high = others.bounds()
    near = np.all((low < (c + reach).max((0, 1))) & (high > (c - reach).min((0, 1))), axis=1)
    R2, c2, h2 = others.R[near], others.centers[near], others.halves[near]
    t = c2 - c[:, :, None]
    A = np.abs(np.einsum("sji,njk->snik", R, R2))
    own = h[:, None] + np.einsum("snij,nj->sni", A, h2)[:, None]
    own = own - np.abs(np.einsum("sji,smnj->smni", R, t))
    other = h2 + np.einsum("snji,mj->smni", A, h) - np.abs(np.einsum("nji,smnj->smni", R2, t))
    return np.any(np.minimum(own.min(-1), other.min(-1)) > MAX_TOUCH_OVERLAP, axis=(1, 2))


def limit_joints_before_hits(
    piece: Piece, pieces: Sequence[Piece], least: Mapping[str, float]
) -> Piece:
    """Limit each joint of a piece so that its part hits no closed furniture.

    A part that opens less than `least` [rad] or [m] for its kind of joint is fixed instead, and
    loses its handle.
    """
    parts = []
    for part in piece.parts:
        motion, handle = part.motion, part.handle
        if motion is not None:
            values = np.linspace(0.0, motion.upper, 121)
            hit = hits(piece, part, values, obstacles(pieces, without=(piece.name, part.name)))
            if hit.any():
                motion = replace(motion, upper=float(values[max(int(np.argmax(hit)) - 3, 0)]))
            if motion.upper < least[motion.kind]:
                motion, handle = None, ()
        parts.append(replace(part, motion=motion, handle=handle))
    return replace(piece, parts=tuple(parts))


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
    # Rounding errors, which depend on the processor.
    I = np.where(np.abs(I) < 1e-9 * np.trace(second), 0.0, I)  # noqa: E741
    terms = " ".join(
        f'i{"xyz"[i]}{"xyz"[j]}="{I[i, j]:.4g}"' for i in range(3) for j in range(i, 3)
    )
    return (
        f'    <inertial><origin xyz="{_text(center - origin)}"/>'
        f'<mass value="{mass:.4g}"/><inertia {terms}/></inertial>'
    )


def _text(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:g}" for value in vec(values))
