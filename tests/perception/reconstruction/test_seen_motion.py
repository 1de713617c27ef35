"""Parts that were opened between two scans of a room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.core.geometry.transforms import apply, invert, pose, rotation_about
from momapos.core.geometry.upright_boxes import UprightBox
from momapos.model.records.scans import Cloud, Detection, FaceImage, Part, PartKind
from momapos.model.scene.library.box_furniture import JointMotion, Piece, part_poses
from momapos.perception.reconstruction.object_model import furniture_model
from momapos.perception.reconstruction.seen_motion import (
    AXES,
    SAME_SURFACE,
    moved_piece,
)

UP = np.array([0.0, 0.0, 1.0])
EDGES = {
    "door_left": (-0.29, -0.24, 0.0), "door_right": (0.29, -0.24, 0.0),
    "door_down": (0.0, -0.24, -0.39), "door_up": (0.0, -0.24, 0.39), "drawer": (0.0, 0.0, 0.0),
}  # fmt: skip
"""True positions of the axes, in the frame of the piece [m]."""


def cupboard(kind: PartKind) -> Piece:
    """Return a cupboard whose only part has an assumed kind."""
    pixels = (320, 240)
    color = np.full((*pixels, 3), 200, np.uint8)
    face = FaceImage(color, np.zeros(pixels, np.float32), 0.6, 0.8)
    box = UprightBox(np.array([1.5, -0.4, 0.5]), np.array([0.6, 0.5, 0.8]), 0.7)
    found = Detection("cupboard", "cabinet", 0.9, box, np.arange(3))
    part = Part(kind, (0.0, 0.0, 1.0, 1.0), 0.9)
    return furniture_model(found, 0.7 - np.pi / 2, face, [part], neighbors=(None, None))


def sheet(
    across: tuple[float, float], up: tuple[float, float], y: float, side: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return points every 1.5 cm on an upright sheet facing along y, and their normals."""
    x, z = np.meshgrid(np.arange(*across, 0.015), np.arange(*up, 0.015))
    points = np.stack([x.ravel(), np.full(x.size, y), z.ravel()], axis=1)
    return points, np.tile([0.0, side, 0.0], (len(points), 1))


def clouds(piece: Piece, kind: PartKind, value: float, *, inside: bool) -> tuple[Cloud, Cloud]:
    """Return the room with the part closed, and moved; with a wall behind and a frame around it."""
    T_world_piece = pose(piece.xyz, rotation_about(UP, np.array(piece.yaw)))
    width, height = (-0.3, 0.3), (-0.4, 0.4)
    still = [sheet((-1.5, 1.5), (-0.5, 1.0), 0.26, -1.0), sheet(width, height, 0.2, -1.0)]
    still.append(sheet((0.32, 0.9), height, -0.25, -1.0))
    fronts = [sheet(width, height, -0.25, -1.0)]
    if inside:
        fronts.append(sheet(width, height, -0.23, 1.0))
    motion = JointMotion(
        "prismatic" if kind == "drawer" else "revolute", EDGES[kind], AXES[kind], 2.0
    )
    part = replace(piece.parts[1], motion=motion)
    T = invert(T_world_piece) @ part_poses(piece, part, np.array([value]))[0]
    moved = [(apply(T, p), n @ T[:3, :3].T) for p, n in fronts]
    rng = np.random.default_rng(0)

    def cloud(sheets: list[tuple[np.ndarray, np.ndarray]]) -> Cloud:
        points, normals = (np.concatenate(both) for both in zip(*sheets, strict=True))
        points = apply(T_world_piece, points) + rng.normal(0.0, 2e-3, points.shape)
        return Cloud(points, normals @ T_world_piece[:3, :3].T, np.zeros(points.shape, np.uint8))

    seen = moved[1:] if inside else moved  # of a part seen from inside only that
    return cloud([*still, fronts[0]]), cloud([*still, *seen])


@pytest.mark.parametrize("taken", ["door_left", "drawer"])
@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("door_left", 1.0),
        ("door_right", 0.5),
        ("door_down", 1.2),
        ("door_up", 0.8),
        ("drawer", 0.2),
    ],
)
def test_an_opened_part_gets_the_observed_joint(
    kind: PartKind, value: float, taken: PartKind
) -> None:
    piece = cupboard(taken)
    found, seen = moved_piece(piece, *clouds(piece, kind, value, inside=False))
    ((_, one),) = seen.items()
    assert one.kind == kind
    assert one.value == pytest.approx(value, abs=0.02)
    (part,) = found.parts[1:]
    assert part.value == one.value
    assert part.motion is not None
    assert part.motion.upper >= one.value
    assert [(way.kind, way.probability) for way in part.hypotheses] == [(kind, 1.0)]
    np.testing.assert_allclose(part.motion.axis, AXES[kind])
    off = (np.array(part.motion.pivot) - EDGES[kind]) * (1.0 - np.abs(AXES[kind]))
    assert np.linalg.norm(off) < (0.02 if kind != "drawer" else 1e-9)


def test_the_angle_of_a_flap_is_found_from_its_inside_alone() -> None:
    piece = cupboard("door_down")
    found, seen = moved_piece(piece, *clouds(piece, "door_down", 1.3, inside=True))
    assert seen["door"].kind == "door_down"
    assert seen["door"].value == pytest.approx(1.3, abs=0.03)
    (old,), (new,) = piece.parts[1:], found.parts[1:]
    assert old.motion is not None
    assert new.motion is not None
    assert new.motion.pivot == old.motion.pivot


def test_a_part_that_did_not_move_stays_unchanged() -> None:
    piece = cupboard("door_left")
    before, _ = clouds(piece, "door_left", 0.5, inside=False)
    found, seen = moved_piece(piece, before, before)
    assert (found.parts, seen) == (piece.parts, {})


def test_a_front_that_the_second_scan_does_not_show_stays_unchanged() -> None:
    piece = cupboard("door_left")
    before, after = clouds(piece, "door_left", 1.0, inside=False)
    local = apply(invert(pose(piece.xyz, rotation_about(UP, np.array(piece.yaw)))), after.points)
    shown = local[:, 1] > SAME_SURFACE - 0.1
    gone = Cloud(after.points[shown], after.normals[shown], after.colors[shown])
    assert moved_piece(piece, before, gone)[1] == {}
