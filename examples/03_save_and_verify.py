"""Write a plan, and check it again from the files alone with exact geometry."""

import tempfile
from pathlib import Path

from momapos import load_robot, load_scene, make_task, place, verify_files, write_plan
from momapos.cache import default_cache_dir
from momapos.reachability.store import load_or_build

scene = load_scene("kitchen_island")
robot = load_robot("segway_ur5e")
task = make_task(scene, "pick", "cup")
reach = load_or_build(robot, default_cache_dir(), None)
plan = place(scene, robot, task, reach).plan

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "plan.json"
    write_plan(plan, path)
    report = verify_files(path)
print("valid" if report.valid else report.violations)
