"""Return the box of a mask in COCO's run lengths, for detectors that write masks without boxes.

Mask2Former leaves `bbox` at zero. A mask is the lengths of alternating runs of 0 and 1, column by
column. As text, each is a variable-length number of 5 bits per character, and from the third on the
difference to the one before the last (cocoapi, common/maskApi.c).
"""

from __future__ import annotations

from typing import Any

import numpy as np

MAX_SIDE = 100_000
"""Maximum height and width of a mask [px]."""
MAX_RUNS = 1_000_000


def box_of_mask(mask: Any) -> tuple[float, float, float, float] | None:
    """Return left, top, right, bottom of a mask [px]; None if it is empty.

    Args:
        mask: {"size": [height, width], "counts": text or list of run lengths}.

    Raises:
        ValueError: It is something else, or its runs do not fill the image.
    """
    if not isinstance(mask, dict) or not isinstance(mask.get("size"), list):
        raise ValueError("needs 'size' and 'counts'")
    size, counts = mask["size"], mask.get("counts")
    if len(size) != 2 or not all(type(v) is int and 0 < v <= MAX_SIDE for v in size):
        raise ValueError("'size' must be [height, width]")
    runs = _runs(counts) if isinstance(counts, str) else counts
    if not isinstance(runs, list) or not all(type(v) is int and v >= 0 for v in runs):
        raise ValueError("'counts' must be run lengths")
    height, width = size
    if len(runs) > MAX_RUNS or sum(runs) != height * width:
        raise ValueError(f"its runs do not fill {height} x {width} pixels")
    ends = np.cumsum(np.array(runs, np.int64))
    first, last = ends[:-1:2], ends[1::2] - 1  # of the runs of 1
    solid = last >= first[: len(last)]
    first, last = first[: len(last)][solid], last[solid]
    if not len(first):
        return None
    whole = last // height > first // height  # runs over several columns have all rows between
    top = 0 if whole.any() else int((first % height).min())
    bottom = height - 1 if whole.any() else int((last % height).max())
    return float(first[0] // height), float(top), float(last[-1] // height + 1), float(bottom + 1)


def _runs(text: str) -> list[int]:
    runs: list[int] = []
    value = shift = 0
    for character in text:
        code = ord(character) - 48
        if not 0 <= code < 64 or shift > 40:
            raise ValueError("'counts' has a character that is none of run lengths")
        value |= (code & 31) << shift
        shift += 5
        if not code & 32:
            if code & 16:
                value -= 1 << shift
            runs.append(value + (runs[-2] if len(runs) > 2 else 0))
            value = shift = 0
    return runs
