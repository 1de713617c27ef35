"""Build a room in code from a box and a URDF; write, read and verify its plan."""

import shutil
import tempfile
from pathlib import Path

import momapos

with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    urdf = shutil.copy(Path(__file__).with_name("cupboard.urdf"), folder)
    table = momapos.SceneObject.box("table", size=(1.2, 0.8, 0.75), xyz=(0.0, 1.8, 0.375))
    cupboard = momapos.SceneObject.from_urdf("cupboard", urdf, xyz=(0.0, 0.0, 0.0))
    room = momapos.save_scene(momapos.Scene("room", (table, cupboard)), folder / "room.json")
    robot, task = momapos.load_robot("fetch"), momapos.make_task(room, "open", "cupboard")
    plan = momapos.plan_base_placement(room, robot, task).plan
    momapos.write_plan(plan, folder / "plan.json")
    print(momapos.read_plan(folder / "plan.json").status, end=" and ")
    print("valid" if momapos.verify_files(folder / "plan.json").valid else "wrong")
