"""Small recordings for tests of the readers, written in each layout."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT = 32, 24
K = np.array([[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]])


@dataclass(frozen=True, eq=False)
class Shot:
    """One frame as it was taken; depth in whole millimeters."""

    color: np.ndarray
    depth: np.ndarray
    T_world_camera: np.ndarray


def shots(count: int, seed: int = 0) -> list[Shot]:
    """Frames of a room that is between 2.5 and 4 m away, with a hole in each depth image."""
    rng = np.random.default_rng(seed)
    taken = []
    for _ in range(count):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        T[:3, 3] = rng.normal(size=3)
        depth = rng.integers(2500, 4000, (HEIGHT, WIDTH)).astype(np.uint16)
        depth[:3, :3] = 0
        taken.append(Shot(rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8), depth, T))
    return taken


def write_seven_scenes(folder: Path, taken: list[Shot], intrinsics: bool = True) -> Path:
    """Write frames as 7-Scenes and 3DMatch do."""
    folder.mkdir(parents=True, exist_ok=True)
    if intrinsics:
        np.savetxt(folder / "camera-intrinsics.txt", K)
    for i, shot in enumerate(taken):
        stem = folder / f"frame-{i:06d}"
        Image.fromarray(shot.color).save(f"{stem}.color.png")
        Image.fromarray(shot.depth).save(f"{stem}.depth.png")
        np.savetxt(f"{stem}.pose.txt", shot.T_world_camera)
    return folder


def write_export(folder: Path, taken: list[Shot], matrices: dict[str, np.ndarray]) -> Path:
    """Write frames as the ScanNet export and OpenMask3D do."""
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir(parents=True)
    for name, matrix in matrices.items():
        padded = np.eye(4)
        padded[:3, :3] = matrix
        np.savetxt(folder / "intrinsic" / name, padded)
    for i, shot in enumerate(taken):
        Image.fromarray(shot.color).save(folder / "color" / f"{i}.png")
        Image.fromarray(shot.depth).save(folder / "depth" / f"{i}.png")
        np.savetxt(folder / "pose" / f"{i}.txt", shot.T_world_camera)
    return folder


def write_ply(path: Path, points: np.ndarray) -> Path:
    """Write bare points as text."""
    header = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    header += "property float x\nproperty float y\nproperty float z\nend_header\n"
    path.write_text(header + "".join(f"{x} {y} {z}\n" for x, y, z in points))
    return path
