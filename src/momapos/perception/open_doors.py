"""Find open doors and flaps in a scan, and close them so that later stages see fronts."""

from __future__ import annotations

from collections.abc import Sequence

from momapos.model.records import Cloud, Frame, OpenLeaf, Part
from momapos.perception.fusion import SeenThrough
from momapos.perception.segmentation import close_in_cloud, find_open_leaves
from momapos.perception.views import (
    ClosedLeaf,
    KnownFront,
    area,
    close_in_frames,
    close_leaf,
    part_on,
)

from .records import ScanConfig, Tools

MIN_SEEN = 0.5
"""Share of a leaf's outer face that must be seen to search for its handle [-]."""


def open_leaves(
    cloud: Cloud,
    frames: Sequence[Frame],
    walls: Sequence[tuple[int, float]],
) -> tuple[OpenLeaf, ...]:
    """Find the open doors and flaps of a room; none without depth images.

    Args:
        cloud: Upright, fronts along x and y.
        frames: In the same world.
        walls: Axis of the normal, 0 or 1, and coordinate [m] of each wall.
    """
    if all(frame.depth is None for frame in frames):
        return ()
    free = SeenThrough(frames)
    return tuple(find_open_leaves(cloud, free, walls))


def close_leaves(
    leaves: Sequence[OpenLeaf],
    cloud: Cloud,
    frames: Sequence[Frame],
    tools: Tools,
    config: ScanConfig,
) -> tuple[Cloud, tuple[Frame, ...], tuple[KnownFront, ...]]:
    """Return the room with all leaves closed, and the leaves as known parts.

    Args:
        leaves: The open leaves.
        cloud, frames: As scanned.
        tools: Find the handles of the leaves.
        config: Constants.
    """
    if not leaves:
        return cloud, tuple(frames), ()
    seen = [close_leaf(leaf, frames) for leaf in leaves]
    known = [
        part_on(leaf, one, _part_on(one, tools)) for leaf, one in zip(leaves, seen, strict=True)
    ]
    return close_in_cloud(cloud, leaves, config.voxel), close_in_frames(frames, seen), tuple(known)


def _part_on(leaf: ClosedLeaf, tools: Tools) -> Part | None:
    """Return the largest part with a handle on a leaf whose outer face was seen."""
    if leaf.known.mean() < MIN_SEEN:
        return None
    parts = [part for part in tools.look(leaf.image, "").parts if part.handle is not None]
    return max(parts, key=lambda part: area(part.box), default=None)
