"""Convex hulls on the floor: monotone chain (Andrew 1979); scipy's hulls are slow to import."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..compiled import F2, entry

if TYPE_CHECKING:
    from jaxtyping import Float


def convex_hull(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k 2"]:
    """Return the corners of the convex hull, counterclockwise from the smallest x.

    A corner that protrudes by less than 0.1 nm is omitted.

    Args:
        points: At least three points. On one line they have no area, and two corners remain.
    """
    order = np.lexsort((points[:, 1], points[:, 0]))
    return _chain(np.ascontiguousarray(points[order], float))


@entry
def _chain(points: F2) -> np.ndarray:
    """Return the corners of the hull of points that are sorted by x, then y."""
    n = len(points)
    kept = np.empty((2 * n + 1, 2))
    count = 0
    for upper in (False, True):
        least = count + 1
        for k in range(n):
            c = points[n - 1 - k if upper else k]
            while count > least:
                a, b = kept[count - 2], kept[count - 1]
                abx, aby, acx, acy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
                if abx * acy - aby * acx > 1e-10 * np.hypot(acx, acy):
                    break
                count -= 1
            kept[count, 0], kept[count, 1] = c[0], c[1]
            count += 1
        count -= 1  # the last corner is the first of the next chain
    return kept[:count].copy()
