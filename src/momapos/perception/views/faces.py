"""The upright faces of a box, and frontal images of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from momapos.core.compiled import F1, I1, S2, S3, Array, entry, kernel
from momapos.core.geometry import UprightBox, along_edges, apply, invert, pose, to_local
from momapos.model.records import FaceImage, Frame

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, UInt8

FACES = 4
"""Upright faces of a box: outward along its x, y, -x, -y."""
MIN_DEPTH = 0.1
"""Surfaces closer to a camera are ignored [m]."""
MAX_PLANE_OFFSET = 0.15
"""Surfaces farther in front of or behind a face belong to other objects [m]."""
PARALLAX_SIGMA = 0.2
"""Standard deviation of the difference in slope between lines of sight that are merged: a handle
that protrudes by 4 cm shifts by less than 1 cm between them [-]."""
MAX_GAP = 0.08
"""Neighbors are closer to an object than this [m]."""
HIDDEN, CLEAR = 1, 2
"""What a frame shows at a pixel of a face: another object, or the face."""
PLANE_STEP = 4
"""Pixel stride for the estimate of a face's plane [-]."""
MAX_FRONT_DEPTH = 0.1
"""Doors, handles and frames lie within this of a front's plane; legs and shelves do not [m]."""


@dataclass(frozen=True, eq=False)
class Face:
    """One upright face of a box."""

    index: int
    """0 to 3: outward along the box's x, y, -x, -y."""
    T_world_face: Float[np.ndarray, "4 4"]
    """Origin in the middle; x to the right as seen from outside, y up, z outward."""
    width: float
    """Extent along x [m]."""
    height: float
    """Extent along y [m]."""

    @property
    def outward(self) -> Float[np.ndarray, "3"]:
        """Outward unit normal in the world."""
        return self.T_world_face[:3, 2]

    @property
    def opposite(self) -> int:
        """Index of the face on the other side."""
        return (self.index + FACES // 2) % FACES

    @property
    def neighbors(self) -> tuple[int, int]:
        """Indices of the faces to the left and right, as seen from outside."""
        return (self.index - 1) % FACES, (self.index + 1) % FACES


def box_faces(box: UprightBox) -> tuple[Face, ...]:
    """Return the four upright faces of a box."""
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


def neighbor_protrusion(side: Face, front: Face, others: Sequence[UprightBox]) -> float | None:
    """Return how far neighbors at one face of an object protrude beyond another face.

    Args:
        side: Face next to which neighbors may stand, closer than `MAX_GAP`.
        front: Face beyond which they may protrude, of the same box.
        others: Boxes of possible neighbors.

    Returns:
        The largest protrusion [m], negative if all end behind the front; None without neighbors.
    """
    across, up, out = np.meshgrid([-0.45, -0.2, 0.0, 0.2, 0.45], [-0.4, 0.0, 0.4], [0.02, MAX_GAP])
    local = np.stack([across * side.width, up * side.height, out], axis=-1).reshape(-1, 3)
    points = apply(side.T_world_face, local)
    plane = float(front.outward @ front.T_world_face[:3, 3])
    reaches = [
        float(front.outward @ box.center + np.abs(along_edges(front.outward[None], box.yaw)[0])
              @ box.size / 2)
        for box in others
        if (np.abs(to_local(points, box)) < box.size / 2).all(axis=1).any()
    ]  # fmt: skip
    return max(reaches) - plane if reaches else None


def face_image(face: Face, frames: Sequence[Frame], *, pixels: int = 384) -> FaceImage:
    """Return a frontal image of a face, see `SampledFace.image`.

    Args:
        face: The face.
        frames: Images that show the face, the best first.
        pixels: Length of the longer side of the result [px].
    """
    return SampledFace.of(face, frames, pixels=pixels).image(range(len(frames)))


@dataclass(frozen=True, eq=False)
class SampledFace:
    """What each of several frames shows at every pixel of a face.

    The frames' depth is sampled once, for any number of images of the face.
    """

    face: Face
    frames: Sequence[Frame]
    cameras: Float[np.ndarray, "n 3"]
    """Camera positions in the frame of the face [m]."""
    heights: Float32[np.ndarray, "n h w"]
    """Height of the surface above the face [m]; NaN where not measured."""
    states: UInt8[np.ndarray, "n h w"]
    """0 outside a frame's image, `HIDDEN` where it shows another object, `CLEAR` elsewhere."""

    @staticmethod
    def of(face: Face, frames: Sequence[Frame], *, pixels: int = 384) -> SampledFace:
        """Sample all frames at the pixels of a face.

        Args:
            face: The face.
            frames: Images that show the face.
            pixels: Length of the longer side [px].
        """
        shape = (len(frames), *_shape(face, pixels))
        heights, states = np.full(shape, np.nan, np.float32), np.zeros(shape, np.uint8)
        for frame, height_map, state in zip(frames, heights, states, strict=True):
            photo = _photo(face, frame)
            if photo is not None:
                _sample(photo, face.width, face.height, height_map, state)
        cameras = np.array([camera_position_of(face, frame) for frame in frames]).reshape(-1, 3)
        return SampledFace(face, frames, cameras, heights, states)

    def image(self, order: Sequence[int]) -> FaceImage:
        """Return the face, seen straight on.

        Color comes from the first frame that shows a pixel unobstructed. The height map is the mean
        of the depth in all such frames, because the noise of one depth image hides handles. Frames
        are weighted by the inverse variance of a stereo camera at their distance, and by how close
        their line of sight is to that of the first, because of parallax. Pixels that all frames
        show obstructed show the obstruction.

        Args:
            order: Indices of the frames to use, the best first.
        """
        face, chosen = self.face, np.array(order, int)
        cameras = self.cameras[chosen]
        weights = np.array([_weight(camera, cameras[0]) for camera in cameras])
        height_map, source = _merged(self.heights, self.states, chosen, weights)
        color = np.zeros((*source.shape, 3), np.uint8)
        for k in np.unique(source[source >= 0]).tolist():
            photo = _photo(face, self.frames[k])
            assert photo is not None
            _paint(photo, face.width, face.height, source, k, color)
        seen_from = cameras[0] if len(cameras) else None
        return FaceImage(color, height_map, face.width, face.height, seen_from)


def camera_position_of(face: Face, frame: Frame) -> Float[np.ndarray, "3"]:
    """Return the camera position of an image in the frame of a face [m]."""
    return (invert(face.T_world_face) @ frame.T_world_camera)[:3, 3]


def _weight(camera: Float[np.ndarray, "3"], first: Float[np.ndarray, "3"]) -> float:
    """Return the depth weight of a camera relative to the first, from their positions [m]."""
    slopes = camera[:2] / max(camera[2], MIN_DEPTH) - first[:2] / max(first[2], MIN_DEPTH)
    length = max(float(np.linalg.norm(camera)), MIN_DEPTH)
    return float(np.exp(-(slopes @ slopes) / (2 * PARALLAX_SIGMA**2))) / length**4


def coplanar_share(image: FaceImage, box: tuple[float, float, float, float] | None = None) -> float:
    """Return the share of a face's measured pixels that lie in one plane; 1 without depth.

    The plane is estimated from the pixels near the face: below a protruding top, the front lies
    behind the face.

    Args:
        image: The face.
        box: Only within this rectangle, (left, top, right, bottom) as fractions of the face.
    """
    height_map = image.height_map
    sparse = height_map[::PLANE_STEP, ::PLANE_STEP]
    near = sparse[np.abs(sparse) < MAX_PLANE_OFFSET]  # NaN compares as false
    plane = float(np.median(near)) if len(near) else 0.0
    if box is not None:
        h, w = height_map.shape
        left, top, right, bottom = np.round(np.array(box) * [w, h, w, h]).astype(int)
        height_map = height_map[top : bottom + 1, left : right + 1]
    measured = height_map[np.isfinite(height_map)]
    return float((np.abs(measured - plane) < MAX_FRONT_DEPTH).mean()) if len(measured) else 1.0


def visible_share(face: Face, frame: Frame, *, pixels: int = 48) -> float:
    """Return the share of a face that a frame shows unobstructed, in [0, 1].

    Open places, such as the leg space of a desk, do not count.
    """
    seen = SampledFace.of(face, [frame], pixels=pixels)
    through = seen.heights < -MAX_PLANE_OFFSET  # NaN compares as false
    return float((seen.states == CLEAR).sum() / max((~through).sum(), 1))


def _shape(face: Face, pixels: int) -> tuple[int, int]:
    scale = pixels / max(face.width, face.height)
    return max(8, round(face.height * scale)), max(8, round(face.width * scale))


Matrix = Annotated[np.ndarray, Array(np.dtype("f8"), 2, readonly=True)]
Bytes2 = Annotated[np.ndarray, Array(np.dtype("u1"), 2)]
Bytes3 = Annotated[np.ndarray, Array(np.dtype("u1"), 3)]


class _Photo(NamedTuple):
    """One frame relative to a face, for the kernels."""

    image: Annotated[np.ndarray, Array(np.dtype("u1"), 3, readonly=True)]
    depth: Annotated[np.ndarray, Array(np.dtype("f4"), 2, readonly=True)]
    has_depth: bool
    """Whether `depth` was measured; it is not read otherwise."""
    intrinsics: Matrix
    T_camera_face: Matrix


def _photo(face: Face, frame: Frame) -> _Photo | None:
    """Prepare a frame for the kernels; None if its camera is behind the face."""
    T_camera_face = invert(frame.T_world_camera) @ face.T_world_face
    if T_camera_face[:3, 2] @ T_camera_face[:3, 3] >= 0:
        return None
    depth = np.zeros((1, 1)) if frame.depth is None else frame.depth
    return _Photo(
        np.ascontiguousarray(frame.color, np.uint8),
        np.ascontiguousarray(depth, np.float32),
        frame.depth is not None,
        np.ascontiguousarray(frame.intrinsics, float),
        np.ascontiguousarray(T_camera_face, float),
    )


@kernel
def _pixel(photo, width, height, shape, i, j):
    """Project a pixel of a face into a photo: whether it is inside, u, v [px], x, y, z [m].

    Args:
        photo: The photo.
        width, height: Size of the face [m].
        shape: Rows and columns of the face.
        i, j: Row and column of the pixel.
    """
    K, T = photo.intrinsics, photo.T_camera_face
    tall, wide = photo.image.shape[:2]
    x, y = width * ((j + 0.5) / shape[1] - 0.5), height * (0.5 - (i + 0.5) / shape[0])
    pz = T[2, 0] * x + T[2, 1] * y + T[2, 3]
    if pz < MIN_DEPTH:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0
    px = T[0, 0] * x + T[0, 1] * y + T[0, 3]
    py = T[1, 0] * x + T[1, 1] * y + T[1, 3]
    u, v = K[0, 0] * px / pz + K[0, 2], K[1, 1] * py / pz + K[1, 2]
    there = u >= 0.0 and v >= 0.0 and u <= wide - 1.001 and v <= tall - 1.001
    return there, u, v, px, py, pz


@entry
def _sample(photo: _Photo, width: float, height: float, height_map: S2, state: Bytes2) -> None:
    """Sample a photo at every pixel of a face; fills `height_map` and `state`."""
    T, shape = photo.T_camera_face, state.shape
    for i in range(shape[0]):
        for j in range(shape[1]):
            there, u, v, px, py, pz = _pixel(photo, width, height, shape, i, j)
            if not there:
                continue
            state[i, j] = CLEAR
            if photo.has_depth:
                z = photo.depth[int(v + 0.5), int(u + 0.5)]
                if z > 0.0:
                    # The measured point lies on the same ray, at z instead of pz.
                    out = T[0, 2] * px + T[1, 2] * py + T[2, 2] * pz
                    height_map[i, j] = (z / pz - 1.0) * out
                    if abs(height_map[i, j]) > MAX_PLANE_OFFSET:
                        state[i, j] = HIDDEN


@entry
def _merged(heights: S3, states: Bytes3, order: I1, weights: F1) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean height map of a face, and the source frame of each pixel's color, -1 if none.

    Args:
        heights, states: Of all frames.
        order: The frames to use, the best first.
        weights: Weights of their depth.
    """
    _, rows, columns = heights.shape
    height_map = np.full((rows, columns), np.nan, np.float32)
    source = np.full((rows, columns), -1, np.int16)
    for i in range(rows):
        for j in range(columns):
            best = 0
            near, near_weight, far, far_weight = 0.0, 0.0, 0.0, 0.0
            for m in range(len(order)):
                state, out = states[order[m], i, j], heights[order[m], i, j]
                if state > best:
                    best = state
                    source[i, j] = order[m]
                if not np.isnan(out):
                    if state == CLEAR:
                        near += weights[m] * out
                        near_weight += weights[m]
                    else:
                        far += weights[m] * out
                        far_weight += weights[m]
            if near_weight > 0.0:
                height_map[i, j] = near / near_weight
            elif far_weight > 0.0:
                height_map[i, j] = far / far_weight
    return height_map, source


@entry
def _paint(
    photo: _Photo,
    width: float,
    height: float,
    source: Annotated[np.ndarray, Array(np.dtype("i2"), 2)],
    index: int,
    color: Bytes3,
) -> None:
    """Color the pixels of a face whose source is this photo; fills `color`."""
    image, shape = photo.image, source.shape
    for i in range(shape[0]):
        for j in range(shape[1]):
            if source[i, j] != index:
                continue
            _, u, v, _, _, _ = _pixel(photo, width, height, shape, i, j)
            a, b = int(u), int(v)
            s, t = u - a, v - b
            for k in range(3):
                top = (1 - s) * image[b, a, k] + s * image[b, a + 1, k]
                low = (1 - s) * image[b + 1, a, k] + s * image[b + 1, a + 1, k]
                color[i, j, k] = np.uint8((1 - t) * top + t * low + 0.5)
