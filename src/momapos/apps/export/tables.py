"""Write a timeline as a table: CSV or NPZ."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import write_atomic

from .timeline import Timeline

if TYPE_CHECKING:
    from jaxtyping import Float

BASE = ("base_x", "base_y", "base_yaw")
OBJECT = tuple(f"object_{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz"))


def write_csv(timeline: Timeline, path: Path) -> None:
    """Write one line per sample: time, phase, base pose, joint positions and velocities, object_q.

    If a latch is turned, its value follows as latch_q; for a movable object, its pose: position and
    quaternion. Units are s, m and rad.
    """
    samples, names = timeline.samples, timeline.joints
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    velocities = [f"{name}_velocity" for name in names]
    columns = [samples.base, samples.positions, samples.velocities, samples.object_q]
    header = ["time", "phase", *BASE, *names, *velocities, "object_q"]
    if timeline.latch:
        header.append("latch_q")
        columns.append(samples.latch_q)
    if timeline.Ts_world_object is not None:
        header += OBJECT
        columns.append(_poses(timeline.Ts_world_object))
    rows.writerow(header)
    numbers = np.column_stack(columns)
    for time, index, row in zip(samples.times, samples.phase, numbers, strict=True):
        values = [f"{value:.9g}" for value in row.tolist()]
        rows.writerow([f"{time:.9g}", f"{index}_{timeline.stages[index]}", *values])
    write_atomic(path, text.getvalue().encode())


def write_npz(timeline: Timeline, path: Path) -> None:
    """Write the samples as arrays: times, base, positions, velocities, object_q, phase, names.

    If a latch is turned, `latch_q` contains its values. For a movable object, `object_poses`
    contains x, y, z and the quaternion wxyz.
    """
    samples, content = timeline.samples, io.BytesIO()
    extra: dict[str, Any] = {"latch_q": samples.latch_q} if timeline.latch else {}
    if timeline.Ts_world_object is not None:
        extra["object_poses"] = _poses(timeline.Ts_world_object)
    np.savez_compressed(
        content, times=samples.times, base=samples.base, positions=samples.positions,
        velocities=samples.velocities, object_q=samples.object_q, phase=samples.phase,
        phases=np.array(timeline.stages), joints=np.array(timeline.joints), **extra,
    )  # fmt: skip
    write_atomic(path, content.getvalue())


def _poses(Ts: Float[np.ndarray, "t 4 4"]) -> Float[np.ndarray, "t 7"]:
    """Return x, y, z [m] and the quaternion wxyz."""
    quaternions = Rotation.from_matrix(Ts[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    return np.concatenate([Ts[:, :3, 3], quaternions], axis=1)
