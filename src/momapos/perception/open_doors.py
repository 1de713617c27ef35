"""Doors and flaps that stand open in a scan: found and shut, so that the rest sees fronts."""

from __future__ import annotations

from collections.abc import Sequence

from momapos.model.records import Cloud, Frame, OpenLeaf, Part
from momapos.perception.fusion import SeenThrough
from momapos.perception.segmentation import find_open_leaves, shut_cloud
from momapos.perception.views import Seen, ShutLeaf, area, part_on, shut_frames, shut_leaf

from .records import ScanConfig, Tools

LEAST = 0.5
"""Of a leaf's outer face so much must be seen for its handle to be looked for [-]."""


def open_leaves(
    cloud: Cloud,
    frames: Sequence[Frame],
    walls: Sequence[tuple[int, float]],
    config: ScanConfig,
) -> tuple[OpenLeaf, ...]:
    """The doors and flaps that stand open in a room; none where no image tells what is empty.

    Args:
        cloud: Upright, fronts along x and y.
        frames: In the same world.
        walls: Axis of the normal, 0 or 1, and coordinate [m] of each wall.
        config: What is taken for one.
    """
    if all(frame.depth is None for frame in frames):
        return ()
    free = SeenThrough(frames, config.completion.through)
    return tuple(find_open_leaves(cloud, free, walls, config.open_leaves))


def shut(
    leaves: Sequence[OpenLeaf],
    cloud: Cloud,
    frames: Sequence[Frame],
    tools: Tools,
    config: ScanConfig,
) -> tuple[Cloud, tuple[Frame, ...], tuple[Seen, ...]]:
    """The room with all leaves shut, and these as parts that are known.

    Args:
        leaves: That stand open.
        cloud, frames: As they were seen.
        tools: Look for the handles of the leaves.
        config: Constants.
    """
    if not leaves:
        return cloud, tuple(frames), ()
    seen = [shut_leaf(leaf, frames) for leaf in leaves]
    known = [
        part_on(leaf, one, _part_on(one, tools)) for leaf, one in zip(leaves, seen, strict=True)
    ]
    return shut_cloud(cloud, leaves, config.voxel), shut_frames(frames, seen), tuple(known)


def _part_on(leaf: ShutLeaf, tools: Tools) -> Part | None:
    """The largest part with a handle on a leaf, as far as its outer face was seen."""
    if leaf.known.mean() < LEAST:
        return None
    parts = [part for part in tools.look(leaf.image, "").parts if part.handle is not None]
    return max(parts, key=lambda part: area(part.box), default=None)
