"""Store drawn faces as network inputs in files, so that they are drawn only once."""

from __future__ import annotations

import multiprocessing as mp
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from momapos.core.geometry.line_detection import SEAM_MOST
from momapos.perception.reconstruction import decode

from . import generator

MOST_PARTS = 24
CROPS = 6
"""Number of crops per face [-]."""
NO_PART = len(decode.KINDS)


@dataclass(frozen=True)
class Pool:
    """Images and labels; an image's planes are color, relief (0 where unknown) and lines."""

    faces: UInt8[np.ndarray, "n 6 s s"]
    boxes: Float[np.ndarray, "n p 4"]
    kinds: Int[np.ndarray, "n p"]
    """-1 after the last part of a face."""
    crops: UInt8[np.ndarray, "m 6 t t"]
    aspects: Float[np.ndarray, " m"]
    crop_kinds: Int[np.ndarray, " m"]
    edges: Float[np.ndarray, "m 4"]
    """Edges of the part, as fractions of the crop."""
    handles: Float[np.ndarray, "m 4"]
    """Handles as fractions of the crop; NaN without one."""

    @staticmethod
    def read(folder: Path) -> Pool:
        """Open the files of `fill` as memory maps."""
        names = Pool.__dataclass_fields__
        return Pool(**{n: np.load(folder / f"{n}.npy", mmap_mode="r") for n in names})


def packed(stack: np.ndarray) -> UInt8[np.ndarray, "6 s s"]:
    """Pack the resampled planes of `decode.planes` into bytes."""
    color = np.clip(stack[:3] * 64 + 128, 0, 255)
    share = np.maximum(stack[4], 1e-6)
    relief = np.clip(stack[3] / share, -1, 1) * 127 + 128.5
    code = np.where(stack[4] > 0.5, relief, 0)
    lines = stack[5:] * (255 / SEAM_MOST) + 0.5
    return np.concatenate((color, code[None], lines)).astype(np.uint8)


def unpacked(codes: UInt8[np.ndarray, "n 6 s s"]) -> np.ndarray:
    """Return the inputs of the networks."""
    color = (codes[:, :3].astype(np.float32) - 127.5) / 64
    known = codes[:, 3:4] > 0
    relief = np.where(known, (codes[:, 3:4].astype(np.float32) - 128) / 127, 0)
    lines = codes[:, 4:].astype(np.float32) * (SEAM_MOST / 255)
    return np.concatenate((color, relief, known, lines), axis=1, dtype=np.float32)


def proposals(
    rng: np.random.Generator, drawn: generator.Drawn
) -> tuple[Float[np.ndarray, "n 4"], Int[np.ndarray, " n"]]:
    """Draw right and wrong boxes like those of the first network, and the part of each."""
    parts = np.array([p.box for p in drawn.parts]).reshape(-1, 4)
    wanted: list[np.ndarray] = []
    size = parts[:, 2:] - parts[:, :2]
    for i in rng.permutation(len(parts))[: CROPS - 2]:
        spread = rng.choice([0.02, 0.06, 0.12])
        wanted.append(parts[i] + rng.normal(0, spread, 4).clip(-0.25, 0.25) * np.tile(size[i], 2))
    while len(wanted) < 3 * CROPS:
        wanted.append(_wrong(rng, drawn, parts))
    boxes = np.clip(np.array(wanted), 0, 1)
    boxes = boxes[(boxes[:, 2:] - boxes[:, :2] > 0.025).all(axis=1)]
    if not len(parts):
        return boxes[:3], np.full(3, -1)[: len(boxes)]
    common = decode.overlaps(boxes, parts)[0]
    meant, best = common.argmax(axis=1), common.max(axis=1)
    clear = (best > 0.55) | (best < 0.42)
    meant = np.where(best > 0.55, meant, -1)
    boxes, meant = boxes[clear], meant[clear]
    return boxes[:CROPS], meant[:CROPS]


def _wrong(rng: np.random.Generator, drawn: generator.Drawn, parts: np.ndarray) -> np.ndarray:
    """Draw a wrong proposal: a fixed field, two parts, a piece of a part, or a random box."""
    draw = rng.random()
    if drawn.false_parts and draw < 0.4:
        box = np.array(drawn.false_parts[rng.integers(len(drawn.false_parts))])
        return box + rng.normal(0, 0.02, 4)
    if len(parts) and draw < 0.6:
        box = parts[rng.integers(len(parts))]
        shrink = rng.uniform(0.05, 0.35, 4) * np.tile(box[2:] - box[:2], 2)
        return box + shrink * (1, 1, -1, -1)
    if len(parts) > 1 and draw < 0.75:
        one, two = parts[rng.choice(len(parts), 2, replace=False)]
        return np.concatenate((np.minimum(one[:2], two[:2]), np.maximum(one[2:], two[2:])))
    if len(parts) and draw < 0.85:
        box = parts[rng.integers(len(parts))]
        size = np.tile(box[2:] - box[:2], 2)
        return box + np.tile(rng.uniform(-0.6, 0.6, 2), 2) * size
    if draw < 0.9:
        return np.array([0, 0, 1, 1]) + rng.normal(0, 0.03, 4)
    corner, size = rng.uniform(0, 0.7, 2), rng.uniform(0.08, 0.7, 2)
    return np.concatenate((corner, corner + size))


def _one(task: tuple[generator.Mix, tuple[int, int]]) -> dict[str, np.ndarray]:
    """Draw a face and its crops."""
    mix, seed = task
    rng = np.random.default_rng(seed)
    drawn = generator.draw(rng, mix)
    stack = decode.planes(drawn.face)
    whole = decode.resample(stack, np.array([0.0, 0.0, 1.0, 1.0]), decode.FACE_PIXELS)
    boxes = np.zeros((MOST_PARTS, 4), np.float32)
    kinds = np.full(MOST_PARTS, -1, np.int8)
    for i, part in enumerate(drawn.parts[:MOST_PARTS]):
        boxes[i], kinds[i] = part.box, decode.KINDS.index(part.kind)
    inner, meant = proposals(rng, drawn)
    outer = decode.widened(inner, decode.PART_MARGIN)
    size = outer[:, 2:] - outer[:, :2]
    count = len(outer)
    crops = np.zeros((CROPS, 6, decode.PART_PIXELS, decode.PART_PIXELS), np.uint8)
    aspects = np.zeros(CROPS, np.float32)
    crop_kinds = np.full(CROPS, -1, np.int8)
    edges = np.zeros((CROPS, 4), np.float32)
    handles = np.full((CROPS, 4), np.nan, np.float32)
    aspects[:count] = np.log(size[:, 0] * drawn.face.width / (size[:, 1] * drawn.face.height))
    for i in range(count):
        crops[i] = packed(decode.resample(stack, outer[i], decode.PART_PIXELS))
        crop_kinds[i] = NO_PART
        if meant[i] >= 0:
            part = drawn.parts[meant[i]]
            crop_kinds[i] = decode.KINDS.index(part.kind)
            origin, scale = np.tile(outer[i, :2], 2), np.tile(size[i], 2)
            edges[i] = np.clip((np.array(part.box) - origin) / scale, 0, 1)
            if part.handle is not None:
                handles[i] = (np.array(part.handle) - origin) / scale
    return {
        "faces": packed(whole),
        "boxes": boxes,
        "kinds": kinds,
        "crops": crops,
        "aspects": aspects,
        "crop_kinds": crop_kinds,
        "edges": edges,
        "handles": handles,
    }


def fill(folder: Path, mix: generator.Mix, seed: int, count: int, workers: int) -> None:
    """Draw faces and write them; the same seed gives the same files."""
    folder.mkdir(parents=True, exist_ok=True)
    # Workers read these at start; more threads per worker would compete for the cores.
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    files: dict[str, np.memmap[Any, Any]] = {}
    with mp.get_context("spawn").Pool(workers) as helpers:
        tasks = [(mix, (seed, i)) for i in range(count)]
        for i, one in enumerate(helpers.imap(_one, tasks, chunksize=16)):
            for name, value in one.items():
                many = name in ("crops", "aspects", "crop_kinds", "edges", "handles")
                if name not in files:
                    shape = (
                        (count * len(value), *value.shape[1:]) if many else (count, *value.shape)
                    )
                    files[name] = np.lib.format.open_memmap(
                        folder / f"{name}.npy", "w+", value.dtype, shape
                    )
                at = slice(i * CROPS, (i + 1) * CROPS) if many else i
                files[name][at] = value
    for file in files.values():
        file.flush()
