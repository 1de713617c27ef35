"""Build the rooms of the suite `authors-sim`: the kitchens of the authors' public simulation.

A UR5e on a Segway picks a bowl at six places of one kitchen, from which objects are left out as the
authors do. Their repository names the places, except that in the dishwasher, and the start. Their
bowl is 13 cm wide, and their gripper, which opens 8.5 cm, need not hold it. Here something of the
same height that it can hold stands there.

Source: Project_MoMa-Pos, `utils_Kitchen_*.py` and `MoMa_main.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from momapos.core.geometry import pose
from momapos.model.scene import Scene, SceneObject, copied, load_scene, save_scene
from momapos.model.urdf import Articulated, box_urdf

from .bench_records import SuiteTask
from .laboratory import shared_data

KITCHEN = "bestman/derived/kitchen_v2.json"
BOWL = "Bowl_Target"
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
        (4.0, 4.0, 1.0), ("elementB1", "elementB2", "elementC", "mug", "toothpaste_1")
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


def kitchen_tasks(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
    """Return a pick at each place for each trial; write scene files and models below the folder.

    Raises:
        FileFormatError: The authors' data are missing.
    """
    kitchen = load_scene(shared_data() / KITCHEN)
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


def _furnished(kitchen: Scene, place: Place) -> Scene:
    """Return the kitchen with what the authors keep, and the bowl standing at its place."""
    for item, joint, value in place.opened:
        kitchen = kitchen.with_joints({item: {joint: value}})
    others = [
        o for o in kitchen.objects if o.name != BOWL and (not place.kept or o.name in place.kept)
    ]
    height = float(np.ptp(kitchen.object(BOWL).bounds[:, 2]))
    model = Articulated(box_urdf(BOWL, (WIDTH, WIDTH, height)))
    x, y, _ = place.position
    T = pose((x, y, _top_below(place.position, others) + height / 2))
    return replace(
        kitchen, objects=(*others, SceneObject(BOWL, "bowl", T, model)), start=np.array(START)
    )


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
