"""Images of a room as they would be if the leaves that stand open in it were shut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.core.geometry import invert, pose
from momapos.model.records import UP, FaceImage, Frame, OpenLeaf, Part

from .faces import APART, Face, camera_position_of, face_image
from .front_view import Seen
from .placed_parts import handles_seen_from

if TYPE_CHECKING:
    from jaxtyping import Bool, Float32, UInt8

GRAZING = 0.25
"""Cosine between a leaf's normal and the line to a camera that shows it, at least [-]."""
LOOKED_AT = 12
"""Images of a leaf that are looked at, the straightest and nearest first [-]."""
PIXELS = 256
"""Along the longer side of what is known of a leaf [px]."""
BEHIND = 0.02
"""What an image measures so far behind a shut leaf would be hidden by it [m]."""


@dataclass(frozen=True, eq=False)
class ShutLeaf:
    """The outer face of a leaf: where it is when shut, and what was seen of it while open."""

    face: Face
    image: FaceImage
    """What was not seen has the color of the rest."""
    known: Bool[np.ndarray, "h w"]
    """Where it was seen."""


def shut_leaf(leaf: OpenLeaf, frames: Sequence[Frame]) -> ShutLeaf:
    """Look at the outer face of a leaf that stands open."""
    right = np.cross(UP, leaf.out)
    width, height = leaf.size if leaf.upright else leaf.size[::-1]
    shut = Face(0, pose(leaf.middle, np.stack([right, UP, leaf.out], axis=1)), width, height)
    there = replace(shut, T_world_face=invert(leaf.T_shut_open) @ shut.T_world_face)
    image = face_image(there, _showing(there, frames), pixels=PIXELS)
    known = np.isfinite(image.height_map) & (np.abs(image.height_map) < APART)
    return ShutLeaf(shut, replace(image, color=_filled(image.color, known)), known)


def _showing(face: Face, frames: Sequence[Frame]) -> list[Frame]:
    """Images from before a face, the straightest and nearest first."""
    rank = []
    for k, frame in enumerate(frames):
        camera = camera_position_of(face, frame)
        away = float(np.linalg.norm(camera))
        if camera[2] > GRAZING * away:
            rank.append((camera[2] / away**2, k))
    return [frames[k] for _, k in sorted(rank, reverse=True)[:LOOKED_AT]]


def _filled(
    color: UInt8[np.ndarray, "h w 3"], known: Bool[np.ndarray, "h w"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Colors with the usual one of what is known where nothing is; gray where nothing at all is."""
    usual = np.median(color[known], axis=0) if known.any() else np.full(3, 127.0)
    return np.where(known[..., None], color, usual.astype(np.uint8))


def part_on(leaf: OpenLeaf, shut: ShutLeaf, part: Part | None) -> Seen:
    """A leaf as a part that is known, on the face that it is.

    Args:
        leaf: The leaf.
        shut: Its outer face.
        part: What was seen on that face, in its fractions; its handle is the leaf's.
    """
    whole = Part(leaf.kind, (0.0, 0.0, 1.0, 1.0), 1.0, odds=((leaf.kind, 1.0),))
    if part is not None and part.handle is not None and shut.image.camera_position is not None:
        held = replace(whole, handle=part.handle)
        (whole,) = handles_seen_from([held], shut.face, shut.image.camera_position, undo=True)
    return Seen(shut.face, 1.0, (whole,))


def shut_frames(frames: Sequence[Frame], leaves: Sequence[ShutLeaf]) -> tuple[Frame, ...]:
    """Paint shut leaves into images, over what is seen through their openings.

    What hides such a place stays, the open leaf too: another image shows what is behind it.
    """
    out = []
    for frame in frames:
        for leaf in leaves:
            frame = _painted(frame, leaf)
        out.append(frame)
    return tuple(out)


def _painted(frame: Frame, leaf: ShutLeaf) -> Frame:
    """One image with one leaf shut."""
    face, camera = leaf.face, camera_position_of(leaf.face, frame)
    if camera[2] <= 0.0:
        return frame
    h, w = frame.color.shape[:2]
    v, u = np.indices((h, w))
    rays = np.stack([u, v, np.ones((h, w))], axis=-1) @ np.linalg.inv(frame.intrinsics).T
    T = invert(face.T_world_face) @ frame.T_world_camera
    rays = rays @ T[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):  # rays along the face meet it nowhere
        depth = np.where(rays[..., 2] < 0.0, -camera[2] / rays[..., 2], np.nan)
        at = camera[:2] + rays[..., :2] * depth[..., None]
        place = np.stack([0.5 - at[..., 1] / face.height, 0.5 + at[..., 0] / face.width])
    there = ((place >= 0.0) & (place < 1.0)).all(axis=0)
    if frame.depth is not None:
        there &= (frame.depth == 0.0) | (frame.depth > depth + BEHIND)
    if not there.any():
        return frame
    rows, columns = (
        np.minimum((place[k][there] * size).astype(int), size - 1)
        for k, size in enumerate(leaf.known.shape)
    )
    color = frame.color.copy()
    color[there] = leaf.image.color[rows, columns]
    if frame.depth is None:
        return replace(frame, color=color)
    measured = frame.depth.copy()
    out = _heights(leaf)[rows, columns]
    measured[there] = (depth[there] + out / rays[there][:, 2]).astype(np.float32)
    return replace(frame, color=color, depth=measured)


def _heights(leaf: ShutLeaf) -> Float32[np.ndarray, "h w"]:
    """How far each place of a leaf stands out of its face, 0 where that is not known [m]."""
    heights = np.where(leaf.known, leaf.image.height_map, np.float32(0.0))
    return np.asarray(ndimage.median_filter(heights, 3))
