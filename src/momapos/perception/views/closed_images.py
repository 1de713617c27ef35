"""Edit images of a room so that its open doors and flaps appear closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.core.geometry import invert, pose
from momapos.model.records import UP, FaceImage, Frame, OpenLeaf, Part

from .faces import MAX_PLANE_OFFSET, Face, camera_position_of, face_image
from .front_view import KnownFront
from .placed_parts import shift_handles

if TYPE_CHECKING:
    from jaxtyping import Bool, Float32, UInt8

MIN_COSINE = 0.25
"""Between a leaf's normal and the line to a camera that shows it [-]."""
MAX_IMAGES = 12
"""Number of images of a leaf that are used, the most frontal and closest first [-]."""
PIXELS = 256
"""Length of the longer side of a leaf's image [px]."""
MIN_DEPTH_BEHIND = 0.02
"""A closed leaf hides what an image measures this far behind it [m]."""


@dataclass(frozen=True, eq=False)
class ClosedLeaf:
    """The outer face of a leaf in its closed pose, as seen while it was open."""

    face: Face
    image: FaceImage
    """Unseen pixels have the median color of the rest."""
    known: Bool[np.ndarray, "h w"]
    """Pixels that were seen."""


def close_leaf(leaf: OpenLeaf, frames: Sequence[Frame]) -> ClosedLeaf:
    """Return the outer face of an open leaf in its closed pose."""
    right = np.cross(UP, leaf.out)
    width, height = leaf.size if leaf.upright else leaf.size[::-1]
    closed = Face(0, pose(leaf.middle, np.stack([right, UP, leaf.out], axis=1)), width, height)
    there = replace(closed, T_world_face=invert(leaf.T_closed_open) @ closed.T_world_face)
    image = face_image(there, _showing(there, frames), pixels=PIXELS)
    known = np.isfinite(image.height_map) & (np.abs(image.height_map) < MAX_PLANE_OFFSET)
    return ClosedLeaf(closed, replace(image, color=_filled(image.color, known)), known)


def _showing(face: Face, frames: Sequence[Frame]) -> list[Frame]:
    """Return the images in front of a face, the most frontal and closest first."""
    rank = []
    for k, frame in enumerate(frames):
        camera = camera_position_of(face, frame)
        away = float(np.linalg.norm(camera))
        if camera[2] > MIN_COSINE * away:
            rank.append((camera[2] / away**2, k))
    return [frames[k] for _, k in sorted(rank, reverse=True)[:MAX_IMAGES]]


def _filled(
    color: UInt8[np.ndarray, "h w 3"], known: Bool[np.ndarray, "h w"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Fill unknown pixels with the median of the known ones; gray if none is known."""
    usual = np.median(color[known], axis=0) if known.any() else np.full(3, 127.0)
    return np.where(known[..., None], color, usual.astype(np.uint8))


def part_on(leaf: OpenLeaf, closed: ClosedLeaf, part: Part | None) -> KnownFront:
    """Return a leaf as a known part that fills its own face.

    Args:
        leaf: The leaf.
        closed: Its outer face.
        part: A part detected on that face, whose handle is the leaf's.
    """
    whole = Part(leaf.kind, (0.0, 0.0, 1.0, 1.0), 1.0, odds=((leaf.kind, 1.0),))
    if part is not None and part.handle is not None and closed.image.camera_position is not None:
        held = replace(whole, handle=part.handle)
        (whole,) = shift_handles([held], closed.face, closed.image.camera_position, undo=True)
    return KnownFront(closed.face, 1.0, (whole,))


def close_in_frames(frames: Sequence[Frame], leaves: Sequence[ClosedLeaf]) -> tuple[Frame, ...]:
    """Paint closed leaves over what images show through their openings.

    Whatever hides an opening stays, the open leaf too: other images show what is behind it.
    """
    out = []
    for frame in frames:
        for leaf in leaves:
            frame = _painted(frame, leaf)
        out.append(frame)
    return tuple(out)


def _painted(frame: Frame, leaf: ClosedLeaf) -> Frame:
    face, camera = leaf.face, camera_position_of(leaf.face, frame)
    if camera[2] <= 0.0:
        return frame
    h, w = frame.color.shape[:2]
    v, u = np.indices((h, w))
    rays = np.stack([u, v, np.ones((h, w))], axis=-1) @ np.linalg.inv(frame.intrinsics).T
    T = invert(face.T_world_face) @ frame.T_world_camera
    rays = rays @ T[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):  # rays parallel to the face
        depth = np.where(rays[..., 2] < 0.0, -camera[2] / rays[..., 2], np.nan)
        at = camera[:2] + rays[..., :2] * depth[..., None]
        place = np.stack([0.5 - at[..., 1] / face.height, 0.5 + at[..., 0] / face.width])
    there = ((place >= 0.0) & (place < 1.0)).all(axis=0)
    if frame.depth is not None:
        there &= (frame.depth == 0.0) | (frame.depth > depth + MIN_DEPTH_BEHIND)
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


def _heights(leaf: ClosedLeaf) -> Float32[np.ndarray, "h w"]:
    """Return the height of each pixel of a leaf above its face, 0 where unknown [m]."""
    heights = np.where(leaf.known, leaf.image.height_map, np.float32(0.0))
    return np.asarray(ndimage.median_filter(heights, 3))
