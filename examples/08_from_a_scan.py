"""Scan a kitchen, turn the scan into a scene, and plan to open its fridge."""

import tempfile
from pathlib import Path

from momapos import load_robot, load_scene, make_task, openable, plan_base_placement, scan_to_scene
from momapos.apps.synthetic_scans.depth_sensor import DepthSensor
from momapos.apps.synthetic_scans.recording import synthetic_scan
from momapos.model.records.scans import Scan

camera = synthetic_scan(load_scene("kitchen_small"), frames=60, seed=0, sensor=DepthSensor())
scan = Scan("kitchen", tuple(camera.frames()))  # momapos.read_scan reads yours from a folder

with tempfile.TemporaryDirectory() as folder:
    made = scan_to_scene(scan, Path(folder) / "scene.json")
    scene, robot = load_scene(str(made.scene)), load_robot("segway_ur5e")
    door = next(joint for item, joint in openable(scene) if item == "fridge_1")
    task = make_task(scene, "open", "fridge_1", door)
    answer = plan_base_placement(scene, robot, task)

print(f"{answer.plan.status}: base pose {answer.plan.base_pose} to open fridge_1/{door}")
for decision in made.decisions:
    kinds = ", ".join(part.kind for part in decision.parts)
    print(f"{decision.detection.name:16} {kinds or decision.reason}")
