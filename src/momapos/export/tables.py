"""Plans as tables: CSV for people and spreadsheets, NPZ for programs."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from momapos.cache import write_atomic
from momapos.export.phases import Phase, samples_of
from momapos.types import PlacementPlan

BASE = ("base_x", "base_y", "base_yaw")


def write_csv(plan: PlacementPlan, phases: tuple[Phase, ...], path: Path) -> None:
    """Write a line a sample: time, phase, base pose, joints, their velocities, the object's joint.

    Units are s, m and rad.
    """
    samples = samples_of(phases)
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    velocities = [f"{name}_velocity" for name in plan.joints]
    rows.writerow(["time", "phase", *BASE, *plan.joints, *velocities, "object_q"])
    numbers = np.column_stack(
        [samples.base, samples.positions, samples.velocities, samples.object_q]
    )
    for time, index, row in zip(samples.times, samples.phase, numbers, strict=True):
        words = [f"{value:.9g}" for value in row.tolist()]
        rows.writerow([f"{time:.9g}", f"{index}_{phases[index].kind}", *words])
    write_atomic(path, text.getvalue().encode())


def write_npz(plan: PlacementPlan, phases: tuple[Phase, ...], path: Path) -> None:
    """Write the samples as arrays: times, base, positions, velocities, object_q, phase, names."""
    samples = samples_of(phases)
    content = io.BytesIO()
    np.savez_compressed(
        content, times=samples.times, base=samples.base, positions=samples.positions,
        velocities=samples.velocities, object_q=samples.object_q, phase=samples.phase,
        phases=np.array([str(phase.kind) for phase in phases]), joints=np.array(plan.joints),
    )  # fmt: skip
    write_atomic(path, content.getvalue())
