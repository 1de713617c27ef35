"""Write a plan, and check it again from the files alone with exact geometry."""

import tempfile
from pathlib import Path

from momapos import load_robot, load_scene, make_task, plan_base_placement, verify_files, write_plan

scene = load_scene("kitchen_island")
robot = load_robot("segway_ur5e")
task = make_task(scene, "pick", "cup")
plan = plan_base_placement(scene, robot, task).plan

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "plan.json"
    write_plan(plan, path)
    report = verify_files(path)
print("valid" if report.valid else report.violations)
