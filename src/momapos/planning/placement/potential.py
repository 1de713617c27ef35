"""Compute the attraction of base positions: near the waypoints, with a line of sight.

Source: MoMa-Pos, section III-C. The paper sums over waypoints and tests the line of sight
against whole boxes. Here the weakest waypoint counts, the value lies in [0, 1], and the boxes
are those of the static parts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import F2, F3, entry
from momapos.model.urdf import Boxes

from .area import PlacementGeometry

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

FULL_ATTRACTION_DISTANCE = 0.3
"""Distance up to which the attraction is 1 [m]; bounds 1 / distance."""
_SKIN = 0.03
"""A box this close to a target does not hide it: handles are mounted on doors [m]."""


@entry
def _sees(
    sources: F2,
    targets: F2,
    center: F2,
    rotation: F3,
    half: F2,
) -> np.ndarray:
    """Check that the segment from each source to each target misses all boxes."""
    out = np.empty((len(sources), len(targets)), np.bool_)
    for n in range(len(sources)):
        for w in range(len(targets)):
            out[n, w] = True
            dx = targets[w, 0] - sources[n, 0]
            dy = targets[w, 1] - sources[n, 1]
            dz = targets[w, 2] - sources[n, 2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            stop = 1.0 - _SKIN / max(length, 1e-9)
            for b in range(len(center)):
                x = sources[n, 0] - center[b, 0]
                y = sources[n, 1] - center[b, 1]
                z = sources[n, 2] - center[b, 2]
                near, far = 0.0, stop
                for k in range(3):
                    o = x * rotation[b, 0, k] + y * rotation[b, 1, k] + z * rotation[b, 2, k]
                    d = dx * rotation[b, 0, k] + dy * rotation[b, 1, k] + dz * rotation[b, 2, k]
                    if abs(d) < 1e-12:
                        if abs(o) > half[b, k]:
                            far = -1.0
                        continue
                    t0, t1 = (-half[b, k] - o) / d, (half[b, k] - o) / d
                    near, far = max(near, min(t0, t1)), min(far, max(t0, t1))
                if near < far:
                    out[n, w] = False
                    break
    return out


def sees(
    sources: Float[np.ndarray, "n 3"], targets: Float[np.ndarray, "w 3"], boxes: Boxes
) -> Bool[np.ndarray, "n w"]:
    """Check that no box lies between each source and each target."""
    return _sees(sources, targets, boxes.center, boxes.rotation, boxes.half)


def attraction(
    geometry: PlacementGeometry,
    positions: Float[np.ndarray, "n 2"],
    heights: Float[np.ndarray, " z"],
    *,
    waypoints: int = 4,
) -> Float[np.ndarray, " n"]:
    """Return the field F in [0, 1]: bounded 1 / distance if the target is visible, else 0.

    Args:
        geometry: Scene and task.
        positions: Base positions [m].
        heights: Heights of the viewpoint [m]; the best counts.
        waypoints: Number of waypoints, evenly chosen, that must be visible [-]; the weakest counts.
    """
    plain = geometry.Ts_world_tool[0, :, :3, 3]
    targets = np.ascontiguousarray(
        plain[np.linspace(0, len(plain) - 1, waypoints).round().astype(int)]
    )
    distance = np.linalg.norm(positions[:, None] - targets[None, :, :2], axis=-1)
    field = np.minimum(1.0, FULL_ATTRACTION_DISTANCE / np.maximum(distance, 1e-9))
    seen = np.zeros(distance.shape, bool)
    for z in heights:
        sources = np.column_stack([positions, np.full(len(positions), z)])
        seen |= sees(sources, targets, geometry.static)
    return (field * seen).min(1)
