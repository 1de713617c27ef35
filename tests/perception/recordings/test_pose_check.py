"""Poses are checked against depth: drift is measured, and lost frames are found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.perception.recordings.recorded import shots, write_seven_scenes

from momapos.model.records.scans import Frame
from momapos.perception.recordings.conventions import check_poses
from momapos.perception.recordings.scan_reader import read_scan

K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
LOW, HIGH = np.array([-2.0, -1.5, -1.2]), np.array([2.0, 1.5, 1.2])
"""Corners of the room and of a column in it."""


def looking(angle: float, place: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return a level camera."""
    T = np.eye(4)
    c, s = np.cos(angle), np.sin(angle)
    T[:3, :3] = np.array([[s, 0, c], [-c, 0, s], [0, -1, 0]])
    T[:3, 3] = place
    return T


def room(T: np.ndarray, name: str) -> Frame:
    """Return exact depth of an empty room with a column in each direction."""
    v, u = np.mgrid[:240, :320]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], -1)
    ways = rays @ T[:3, :3].T
    with np.errstate(divide="ignore"):
        depth = np.maximum((LOW - T[:3, 3]) / ways, (HIGH - T[:3, 3]) / ways).min(axis=-1)
        for x, y in ((1.5, 0.3), (-1.4, -0.4), (0.2, 1.2), (-0.3, -1.1)):
            a = (np.array([x, y]) - 0.15 - T[:2, 3]) / ways[..., :2]
            b = (np.array([x, y]) + 0.15 - T[:2, 3]) / ways[..., :2]
            enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
            depth = np.where((enter < leave) & (enter > 0), np.minimum(depth, enter), depth)
    return Frame(name, np.zeros((240, 320, 3), np.uint8), depth.astype(np.float32), K, T)


def displaced(frames: list[Frame], offsets: np.ndarray) -> list[Frame]:
    """Return the frames with offsets in their poses."""
    out = []
    for frame, off in zip(frames, offsets, strict=True):
        T = frame.T_world_camera.copy()
        T[:3, 3] += off
        out.append(replace(frame, T_world_camera=T))
    return out


@pytest.fixture(scope="module")
def rounds() -> list[Frame]:
    """Return two turns on the spot."""
    angles = np.linspace(0, 4 * np.pi, 48, endpoint=False)
    return [
        room(looking(angle, (0.1 * np.cos(angle), 0, 0)), str(k)) for k, angle in enumerate(angles)
    ]


def test_true_poses_agree_with_depth(rounds: list[Frame]) -> None:
    check = check_poses(rounds)
    assert check.neighbors < 2e-3
    assert check.drift < 2e-3
    assert check.lost == ()


@pytest.mark.parametrize("far", [0.05, 0.1])
def test_drift_is_measured_where_a_place_is_seen_again(rounds: list[Frame], far: float) -> None:
    way = np.array([0.6, 0.8, 0.0])
    check = check_poses(displaced(rounds, np.linspace(0, 2 * far, 48)[:, None] * way))
    assert check.neighbors < 0.2 * far
    assert check.drift == pytest.approx(far, rel=0.4)
    assert f"{100 * check.drift:.1f} cm" in check.text()


@pytest.mark.parametrize("off", [(0.12, -0.1, 0.0), (0.3, 0.4, 0.0), (0.0, -0.25, 0.1)])
def test_only_the_frame_with_a_wrong_pose_is_found(rounds: list[Frame], off) -> None:
    offsets = np.zeros((48, 3))
    offsets[17] = off
    check = check_poses(displaced(rounds, offsets))
    assert check.lost == (17,)


def test_drift_is_unknown_without_a_second_visit(rounds: list[Frame]) -> None:
    check = check_poses(rounds[:12])
    assert check.drift is None
    assert "drift is unknown" in check.text()
    assert check_poses(rounds[:1]) is None
    assert check_poses([replace(frame, depth=None) for frame in rounds]) is None


def test_a_scan_reports_the_pose_check_and_drops_lost_frames(rounds: list[Frame], tmp_path) -> None:
    offsets = np.linspace(0, 0.2, 48)[:, None] * [0.6, 0.8, 0.0]
    offsets[17] += [0.15, -0.12, 0.0]
    taken = shots(48)
    folder = write_seven_scenes(tmp_path / "scan", taken)
    from PIL import Image

    for k, frame in enumerate(displaced(rounds, offsets)):
        stem = folder / f"frame-{k:06d}"
        Image.fromarray(frame.color).save(f"{stem}.color.png")
        Image.fromarray(np.rint(1000 * frame.depth).astype(np.uint16)).save(f"{stem}.depth.png")
        np.savetxt(f"{stem}.pose.txt", frame.T_world_camera)
    np.savetxt(folder / "camera-intrinsics.txt", K)
    scan = read_scan(folder)
    assert "frame-000017" not in [frame.name for frame in scan.frames]
    assert len(scan.frames) == 47
    assert any("dropped 1 of 48 frames" in line for line in scan.warnings)
    assert any("drifted" in line for line in scan.warnings)
    assert len(scan.notes) == 1
