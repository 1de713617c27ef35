"""Check that every door and drawer of converted MJCF rooms moves as in MuJoCo.

    python -m pip install --no-deps --target FOLDER gymnasium-robotics metaworld robosuite
    python benchmarks/mjcf_rooms.py FOLDER [--out FILE]

Rooms: those of the packages in FOLDER, one composed of a table and doors of robosuite with MuJoCo,
and the built-in kitchens as our writer exports them. Each room is converted. Then each bounded
hinge and slide of a solid body (except actuated robot joints and joints that follow others) is set
to both ends of its range, in MuJoCo's model of the file and in our scene. It is right if the
extents of each moved geom, handles included, agree to 5 mm along 26 directions, and its limits
agree to 1e-3.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from mjcf_support import Found, Truth, compare
from momapos.model.scene import builtin_names, load_scene
from momapos.model.scene.formats import write_mjcf, write_room
from momapos.model.scene.formats.mjcf import read_room

MAX_GEOM_ERROR = 5e-3
"""Maximum error of a right geom [m]."""
MAX_LIMIT_ERROR = 1e-3
"""Maximum error of a right joint limit [rad] or [m]."""
PACKAGES = {
    "gymnasium_robotics/envs/assets": (
        "kitchen_franka/kitchen_assets/kitchen_env_model.xml",
        "adroit_hand/adroit_door.xml",
    ),
    "metaworld/assets": tuple(
        f"sawyer_xyz/sawyer_{name}.xml"
        for name in (
            "box", "button_press", "coffee", "dial", "door_lock", "door_pull", "drawer", "faucet",
            "handle_press", "laptop", "lever_pull", "window",
        )
    ),
}  # fmt: skip
"""Rooms by the folder of their files."""


@dataclass(frozen=True)
class Room:
    """A room, and the folder of its files."""

    name: str
    path: Path
    root: Path


def rooms(folder: Path, made: Path) -> Iterator[Room]:
    """Yield all rooms; generated ones are written to a folder of their own."""
    for base, names in PACKAGES.items():
        for name in names:
            yield Room(Path(name).stem, folder / base / name, folder / base)
    yield Room("robosuite", _robosuite(folder / "robosuite/models/assets", made), made)
    for name in builtin_names():
        write_mjcf(load_scene(name), made / f"{name}.xml")
        yield Room(name, made / f"{name}.xml", made)


def _robosuite(assets: Path, made: Path) -> Path:
    """Write a table with two doors of robosuite on it."""
    spec = mujoco.MjSpec.from_file(str(assets / "arenas/table_arena.xml"))
    for number, name in enumerate(("door", "door_lock")):
        door = mujoco.MjSpec.from_file(str(assets / f"objects/{name}.xml"))
        frame = spec.worldbody.add_frame(pos=[-0.2, number - 0.5, 1.1])
        spec.attach(_bare(door), prefix=f"{name}/", frame=frame)
    path = made / "robosuite.xml"
    spec = _bare(spec)
    spec.compile()
    path.write_text(spec.to_xml(), encoding="utf-8")
    return path


def _bare(spec: Any) -> Any:
    """Return a model without textures, whose files are in another folder."""
    for geom in spec.geoms:
        geom.material = ""
    for element in [*spec.materials, *spec.textures]:
        spec.delete(element)
    return spec


def right(one: Found) -> bool:
    """Return whether a joint moves its part in our scene as in MuJoCo."""
    return one.error < MAX_GEOM_ERROR and one.limits < MAX_LIMIT_ERROR


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of the packages")
    parser.add_argument("--out", type=Path, help="write the figures into this JSON file")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as made:
        for room in rooms(args.folder, Path(made)):
            read = read_room(room.path, room.root)
            scene = write_room(read, room.path, Path(made) / f"{room.name}.json")
            found = list(compare(Truth(room.path), scene))
            good = [one for one in found if right(one)]
            worst = max((one.error for one in found), default=0.0)
            rows.append({
                "room": room.name, "joints": len(found), "right": len(good), "worst": worst,
                "wrong": [one.name for one in found if not right(one)],
                "report": read.final_report().as_json(),
            })  # fmt: skip
            print(f"{room.name:20} {len(good):3} of {len(found):3} joints, worst {worst:.2g} m")
            for one in found:
                if not right(one):
                    print(f"    {one.name}: {one.error:.2g} m, limits {one.limits:.2g}")
    total, good_ones = (sum(row[key] for row in rows) for key in ("joints", "right"))
    print(f"{len(rows)} rooms: {good_ones} of {total} joints are right")
    if args.out is not None:
        args.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
