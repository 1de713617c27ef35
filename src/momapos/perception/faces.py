"""The upright faces of a box, and what pictures show of them when they are seen straight on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numba import njit

from momapos.geometry.transforms import invert, pose
from momapos.types import FaceImage, Frame, UprightBox

FACES = 4
"""Upright faces of a box: outward along its x, y, -x, -y."""
NEAREST = 0.1
"""Surfaces nearer to a camera are not looked at [m]."""
APART = 0.15
"""What lies farther before or behind a face is another thing, which hides it or is seen past it
[m]."""

FLAT = 0.1
"""Doors, handles and frames stay within this of a front's plane; legs and shelves do not [m]."""


@dataclass(frozen=True, eq=False)
class Face:
    """One upright face of a box."""

    index: int
    """0 to 3: outward along the box's x, y, -x, -y."""
    T_world_face: Float[np.ndarray, "4 4"]
    """Origin in the middle; x to the right as seen from outside, y up, z outward."""
    width: float
    """Along x [m]."""
    height: float
    """Along y [m]."""

    @property
    def outward(self) -> Float[np.ndarray, "3"]:
        """Unit normal in the world."""
        return self.T_world_face[:3, 2]


def box_faces(box: UprightBox) -> tuple[Face, ...]:
    """The four upright faces of a box."""
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    along = np.array([[c, s, 0.0], [-s, c, 0.0], [-c, -s, 0.0], [s, -c, 0.0]])
    up = np.array([0.0, 0.0, 1.0])
    faces = []
    for index, outward in enumerate(along):
        depth, width = (0, 1) if index % 2 == 0 else (1, 0)
        center = box.center + outward * box.size[depth] / 2
        R = np.stack([np.cross(up, outward), up, outward], axis=1)
        faces.append(Face(index, pose(center, R), float(box.size[width]), float(box.size[2])))
    return tuple(faces)


def face_image(face: Face, frames: Sequence[Frame], *, pixels: int = 384) -> FaceImage:
    """Look straight at a face.

    Colour comes from the first frame that shows a place, the relief is the median of what all
    frames measured there: one depth picture alone is too noisy to tell a handle from a door.

    Args:
        face: Where to look.
        frames: Pictures that show the face, the best first.
        pixels: Length of the longer side of the result [px].
    """
    scale = pixels / max(face.width, face.height)
    shape = (max(8, round(face.height * scale)), max(8, round(face.width * scale)))
    colour = np.zeros((*shape, 3), np.uint8)
    unseen = np.ones(shape, bool)
    reliefs = []
    for frame in frames:
        seen, picture, relief = _look(face, frame, shape)
        new = unseen & seen
        colour[new] = picture[new]
        unseen &= ~seen
        reliefs.append(relief)
    eye = eye_of(face, frames[0]) if frames else None
    return FaceImage(colour, _median(reliefs, shape), face.width, face.height, eye)


def eye_of(face: Face, frame: Frame) -> Float[np.ndarray, "3"]:
    """Where a picture was taken, in the frame of a face [m]."""
    return (invert(face.T_world_face) @ frame.T_world_camera)[:3, 3]


def solid(image: FaceImage) -> float:
    """Part of what was measured of a face that lies in its plane, in [0, 1]; 1 without depth."""
    measured = np.isfinite(image.relief)
    if not measured.any():
        return 1.0
    return float((np.abs(image.relief[measured]) < FLAT).mean())


def shown(face: Face, frame: Frame, *, pixels: int = 48) -> float:
    """Part of a face that a frame shows, and not something before or behind it, in [0, 1]."""
    scale = pixels / max(face.width, face.height)
    shape = (max(8, round(face.height * scale)), max(8, round(face.width * scale)))
    seen, _, relief = _look(face, frame, shape)
    return float((seen & ~(np.abs(relief) > APART)).mean())


def _median(
    reliefs: Sequence[Float32[np.ndarray, "h w"]], shape: tuple[int, int]
) -> Float32[np.ndarray, "h w"]:
    """Median over the frames that measured; NaN where none did."""
    if not reliefs:
        return np.full(shape, np.nan, np.float32)
    stack = np.sort(np.stack(reliefs), axis=0)  # NaN comes last
    count = np.isfinite(stack).sum(0)
    middle = np.maximum(count - 1, 0) // 2
    return np.take_along_axis(stack, middle[None], axis=0)[0]


def _look(
    face: Face, frame: Frame, shape: tuple[int, int]
) -> tuple[Bool[np.ndarray, "h w"], UInt8[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
    """One frame's view of a face: what is in the picture, its colour, its relief."""
    rows, columns = shape
    seen = np.zeros(shape, np.bool_)
    colour = np.zeros((rows, columns, 3), np.uint8)
    relief = np.full(shape, np.nan, np.float32)
    depth = np.zeros((1, 1), np.float32) if frame.depth is None else frame.depth
    T_camera_face = invert(frame.T_world_camera) @ face.T_world_face
    if T_camera_face[:3, 2] @ T_camera_face[:3, 3] < 0:  # the camera is on the outer side
        _sample(
            frame.colour, depth, frame.depth is not None, np.ascontiguousarray(frame.intrinsics),
            np.ascontiguousarray(T_camera_face), face.width, face.height, seen, colour, relief,
        )  # fmt: skip
    return seen, colour, relief


@njit(cache=True)
def _sample(
    picture: np.ndarray,
    depth: np.ndarray,
    has_depth: bool,
    intrinsics: np.ndarray,
    T_camera_face: np.ndarray,
    width: float,
    height: float,
    seen: np.ndarray,
    colour: np.ndarray,
    relief: np.ndarray,
) -> None:
    """Fill `seen`, `colour` and `relief` by looking along the ray through every pixel."""
    rows, columns = seen.shape
    tall, wide = picture.shape[:2]
    T = T_camera_face
    fx, fy, cx, cy = intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]
    for i in range(rows):
        y = height * (0.5 - (i + 0.5) / rows)
        for j in range(columns):
            x = width * ((j + 0.5) / columns - 0.5)
            pz = T[2, 0] * x + T[2, 1] * y + T[2, 3]
            if pz < NEAREST:
                continue
            px = T[0, 0] * x + T[0, 1] * y + T[0, 3]
            py = T[1, 0] * x + T[1, 1] * y + T[1, 3]
            u, v = fx * px / pz + cx, fy * py / pz + cy
            if u < 0.0 or v < 0.0 or u > wide - 1.001 or v > tall - 1.001:
                continue
            seen[i, j] = True
            a, b = int(u), int(v)
            s, t = u - a, v - b
            for k in range(3):
                top = (1 - s) * picture[b, a, k] + s * picture[b, a + 1, k]
                low = (1 - s) * picture[b + 1, a, k] + s * picture[b + 1, a + 1, k]
                colour[i, j, k] = np.uint8((1 - t) * top + t * low + 0.5)
            if has_depth:
                z = depth[int(v + 0.5), int(u + 0.5)]
                if z > 0.0:
                    # The measured point lies on the same ray, at z instead of pz.
                    out = T[0, 2] * px + T[1, 2] * py + T[2, 2] * pz
                    relief[i, j] = (z / pz - 1.0) * out
