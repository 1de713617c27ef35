"""Compare the labels of objects in a real kitchen with a list made by a person.

    python benchmarks/labels.py SHARED [--detector FILE]

SHARED is the folder of redkitchen/ and models/. A pixel of the depth image identifies each listed
object (the color image is shifted by about 20 pixels). Its label is right if the box found there
has one of the listed names, not named if it is "object", and wrong otherwise. The images show no
appliances, so every object labeled as one is counted.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

from momapos.core import InputError
from momapos.model.records import Detection
from momapos.perception import Survey, default_tools, survey
from momapos.perception.detection import YoloxDetector
from momapos.perception.recordings import read_scan
from momapos.perception.segmentation import PixelOf, pointed_at

THINGS: tuple[tuple[str, str, tuple[int, int, int], tuple[str, ...]], ...] = (
    ("dining table", "table", (0, 454, 300), ("table",)),
    ("chair at the table's left end", "chair", (0, 241, 140), ("chair",)),
    ("chair before the cabinets", "chair", (280, 340, 272), ("chair",)),
    ("chair before the shelf", "chair", (340, 529, 186), ("chair",)),
    ("chair at the right end, its back", "chair", (400, 600, 290), ("chair",)),
    ("chair nearest to the camera, its back", "chair", (20, 441, 440), ("chair",)),
    ("white mug", "cup", (0, 383, 184), ("cup",)),
    ("patterned mug", "cup", (280, 570, 350), ("cup",)),
    ("left screen", "screen", (460, 410, 60), ("screen",)),
    ("right screen", "screen", (460, 587, 134), ("screen",)),
    ("magazines on the table", "other", (0, 450, 210), ("book",)),
    ("lunch box", "other", (360, 423, 265), ("box", "bowl")),
    ("wooden case on the worktop", "other", (140, 353, 88), ("box",)),
    ("books on the red shelf", "other", (280, 413, 128), ("book", "shelf")),
    ("base cabinets, left row", "other", (160, 330, 270), ("cabinet",)),
    ("base cabinets, back row", "other", (740, 330, 250), ("cabinet",)),
)
"""Description, group, image number and pixel, and correct names."""
APPLIANCES = {"fridge", "oven", "microwave", "dishwasher", "range hood", "toaster"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shared", type=Path)
    parser.add_argument("--detector", type=Path)
    args = parser.parse_args()
    file = args.detector or args.shared / "models" / "yolox_nano.onnx"
    for title, detector in (("by size", None), (f"by {file.stem}", YoloxDetector(file))):
        start = time.process_time()
        scan = read_scan(args.shared / "redkitchen")
        seen = survey(scan, replace(default_tools(), detect=detector))
        seconds = time.process_time() - start
        print(f"\n{title}: {len(scan.frames)} images to boxes in {seconds:.1f} s of processor time")
        print("   ", ", ".join(f"{name} {value:.1f}" for name, value in seen.timing.items()))
        report(seen)


def report(seen: Survey) -> None:
    """Print each listed object, the counts by group, and objects labeled as appliances."""
    counts: dict[str, Counter[str]] = {}
    for name, group, (number, u, v), labels in THINGS:
        item = found(seen, PixelOf(f"frame-{number:06d}", u, v))
        verdict = judged(item, labels)
        counts.setdefault(group, Counter())[verdict] += 1
        text = "nothing" if item is None else f"{item.name} ({item.label_from}, {item.score:.2f})"
        print(f"    {name:<40} {verdict:<10} {text}")
    for group, count in counts.items():
        print(f"    {group:<8} {', '.join(f'{n} {verdict}' for verdict, n in count.items())}")
    called = [item.name for item in seen.detections if item.label in APPLIANCES]
    print(f"    labeled as an appliance: {', '.join(called) or 'none'}")


def found(seen: Survey, where: PixelOf) -> Detection | None:
    """Return the detection at a pixel."""
    try:
        return pointed_at(where, seen.detections, seen.frames)
    except InputError:
        return None


def judged(item: Detection | None, labels: tuple[str, ...]) -> str:
    """Return whether a detection has one of the correct names."""
    if item is None:
        return "not found"
    return "right" if item.label in labels else "not named" if item.label == "object" else "wrong"


if __name__ == "__main__":
    main()
