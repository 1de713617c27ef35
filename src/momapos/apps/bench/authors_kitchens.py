"""Build the rooms of the suite `authors-sim`: the kitchens of the authors' public simulation.

A UR5e on a Segway picks a bowl at six places of one kitchen, from which objects are left out as the
authors do. Their repository names the places, except that in the dishwasher, and the start. Their
bowl is 13 cm wide, and their gripper, which opens 8.5 cm, need not hold it. Here something of the
same height that it can hold stands there.

Source: Project_MoMa-Pos, `utils_Kitchen_*.py` and `MoMa_main.py`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from momapos.core.geometry import pose
from momapos.model.scene import Scene, SceneObject, copied, load_scene, save_scene
from momapos.model.urdf import Articulated, box_urdf

from .authors_data import authors_data
from .bench_records import SuiteTask

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
START = (2.0, 6.0, np.pi / 2)
"""Start of the robot in every trial [m], [rad]."""
TRIALS = 5
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
            seed=seed * TRIALS + trial,
        )
        for robot in robots
        for trial in range(TRIALS)
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
    return replace(kitchen, objects=(*others, bowl), start=np.array(START))


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
