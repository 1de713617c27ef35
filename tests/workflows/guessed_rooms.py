"""Rooms with a cupboard whose part may move in several ways."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from momapos.core.geometry.polygons import UprightBox
from momapos.model.records.scans import Detection, FaceImage, Part, PartKind
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.perception.reconstruction.model_config import ModelConfig
from momapos.perception.reconstruction.object_model import furniture_model
from momapos.perception.reconstruction.scene_builder import build_scene

Odds = tuple[tuple[PartKind, float], ...]
MIDDLE = (0.6, 0.4, 0.66, 0.6)
BLOCKS_TWO, BLOCKS_ONE = 0.87, 0.75


def room(
    folder: Path,
    odds: Odds,
    handle: tuple[float, float, float, float] = MIDDLE,
    *,
    post: float | None = None,
    turn: float = np.pi / 2,
) -> Scene:
    """Build a cupboard with one part and several hypotheses of its joint.

    A post at x [m] is in the way: at `BLOCKS_TWO` of a drawer and of a door hinged at the right, at
    `BLOCKS_ONE` only of such a door. A hinged part turns by at most `turn` [rad].
    """
    pixels = (240, 240)
    color = np.full((*pixels, 3), 200, np.uint8)
    face = FaceImage(color, np.full(pixels, np.nan, np.float32), 0.6, 0.6)
    part = Part(odds[0][0], (0.0, 0.0, 1.0, 1.0), 0.9, handle, odds)
    box = UprightBox(np.array([1.5, 0.0, 0.8]), np.array([0.6, 0.5, 0.6]), -np.pi / 2)
    found = Detection("cupboard", "cabinet", 0.9, box, np.arange(3))
    piece = furniture_model(
        found, np.pi, face, [part], ModelConfig(turn=turn), neighbors=(None, None)
    )
    floor = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)]
    box = UprightBox(np.array([post or 0.0, -0.21, 0.75]), np.array([0.04, 0.04, 1.5]), 0.0)
    posts = [Detection("post", "post", 0.9, box, np.arange(3))]
    folder.mkdir()
    out = folder / "scene.json"
    posts = [] if post is None else posts
    build_scene([found, *posts], {"cupboard": piece}, floor, out, start=(0.0, 0.0, 0.0))
    return load_scene(out)
