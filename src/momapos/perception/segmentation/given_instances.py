"""Prepare the instances of another program: merge duplicates, and place boxes seen in images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from momapos.core.geometry import UprightBox, along_edges, apply, from_corners, to_local
from momapos.model.records import Frame, ImageDetection, Instance

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_OVERLAP = 0.5
"""Masks with a larger IoU are one object [-]. Mask3D exports up to 750 masks of a room, one for
each probable class of an object."""

BOX_ERROR = 0.06
"""Boxes of one object in several images differ by this [m]: a counter is 4 cm thick."""


def without_duplicates(instances: Sequence[Instance], count: int) -> list[Instance]:
    """Drop masks that nearly repeat a mask with a higher score.

    Args:
        instances: In any order; those without members are kept.
        count: Number of points of the cloud.

    Returns:
        The rest, in the given order.
    """
    masked = [k for k, item in enumerate(instances) if item.members is not None]
    members = [np.unique(np.asarray(instances[k].members, int)) for k in masked]
    sizes = np.array([len(own) for own in members], float)
    if len(masked) < 2 or max(own.max(initial=0) for own in members) >= count:
        return list(instances)  # `boxes` refuses members that are not in the cloud
    rows = np.repeat(np.arange(len(masked)), sizes.astype(int))
    columns = np.concatenate(members)
    table = sparse.csr_array(
        (np.ones(len(rows), np.float32), (rows, columns)), shape=(len(masked), count)
    )
    shared = np.asarray((table @ table.T).todense())
    overlap = shared / np.maximum(sizes[:, None] + sizes - shared, 1.0)
    dropped: set[int] = set()
    kept: list[int] = []
    for row in np.argsort([-instances[k].score for k in masked], kind="stable").tolist():
        if (overlap[row, kept] > MAX_OVERLAP).any():
            dropped.add(masked[row])
        else:
            kept.append(row)
    return [item for k, item in enumerate(instances) if k not in dropped]


def boxes_in_images(
    found: Mapping[str, Sequence[ImageDetection]], frames: Sequence[Frame]
) -> list[Instance]:
    """Return the 3-D boxes that a detector found in images, one for each object.

    A box in one image is the same object as one of equal label in another image if the center of
    either lies in the other, or nearly; the one with the highest score is kept.

    Args:
        found: Detections by frame name; those without corners are ignored.
        frames: With poses in the upright world.
    """
    seen = [
        Instance(item.label, min(max(item.score, 0.0), 1.0), box=_upright(item.corners, frame))
        for frame in frames
        for item in found.get(frame.name, ())
        if item.corners is not None
    ]
    kept: list[Instance] = []
    for one in sorted(seen, key=lambda item: -item.score):
        if not any(one.label == other.label and _is_same(one.box, other.box) for other in kept):
            kept.append(one)
    return kept


def _is_same(a: UprightBox | None, b: UprightBox | None) -> bool:
    assert a is not None
    assert b is not None
    return _holds(a, b.center) or _holds(b, a.center)


def _holds(box: UprightBox, point: Float[np.ndarray, "3"]) -> bool:
    return bool((np.abs(to_local(point[None], box)[0]) < box.size / 2 + BOX_ERROR).all())


def _upright(corners: Sequence[tuple[float, float, float]] | None, frame: Frame) -> UprightBox:
    """Return the upright box around the corners of a box in a camera's frame.

    Its x axis is the edge that is closest to level; a detector's boxes are tilted by some degrees.
    """
    points = apply(frame.T_world_camera, np.array(corners, float))
    edges = points[[1, 3, 4]] - points[0]
    edges = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    level = edges[np.argmin(np.abs(edges[:, 2]))]
    yaw = float(np.arctan2(level[1], level[0]))
    yaw = float(np.mod(yaw + np.pi / 4, np.pi / 2) - np.pi / 4)
    turned = along_edges(points, yaw)
    return from_corners(turned.min(axis=0), turned.max(axis=0), yaw)
