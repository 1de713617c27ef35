"""The paper's laboratory, with the table moved at random: the rooms of the suite `paper-real`.

Grasp an apple, grasp a cup, open the right-hinged fridge and the left-hinged microwave by 90
degrees, with a Ranger Mini and an RM63 in `b512.json`, which the authors publish. In each trial the
table moves, and so do the things on it; the fridge and the robot's start stay.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, SceneError
from momapos.core.geometry import pose, pose_planar
from momapos.model.collision import FREE, base_hits
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, SceneObject, copied, load_scene, save_scene, upright_boxes
from momapos.model.urdf import Articulated, box_urdf
from momapos.planning.grasps import make_task
from momapos.verification import PlanVerifier

from .bench_records import SuiteTask, Verb

if TYPE_CHECKING:
    from jaxtyping import Float

SHARED = "MOMAPOS_SHARED"
"""The environment variable that names the folder of the authors' data."""
TRIALS = 50
ROOM = "bestman/Asset/Scene/Scene/b512.json"
SIZES = "bestman/derived/urdf_models_sizes.csv"
START = (-2.0, -6.0, np.pi)
"""Where the robot begins in every trial: 3 m before the table, facing it [m], [rad]."""
TABLE, MICROWAVE = "Table", "Mic"
THINGS = {"apple": "plastic_apple", "cup": "blue_cup", "box": "lipton_tea", "can": "green_cup"}
"""What stands on the table, and whose size it has in the shared data."""
SHIFT, TURN = 0.3, np.radians(15.0)
"""The table moves by up to so much in x and in y [m], and turns by up to so much [rad]."""
FRONT = 0.45
"""Small things stand within this of the table's front edge [m]."""
EDGE, APART = 0.02, 0.03
"""Distance of things from the table's edges, and from each other [m]."""
DRAWS = 1000
TASKS: dict[str, tuple[Verb, str, str | None]] = {
    "grasp apple": ("pick", "apple", None),
    "grasp cup": ("pick", "cup", None),
    "open fridge": ("open", "Fridge", "doorR1_to_base_link"),
    "open microwave": ("open", MICROWAVE, "doorL0_to_base_link"),
}


def shared_data() -> Path:
    """The folder that holds `bestman`, the authors' data.

    Raises:
        FileFormatError: It is not there; the message says where it was looked for.
    """
    given = Path(os.environ.get(SHARED, "shared"))
    folders = (given / "data", given)
    for folder in folders:
        if (folder / ROOM).is_file() and (folder / SIZES).is_file():
            return folder
    looked = " and ".join(str((folder / ROOM).absolute()) for folder in folders)
    raise FileFormatError(
        f"paper-real needs the authors' laboratory, which is not part of momapos: looked for "
        f"{looked}; set {SHARED} to the folder that holds bestman/"
    )


def laboratory_tasks(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
    """The four tasks in every trial's world; scene files and models go below the folder.

    Raises:
        FileFormatError: The authors' data are not there.
    """
    data = shared_data()
    small = things(data)
    scenes = folder / "scenes"
    first = load_robot(robots[0])
    names = [f"scenes/trial_{number:02d}.json" for number in range(TRIALS)]
    with copied(load_scene(data / ROOM), scenes / "laboratory.json") as room:
        for number, name in enumerate(names):
            rng = np.random.default_rng([seed, number])
            save_scene(layout(room, first, small, rng), folder / name)
    return [
        SuiteTask(
            f"{robot} {number:02d} {what}", what, name, robot, verb, item, joint, seed=number
        )
        for robot in robots
        for number, name in enumerate(names)
        for what, (verb, item, joint) in TASKS.items()
    ]  # fmt: skip


def things(data: Path) -> list[SceneObject]:
    """Boxes of the size of household objects, on the floor at the origin.

    Args:
        data: The folder that holds `bestman`.
    """
    with (data / SIZES).open(encoding="utf-8") as file:
        sizes = {row["object_name"]: row for row in csv.DictReader(file)}
    made = []
    for name, like in THINGS.items():
        x, y, z = (float(sizes[like][f"size_{axis}"]) for axis in "xyz")
        T = pose((0.0, 0.0, z / 2))
        made.append(SceneObject(name, name, T, Articulated(box_urdf(name, (x, y, z)))))
    return made


def moved(item: SceneObject, T_world_world: Float[np.ndarray, "4 4"]) -> SceneObject:
    """The same thing, moved by a transform of the world."""
    return replace(item, T_world_object=T_world_world @ item.T_world_object)


def set_table(room: Scene, small: list[SceneObject], rng: np.random.Generator) -> list[SceneObject]:
    """Put microwave and things on the table as the room has it, the microwave along its back."""
    table, oven = room.object(TABLE), room.object(MICROWAVE)
    (_, y0, _), (x1, y1, top) = table.bounds
    (_, o0, _), (_, o1, _) = oven.bounds
    shift = (rng.uniform(-0.15, 0.0), rng.uniform(y0 + EDGE - o0, y1 - EDGE - o1), 0.0)
    placed = [moved(oven, pose(shift))]
    for item in small:
        radius = float(np.hypot(*np.ptp(item.bounds[:, :2], axis=0)) / 2)
        low, high = (x1 - FRONT, y0), (x1, y1)
        xy = rng.uniform(np.array(low) + radius + EDGE, np.array(high) - radius - EDGE)
        on_table = pose_planar(np.array([*xy, rng.uniform(-np.pi, np.pi)]))
        on_table[2, 3] = top
        placed.append(moved(item, on_table))
    return placed


def layout(room: Scene, robot: Robot, small: list[SceneObject], rng: np.random.Generator) -> Scene:
    """Draw a trial's world: nothing overlaps, and each door has room to swing."""
    table = room.object(TABLE)
    middle = pose((*table.bounds[:, :2].mean(0), 0.0))
    fixed = [item for item in room.objects if item.name not in (TABLE, MICROWAVE)]
    for _ in range(DRAWS):
        on_table = set_table(room, small, rng)
        if _too_near(on_table):
            continue
        change = pose_planar(rng.uniform([-SHIFT, -SHIFT, -TURN], [SHIFT, SHIFT, TURN]))
        T = middle @ change @ np.linalg.inv(middle)
        group = [moved(item, T) for item in (table, *on_table)]
        hits = base_hits(
            np.zeros((1, 3)), upright_boxes(group), upright_boxes(fixed), clearance=EDGE
        )
        scene = replace(room, objects=(*fixed, *group), start=np.array(START))
        doors = [make_task(scene, *TASKS[name]) for name in ("open fridge", "open microwave")]
        if hits[0] == FREE and all(
            PlanVerifier(scene, robot, d).blocked(0.0) is None for d in doors
        ):
            return scene
    raise SceneError(f"{room.path}: no layout without overlaps in {DRAWS} draws")


def _too_near(items: list[SceneObject]) -> bool:
    """Whether two things on the table are nearer than `APART`."""
    boxes = [upright_boxes([item]) for item in items]
    return any(
        base_hits(np.zeros((1, 3)), boxes[i], boxes[j], clearance=APART)[0] != FREE
        for i in range(len(items))
        for j in range(i)
    )
