"""Build the rooms of the paper and of its authors' code: the laboratory and the public kitchens.

The tasks of the laboratory: grasp an apple, grasp a cup, open the right-hinged fridge and the left-
hinged microwave by 90 degrees, with a Ranger Mini and an RM63 in the authors' `b512.json`. Each
trial moves the table and the objects on it; the fridge and the robot's start stay.

In the public kitchens, a UR5e on a Segway picks a bowl at six places of one kitchen, from which
objects are left out as the authors do. Their repository names the places, except that in the
dishwasher, and the start. Their bowl is 13 cm wide, and their gripper, which opens 8.5 cm, need not
hold it. Here something of the same height that it can hold stands there.

Source: Project_MoMa-Pos, `utils_Kitchen_*.py` and `MoMa_main.py`.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, InputError, SceneError
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
"""Environment variable that names the folder of the authors' data."""
REPOSITORY = "https://github.com/AutonoBot-Lab/BestMan_Pybullet"
SUBMODULE = "Asset/Scene/URDF_models"
"""Folder of the repository which a clone without its submodules leaves empty."""
LABORATORY_FILE = "Asset/Scene/Scene/b512.json"
_LABORATORY = (LABORATORY_FILE, f"{SUBMODULE}/B512")
NEEDED = {
    "paper-real": _LABORATORY,
    "paper-table": _LABORATORY,
    "authors-sim": (
        *(f"Asset/Scene/Kitchen_models/models/{name}"
          for name in ("Dishwasher/2085", "Fridge/10144", "Microwave/7128")),
        *(f"Asset/Scene/Kitchen_models/models_yan/{name}" for name in ("elementA", "elementB")),
        f"{SUBMODULE}/furniture_chair", f"{SUBMODULE}/furniture_table_rectangle_high",
    ),
}  # fmt: skip
"""Files and folders that a suite needs, in the authors' repository."""
PAPER = "paper"
"""Names all suites of the paper together."""


def authors_data(suite: str) -> Path:
    """Find the folder that holds all that a suite needs of the authors' repository.

    Raises:
        FileFormatError: Something is in none of the searched places.
    """
    places = _places()
    for folder in places:
        if not _missing(folder, suite):
            return folder
    nearest = min(places, key=lambda folder: len(_missing(folder, suite)))
    lacking = ", ".join(str((nearest / file).absolute()) for file in _missing(nearest, suite))
    raise FileFormatError(
        f"{suite}: the authors' models are not part of momapos, and there is no {lacking}; "
        f"'momapos bench data {suite}' says how to get them"
    )


def data_lines(name: str) -> tuple[list[str], bool]:
    """Return what a suite needs, where it comes from and where it lies, and whether all is there.

    Raises:
        InputError: The name is not that of a suite which needs data.
    """
    if name != PAPER and name not in NEEDED:
        known = ", ".join((PAPER, *NEEDED))
        raise InputError(f"no data belong to {name!r}; choose from {known}")
    suites = [name] if name in NEEDED else list(NEEDED)
    lines, complete = [], True
    for file in dict.fromkeys(one for suite in suites for one in NEEDED[suite]):
        found = next((folder / file for folder in _places() if (folder / file).exists()), None)
        users = ", ".join(suite for suite in suites if file in NEEDED[suite])
        lines.append(f"  {file} ({users}): {found.absolute() if found else 'missing'}")
        complete &= found is not None
    head = [f"from {REPOSITORY} and its submodule {SUBMODULE}, whose files keep their licenses:"]
    steps = [
        f"  git clone --depth 1 --recurse-submodules {REPOSITORY} FOLDER/bestman",
        f"  export {SHARED}=FOLDER",
        f"in a clone without its submodule: git submodule update --init {SUBMODULE}",
    ]
    return head + lines + ([] if complete else ["to get what is missing:", *steps]), complete


def _missing(folder: Path, suite: str) -> list[str]:
    """Return what a suite needs and a folder lacks."""
    return [file for file in NEEDED[suite] if not (folder / file).exists()]


def _places() -> list[Path]:
    """Return the folders in which the repository may lie."""
    given = Path(os.environ.get(SHARED, "shared"))
    return [given / "data" / "bestman", given / "bestman", given]


LABORATORY_TRIALS = 50
LABORATORY_START = (-2.0, -6.0, np.pi)
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
    names = [f"scenes/trial_{number:02d}.json" for number in range(LABORATORY_TRIALS)]
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
        scene = replace(room, objects=(*fixed, *group), start=np.array(LABORATORY_START))
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


MODELS = "Asset/Scene/Kitchen_models/models"
CHAIR = "Asset/Scene/URDF_models/furniture_chair/model.urdf"
FURNITURE = (
    ("elementA", f"{MODELS}_yan/elementA/urdf/kitchen_part_right_gen_convex.urdf",
     (4.0, 2.0, 1.477), 180.0, 1.0),
    ("elementB1", f"{MODELS}_yan/elementB/model.urdf", (4.1, 4.55, 0.55), 270.0, 1.1),
    ("elementB2", f"{MODELS}_yan/elementB/model.urdf", (4.1, 5.25, 0.55), 270.0, 1.1),
    ("elementC", f"{MODELS}/Dishwasher/2085/mobility.urdf", (3.85, 3.2, 0.35), 0.0, 0.75),
    ("elementD", f"{MODELS}/Microwave/7128/mobility.urdf", (4.0, 2.9, 1.1), 0.0, 0.5),
    ("elementE", f"{MODELS}/Fridge/10144/mobility.urdf", (4.1, 5.42, 1.055), 0.0, 1.1),
    ("elementF", "Asset/Scene/URDF_models/furniture_table_rectangle_high/table.urdf",
     (1.5, 2.0, 0.0), 90.0, 1.0),
    ("elementG1", CHAIR, (1.5, 2.8, 0.0), 270.0, 1.0),
    ("elementG2", CHAIR, (2.1, 2.2, 0.0), 180.0, 1.0),
    ("elementG3", CHAIR, (1.5, 1.1, 0.0), 90.0, 1.0),
    ("elementG4", CHAIR, (2.1, 2.7, 0.0), 180.0, 1.0),
)  # fmt: skip
"""Name, model below the authors' repository, position [m], yaw [deg] and scale."""
SMALL = {
    "peach": ((0.077, 0.075, 0.071), (1.8, 2.0, 0.861)),
    "banana": ((0.081, 0.203, 0.043), (1.3, 2.2, 0.847)),
    "orange": ((0.074, 0.072, 0.072), (1.7, 1.7, 0.861)),
    "lemon": ((0.065, 0.067, 0.060), (1.8, 1.8, 0.855)),
    "plate": ((0.155, 0.155, 0.023), (1.5, 2.2, 0.837)),
    "mug": ((0.130, 0.161, 0.114), (3.9, 4.6, 0.966)),
    "toothpaste": ((0.050, 0.187, 0.035), (3.9, 4.9, 0.926)),
    "pudding": ((0.120, 0.096, 0.045), (4.0, 0.8, 0.949)),
    "sugar": ((0.099, 0.183, 0.052), (3.8, 0.7, 0.953)),
}
"""Edges and middle of boxes for small objects on tables and counters [m]."""
BOWL, BOWL_HEIGHT = "bowl", 0.055
"""The target, and its height [m]."""
KITCHEN_START = (2.0, 6.0, np.pi / 2)
"""Start of the robot in every trial [m], [rad]."""
KITCHEN_TRIALS = 5
"""Seeds of each place; the rooms are the same [-]."""
WIDTH = 0.07
"""Width of what stands for the bowl [m]."""


@dataclass(frozen=True)
class Place:
    """Where the bowl is, and what is in the room besides it."""

    position: tuple[float, float, float]
    """Position from which the bowl is lowered until it stands [m]."""
    kept: tuple[str, ...] = ()
    """Objects in the room; all by default."""
    opened: tuple[tuple[str, str, float], ...] = ()
    """Object, joint and value [rad] or [m] of what is open."""


PLACES = {
    "on dinner table": Place((1.7, 2.2, 0.85)),
    "on table": Place((1.7, 2.2, 1.0), ("elementF",)),
    "on countertop": Place(
        (4.0, 4.0, 1.0), ("elementB1", "elementB2", "elementC", "mug", "toothpaste")
    ),
    "in fridge": Place((4.0, 5.3, 1.4), ("elementE",), (("elementE", "fridge_door", np.pi / 2),)),
    "in drawer": Place(
        (3.6, 2.4, 0.9), ("elementA", "elementC"),
        (("elementA", "hitman_drawer_top_joint", 0.4),),
    ),
    # The authors' file for it has the bowl on the counter; here it is in the middle of the tray.
    "in dishwasher": Place(
        (3.45, 3.2, 0.7), ("elementA", "elementB1", "elementC"),
        (("elementC", "dishwasher_door", 0.53),),
    ),
}  # fmt: skip


def simulation_tasks(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
    """Return a pick at each place for each trial; write scene files and models below the folder.

    Raises:
        FileFormatError: The authors' data are missing.
    """
    kitchen = _kitchen(folder)
    files = {name: f"scenes/{name.replace(' ', '_')}.json" for name in PLACES}
    with copied(kitchen, folder / "scenes" / "kitchen.json") as room:
        for name, place in PLACES.items():
            save_scene(_furnished(room, place), folder / files[name])
    return [
        SuiteTask(
            f"{robot} {trial:02d} {name}", name, files[name], robot, "pick", BOWL, None,
            seed=seed * KITCHEN_TRIALS + trial,
        )
        for robot in robots
        for trial in range(KITCHEN_TRIALS)
        for name in PLACES
    ]  # fmt: skip


def _kitchen(folder: Path) -> Scene:
    """Return the kitchen without the bowl, with its models in the authors' repository."""
    root, rows = authors_data("authors-sim"), []
    for name, model, position, yaw, scale in FURNITURE:
        rows.append({
            "obj_name": name, "model_path": model, "object_position": position, "scale": scale,
            "object_orientation": (0.0, 0.0, math.radians(yaw)), "fixed_base": True,
        })  # fmt: skip
    file = folder / "scenes" / "furniture.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(rows))
    boxes = [
        SceneObject(name, name, pose(middle), Articulated(box_urdf(name, edges)))
        for name, (edges, middle) in SMALL.items()
    ]
    scene = load_scene(file, root=root)
    return replace(scene, objects=(*scene.objects, *boxes))


def _furnished(kitchen: Scene, place: Place) -> Scene:
    """Return the kitchen with what the authors keep, and the bowl standing at its place."""
    for item, joint, value in place.opened:
        kitchen = kitchen.with_joints({item: {joint: value}})
    others = [o for o in kitchen.objects if not place.kept or o.name in place.kept]
    model = Articulated(box_urdf(BOWL, (WIDTH, WIDTH, BOWL_HEIGHT)))
    x, y, _ = place.position
    T = pose((x, y, _top_below(place.position, others) + BOWL_HEIGHT / 2))
    bowl = SceneObject(BOWL, BOWL, T, model)
    return replace(kitchen, objects=(*others, bowl), start=np.array(KITCHEN_START))


def _top_below(position: tuple[float, float, float], others: Sequence[SceneObject]) -> float:
    """Return the height of the highest box below the bowl [m]; 0 for the floor."""
    tops, side = [0.0], np.array([-WIDTH / 2, 0.0, WIDTH / 2])
    under = np.array(position[:2]) + np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    for other in others:
        for boxes in other.static_boxes.values():
            away = under[:, None] - boxes.center[:, :2]
            local = np.einsum("bji,pbj->pbi", boxes.rotation[:, :2, :2], away)
            covers = (np.abs(local) <= boxes.half[:, :2]).all(2).any(0)
            top = boxes.center[:, 2] + (np.abs(boxes.rotation[:, 2]) * boxes.half).sum(1)
            tops += top[covers & (top <= position[2])].tolist()
    return max(tops)
