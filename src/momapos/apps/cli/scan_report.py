"""Write the report on a scan: what was modeled, how and why."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import write_file
from momapos.model.records import Scan
from momapos.model.scene import load_scene
from momapos.perception import Decision, Modeled

FORMAT, VERSION = "momapos-scan-report", 1
NAME = "scan_report.json"


def report_to_dict(result: Modeled, scan: Scan, target: str | None) -> dict[str, Any]:
    """Return the report as plain values; lengths in [m], angles in [deg]."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "scan": scan.name,
        "scene": str(result.scene),
        "frames": len(scan.frames),
        "points": len(result.cloud.points),
        "warnings": [*scan.warnings, *result.warnings],
        "notes": list(scan.notes),
        "T_scene_scan": result.T_scene_scan.tolist(),
        "target": target,
        "objects": [_decision(d, result) for d in result.decisions],
        "timing": {name: round(value, 4) for name, value in result.timing.items()},
    }


def _decision(decision: Decision, result: Modeled) -> dict[str, Any]:
    item, view = decision.detection, decision.view
    data: dict[str, Any] = {
        "name": item.name,
        "label": item.label,
        "label_from": item.label_from,
        "score": round(item.score, 3),
        "seen": None if item.seen is None else round(item.seen, 3),
        "completed": round(item.completed, 3),
        "points": len(item.members),
        "center": np.round(item.box.center, 4).tolist(),
        "size": np.round(item.box.size, 4).tolist(),
        "yaw": round(float(np.degrees(item.box.yaw)), 2),
        "importance": decision.importance,
        "modelled": decision.model is not None,
        "source": decision.source,
        "reason": decision.reason or None,
        "warnings": list(decision.warnings),
        "seconds": round(decision.seconds, 3),
        "view": None,
        "parts": [asdict(part) for part in decision.parts],
    }
    if view is not None:
        data["view"] = {
            "frame": result.frames[view.frame].name,
            "face": view.face.index,
            "angle": round(float(np.degrees(view.angle)), 2),
            "front": round(view.front.score, 3),
            "evidence": [None if np.isnan(v) else round(v, 3) for v in view.evidence],
        }
    return data


def outputs_of(out: Path, *, pictures: bool) -> tuple[list[Path], list[Path]]:
    """Return the output files and folders of a scan, including the scene file."""
    folders = [out.parent / f"{out.stem}_urdf"] + ([_pictures_folder(out)] if pictures else [])
    return [out, out.parent / NAME], folders


def _pictures_folder(out: Path) -> Path:
    return out.parent / f"{out.stem}_pictures"


def write_report(
    result: Modeled, data: dict[str, Any], out: Path, *, pictures: bool
) -> Path | None:
    """Write `scan_report.json` next to the scene, and images of the room and of each object.

    Returns:
        The folder of the images; None without images.
    """
    write_file(out.parent / NAME, json.dumps(data, indent=1, allow_nan=False) + "\n")
    if not pictures:
        return None
    from momapos.apps.plots import draw_modeled, draw_overviews

    folder = _pictures_folder(out)
    folder.mkdir(exist_ok=True)
    draw_overviews(result, folder)
    scene = load_scene(str(out))
    for decision in result.decisions:
        if decision.view is None:
            continue
        item = decision.detection
        caption = f"{item.name}: {decision.reason or decision.source}"
        draw_modeled(
            item, decision.view, result.frames, result.cloud, scene.object(item.name), caption,
            folder / f"{item.name}.png",
        )  # fmt: skip
    return folder
