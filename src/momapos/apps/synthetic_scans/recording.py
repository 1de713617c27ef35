"""Render scans of scenes into a folder of posed frames with the ground truth."""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import InputError, SceneError, require, temporary_folder
from momapos.core.geometry import UprightBox, pose, upright_frame
from momapos.model.records import Frame
from momapos.model.scene import Scene, SceneObject

from .depth_sensor import DepthSensor, drifting, sense
from .renderer import RenderWorld, pinhole, render_frame, render_world
from .route import scan_route

if TYPE_CHECKING:
    from jaxtyping import Float

FORMAT, VERSION = "momapos-scan-truth", 1
SIZE = (640, 480)
FOCALS = (525.0, 600.0)
"""Range of focal lengths [px]; each scan draws one."""
MAX_FRAMES = 10_000


@dataclass(frozen=True, eq=False)
class SyntheticScan:
    """A scan to render, with its ground truth."""

    scene: Scene
    world: RenderWorld
    intrinsics: Float[np.ndarray, "3 3"]
    Ts_world_camera: Float[np.ndarray, "n 4 4"]
    """True poses in the scene's world."""
    Ts_scan_camera: Float[np.ndarray, "n 4 4"]
    """Estimated poses in the scan's world."""
    T_scan_scene: Float[np.ndarray, "4 4"]
    """From the scene's world to the scan's; identity unless tilted."""
    sensor: DepthSensor | None
    """Errors of the camera; None for perfect frames."""
    seed: int

    def frame(self, index: int) -> Frame:
        """Render one frame with its pose in the scan's world; repeated calls return the same."""
        name = f"frame-{index:06d}"
        exact = render_frame(self.world, self.Ts_world_camera[index], self.intrinsics, SIZE, name)
        if self.sensor is not None:
            exact = sense(exact, np.random.default_rng((self.seed, 2, index)), self.sensor)
        return replace(exact, T_world_camera=self.Ts_scan_camera[index])

    def frames(self) -> Iterator[Frame]:
        """Render all frames in order, in parallel."""
        with _pool() as pool:
            yield from pool.map(self.frame, range(len(self.Ts_scan_camera)))


def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, min(4, os.cpu_count() or 1)))


def synthetic_scan(
    scene: Scene,
    *,
    frames: int = 60,
    seed: int = 0,
    sensor: DepthSensor | None = None,
    tilt: bool = False,
) -> SyntheticScan:
    """Plan a scan of a scene.

    Args:
        scene: The room.
        frames: Number of images.
        seed: Seed of materials, route and noise.
        sensor: Errors of the camera; None for perfect frames.
        tilt: Rotate the world of the scan at random, so that its z axis is not up.

    Raises:
        InputError: The number of frames or the seed is out of range.
        SceneError: There is no free floor for the camera.
        UrdfError: A mesh can't be read.
    """
    if not 1 <= frames <= MAX_FRAMES:
        raise InputError(f"frames must be between 1 and {MAX_FRAMES}, not {frames}")
    if seed < 0:
        raise InputError(f"seed must be at least 0, not {seed}")
    # The name makes rooms with equal seeds look different.
    rng = np.random.default_rng((seed, 1, zlib.crc32(scene.name.encode())))
    world = render_world(scene, rng)
    focal = round(float(rng.uniform(*FOCALS)), 1)
    Ts = scan_route(scene, world, frames, rng, focal=focal, size=SIZE)
    estimated = Ts if sensor is None else drifting(Ts, rng, sensor)
    T = pose((0, 0, 0), Rotation.random(rng=rng).as_matrix()) if tilt else np.eye(4)
    return SyntheticScan(scene, world, pinhole(SIZE, focal), Ts, T @ estimated, T, sensor, seed)


def truth(scan: SyntheticScan) -> dict[str, Any]:
    """Return the ground truth as plain values [m], [rad], with boxes in the scene's world."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "scene": None if scan.scene.path is None else str(scan.scene.path),
        "T_scan_scene": scan.T_scan_scene.tolist(),
        "objects": [_true_object(scan, k) for k in range(len(scan.scene.objects))],
    }


def true_box(world: RenderWorld, item: SceneObject, number: int) -> UprightBox:
    """Return the upright box around an object's triangles, with the object's yaw."""
    R = upright_frame(item.T_world_object[:3, :3])
    local = world.triangles[world.owner == number].reshape(-1, 3) @ R
    if not len(local):
        return UprightBox(item.T_world_object[:3, 3].copy(), np.zeros(3))
    low, high = local.min(0), local.max(0)
    return UprightBox(R @ ((low + high) / 2), high - low, float(np.arctan2(R[1, 0], R[0, 0])))


def _true_object(scan: SyntheticScan, number: int) -> dict[str, Any]:
    item = scan.scene.objects[number]
    box = true_box(scan.world, item, number)
    values = item.values()
    joints = {
        name: {
            "kind": joint.kind,
            "value": values[name],
            "lower": joint.lower if np.isfinite(joint.lower) else None,
            "upper": joint.upper if np.isfinite(joint.upper) else None,
        }
        for name, joint in item.model.joints.items()
    }
    return {
        "name": item.name,
        "category": item.category,
        "center": box.center.tolist(),
        "size": box.size.tolist(),
        "yaw": box.yaw,
        "joints": joints,
    }


def refuse_used(folder: Path) -> None:
    """Check that a scan can be written to a folder.

    Raises:
        SceneError: The folder is not empty, or is a file.
    """
    try:
        if folder.is_dir():
            if any(folder.iterdir()):
                raise SceneError(f"{folder}: is not empty; choose a new folder for the scan")
        elif folder.exists():
            raise SceneError(f"{folder}: is a file; choose a new folder for the scan")
    except OSError as error:
        raise SceneError(f"{folder}: cannot be looked up ({error.strerror})") from error


def write_scan(
    scan: SyntheticScan, folder: Path, report: Callable[[float], None] = lambda _: None
) -> None:
    """Render a scan into a folder in the layout of 7-Scenes; write all of it or nothing.

    Args:
        scan: The scan.
        folder: A new or empty folder.
        report: Called with the finished share.

    Raises:
        SceneError: The folder is not empty or can't be written.
        MissingExtraError: Pillow is not installed.
    """
    with require("scan"):
        import PIL.Image  # noqa: F401 - fails before anything is rendered
    refuse_used(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(folder.parent, folder.name) as partial:
            np.savetxt(partial / "camera-intrinsics.txt", scan.intrinsics)
            (partial / "truth.json").write_text(json.dumps(truth(scan), indent=1) + "\n")
            with _pool() as pool:
                jobs = range(len(scan.Ts_scan_camera))
                written = pool.map(lambda k: _write(scan.frame(k), partial), jobs)
                for done, _ in enumerate(written, 1):
                    report(done / len(jobs))
            os.replace(partial, folder)
    except OSError as error:
        raise SceneError(f"{folder}: cannot be written ({error.strerror})") from error


def _write(frame: Frame, folder: Path) -> None:
    from PIL import Image

    assert frame.depth is not None
    millimeters = np.clip(np.rint(1000 * frame.depth), 0, 65535).astype(np.uint16)
    stem = folder / frame.name
    Image.fromarray(frame.color).save(f"{stem}.color.jpg", quality=95)
    Image.fromarray(millimeters).save(f"{stem}.depth.png", compress_level=3)
    np.savetxt(f"{stem}.pose.txt", frame.T_world_camera)
