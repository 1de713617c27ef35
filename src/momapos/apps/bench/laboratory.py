"""Build the rooms of the suite `paper-real`: the paper's laboratory with a moved table.

The tasks: grasp an apple, grasp a cup, open the right-hinged fridge and the left-hinged microwave
by 90 degrees, with a Ranger Mini and an RM63 in the authors' `b512.json`. Each trial moves the
table and the objects on it; the fridge and the robot's start stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError
from momapos.core.geometry import pose, pose_planar
from momapos.model.collision import FREE, base_hits
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, SceneObject, copied, load_scene, save_scene, upright_boxes
from momapos.model.urdf import Articulated, box_urdf
from momapos.planning.grasps import make_task
from momapos.verification import PlanVerifier

from .authors_data import LABORATORY_FILE, authors_data
from .bench_records import SuiteTask, Verb

if TYPE_CHECKING:
    from jaxtyping import Float

TRIALS = 50
START = (-2.0, -6.0, np.pi)
"""Start of the robot in every trial: 3 m in front of the table, facing it [m], [rad]."""
TABLE, MICROWAVE = "Table", "Mic"
SMALL_OBJECTS = {
    "apple": (0.082646, 0.082646, 0.079053002), "cup": (0.087695002, 0.112706001, 0.074358),
    "box": (0.077892001, 0.162460002, 0.094790998), "can": (0.085962, 0.111511002, 0.072714002),
}  # fmt: skip
"""Edges of the objects on the table [m]: those of an apple, two cups and a box of tea in a public
collection of household objects (yding25/URDF_models)."""
MAX_SHIFT, MAX_TURN = 0.3, np.radians(15.0)
"""Maximum displacement of the table in x and in y [m], and its maximum rotation [rad]."""
FRONT_DEPTH = 0.45
"""Small objects are at most this far from the table's front edge [m]."""
EDGE_DISTANCE, OBJECT_DISTANCE = 0.02, 0.03
"""Minimum distance of objects from the table's edges, and from each other [m]."""
MAX_DRAWS = 1000
TASKS: dict[str, tuple[Verb, str, str | None]] = {
    "grasp apple": ("pick", "apple", None),
    "grasp cup": ("pick", "cup", None),
    "open fridge": ("open", "Fridge", "doorR1_to_base_link"),
    "open microwave": ("open", MICROWAVE, "doorL0_to_base_link"),
}


def laboratory_tasks(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
    """Return the four tasks of every trial; write scene files and models below the folder.

    Raises:
        FileFormatError: The authors' data are missing.
    """
    root = authors_data("paper-real")
    small, first = small_objects(), load_robot(robots[0])
    names = [f"scenes/trial_{number:02d}.json" for number in range(TRIALS)]
    with copied(load_scene(root / LABORATORY_FILE), folder / "scenes" / "laboratory.json") as room:
        for number, name in enumerate(names):
            rng = np.random.default_rng([seed, number])
            save_scene(draw_layout(room, first, small, rng), folder / name)
    return [
        SuiteTask(
            f"{robot} {number:02d} {what}", what, name, robot, verb, item, joint, seed=number
        )
        for robot in robots
        for number, name in enumerate(names)
        for what, (verb, item, joint) in TASKS.items()
    ]  # fmt: skip


def small_objects() -> list[SceneObject]:
    """Build boxes with the sizes of household objects, on the floor at the origin."""
    return [
        SceneObject(name, name, pose((0.0, 0.0, edges[2] / 2)), Articulated(box_urdf(name, edges)))
        for name, edges in SMALL_OBJECTS.items()
    ]


def moved(item: SceneObject, T_world_world: Float[np.ndarray, "4 4"]) -> SceneObject:
    """Return the object moved by a transform of the world."""
    return replace(item, T_world_object=T_world_world @ item.T_world_object)


def set_table(room: Scene, small: list[SceneObject], rng: np.random.Generator) -> list[SceneObject]:
    """Draw places on the unmoved table: the microwave along its back, small objects in front."""
    table, oven = room.object(TABLE), room.object(MICROWAVE)
    (_, y0, _), (x1, y1, top) = table.bounds
    (_, o0, _), (_, o1, _) = oven.bounds
    low_y, high_y = y0 + EDGE_DISTANCE - o0, y1 - EDGE_DISTANCE - o1
    placed = [moved(oven, pose((rng.uniform(-0.15, 0.0), rng.uniform(low_y, high_y), 0.0)))]
    for item in small:
        radius = float(np.hypot(*np.ptp(item.bounds[:, :2], axis=0)) / 2)
        low, high = np.array([x1 - FRONT_DEPTH, y0]), np.array([x1, y1])
        xy = rng.uniform(low + radius + EDGE_DISTANCE, high - radius - EDGE_DISTANCE)
        on_table = pose_planar(np.array([*xy, rng.uniform(-np.pi, np.pi)]))
        on_table[2, 3] = top
        placed.append(moved(item, on_table))
    return placed


def draw_layout(
    room: Scene, robot: Robot, small: list[SceneObject], rng: np.random.Generator
) -> Scene:
    """Draw the scene of a trial, without overlaps and with clearance for both doors to open.

    Raises:
        SceneError: No draw has these properties.
    """
    table = room.object(TABLE)
    middle = pose((*table.bounds[:, :2].mean(0), 0.0))
    fixed = [item for item in room.objects if item.name not in (TABLE, MICROWAVE)]
    largest = np.array([MAX_SHIFT, MAX_SHIFT, MAX_TURN])
    for _ in range(MAX_DRAWS):
        on_table = set_table(room, small, rng)
        if _too_near(on_table):
            continue
        change = pose_planar(rng.uniform(-largest, largest))
        T = middle @ change @ np.linalg.inv(middle)
        group = [moved(item, T) for item in (table, *on_table)]
        hits = base_hits(
            np.zeros((1, 3)), upright_boxes(group), upright_boxes(fixed), clearance=EDGE_DISTANCE
        )
        scene = replace(room, objects=(*fixed, *group), start=np.array(START))
        doors = [make_task(scene, *TASKS[name]) for name in ("open fridge", "open microwave")]
        if hits[0] == FREE and all(
            PlanVerifier(scene, robot, d).blocked(0.0) is None for d in doors
        ):
            return scene
    raise SceneError(f"{room.path}: no layout without overlaps in {MAX_DRAWS} draws")


def _too_near(items: list[SceneObject]) -> bool:
    boxes = [upright_boxes([item]) for item in items]
    return any(
        base_hits(np.zeros((1, 3)), other, one, clearance=OBJECT_DISTANCE)[0] != FREE
        for one, other in combinations(boxes, 2)
    )
