"""Small recordings for tests of the readers, written in each layout."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT = 32, 24
K = np.array([[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]])


@dataclass(frozen=True, eq=False)
class Shot:
    """One frame; depth in whole millimeters."""

    color: np.ndarray
    depth: np.ndarray
    T_world_camera: np.ndarray


def shots(count: int, seed: int = 0) -> list[Shot]:
    """Return frames of a room at 2.5 to 4 m, with a hole in each depth image."""
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


def write_tum(folder: Path, taken: list[Shot], *, late: float = 0.004, every: float = 0.1) -> Path:
    """Write frames as TUM RGB-D does; depth is taken a little later than color."""
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    np.savetxt(folder / "camera-intrinsics.txt", K)
    lists = {"rgb": ["# color images"], "depth": ["# depth maps"]}
    poses = ["# timestamp tx ty tz qx qy qz qw"]
    for i, shot in enumerate(taken):
        time = 1305031102.0 + every * i
        for name, at, image in (
            ("rgb", time, shot.color), ("depth", time + late, shot.depth * np.uint16(5)),
        ):  # fmt: skip
            Image.fromarray(image).save(folder / name / f"{at:.6f}.png")
            lists[name].append(f"{at:.6f} {name}/{at:.6f}.png")
        values = [*shot.T_world_camera[:3, 3], *_quaternion(shot.T_world_camera)]
        # Poses have other times: one before the image and one after it.
        for at in (time + late - 0.01, time + late + 0.01):
            poses.append(f"{at:.6f} " + " ".join(f"{v:.9f}" for v in values))
    for name, rows in (*lists.items(), ("groundtruth", poses)):
        (folder / f"{name}.txt").write_text("\n".join(rows) + "\n")
    return folder


def _quaternion(T: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(T[:3, :3]).as_quat()


def write_open3d(folder: Path, taken: list[Shot], *, color: str = "color") -> Path:
    """Write frames as Open3D does: images in the order of their names, one trajectory."""
    for name in (color, "depth"):
        (folder / name).mkdir(parents=True)
    rows = []
    for i, shot in enumerate(taken):
        Image.fromarray(shot.color).save(folder / color / f"{i:05d}.png")
        Image.fromarray(shot.depth).save(folder / "depth" / f"{i:05d}.png")
        rows.append(f"{i} {i} {i + 1}")
        rows += [" ".join(f"{v:.12e}" for v in row) for row in shot.T_world_camera]
    (folder / "trajectory.log").write_text("\n".join(rows) + "\n")
    camera = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": K.T.ravel().tolist()}
    (folder / "camera_intrinsic.json").write_text(json.dumps(camera))
    return folder


def write_ply(path: Path, points: np.ndarray) -> Path:
    """Write bare points as text."""
    header = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    header += "property float x\nproperty float y\nproperty float z\nend_header\n"
    path.write_text(header + "".join(f"{x} {y} {z}\n" for x, y, z in points))
    return path
