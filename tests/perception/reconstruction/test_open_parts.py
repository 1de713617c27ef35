"""Parts that stand open in the only scan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.core.geometry.upright_boxes import UprightBox
from momapos.model.records.open_leaf import OpenLeaf
from momapos.model.records.scans import Detection, FaceImage, Part, PartKind
from momapos.model.scene.library.box_furniture import Piece
from momapos.perception.reconstruction.object_model import furniture_model
from momapos.perception.reconstruction.open_parts import opened_piece


def cupboard(kind: PartKind) -> Piece:
    """Return a cupboard of 0.6 x 0.5 x 0.8 m with two parts, its front toward -y."""
    face = FaceImage(
        np.full((320, 240, 3), 200, np.uint8), np.zeros((320, 240), np.float32), 0.6, 0.8
    )
    box = UprightBox(np.array([0.3, 0.25, 0.4]), np.array([0.6, 0.5, 0.8]), 0.0)
    found = Detection("cupboard", "cabinet", 0.9, box, np.arange(3))
    parts = [
        Part(kind, (0.0, 0.0, 0.5, 1.0), 0.9, odds=((kind, 0.9), ("drawer", 0.1))),
        Part("door_right", (0.5, 0.0, 1.0, 1.0), 0.9),
    ]
    return furniture_model(found, -np.pi / 2, face, parts)


def left_leaf(value: float) -> OpenLeaf:
    """Return the left leaf, its axis 1 cm behind the front."""
    along, out = np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0])
    pivot = np.array([0.0, 0.01, 0.0])
    return OpenLeaf(np.zeros(3), along, out, (0.3, 0.8), pivot, value, 0.02)


@pytest.mark.parametrize("kind", ["door_left", "door_right", "drawer"])
def test_an_open_part_gets_the_joint_and_angle_of_its_leaf(
    kind: PartKind,
) -> None:
    piece = cupboard(kind)
    opened, seen = opened_piece(piece, [left_leaf(1.9)])
    ((name, one),) = seen.items()
    before = {part.name: part for part in piece.parts}
    after = {part.name: part for part in opened.parts}
    assert after[name].boxes[0].high[0] <= 0.0
    assert one.kind == "door_left"
    motion = after[name].motion
    assert motion is not None
    assert motion.kind == "revolute"
    np.testing.assert_allclose(motion.axis, (0.0, 0.0, -1.0), atol=1e-9)
    np.testing.assert_allclose(motion.pivot[:2], (-0.3, -0.24), atol=1e-6)
    assert motion.upper >= after[name].value == 1.9
    assert [(way.kind, way.probability) for way in after[name].hypotheses] == [("door_left", 1.0)]
    others = set(before) - {name}
    assert all(after[other] == before[other] for other in others)


def test_a_leaf_of_another_piece_opens_nothing() -> None:
    piece = cupboard("door_left")
    far = replace(left_leaf(1.0), corner=np.array([2.0, 0.0, 0.0]))
    behind = replace(left_leaf(1.0), corner=np.array([0.0, 0.6, 0.0]))
    assert opened_piece(piece, [far, behind]) == (piece, {})
