"""Write the objects of `objects.py` as URDFs with other proportions, or rolled on their side.

    python benchmarks/stretched_objects.py --out FOLDER [--wide 1.5] [--high 0.75] [--rolled]
    python benchmarks/scan_objects.py --models FOLDER --no-answers

Doors and drawers stay realistic, but their sizes are new to momapos. After a roll by 90 degrees, a
part hinged at its side is hinged below or above, like a flap; only objects with a door are rolled.
An object stays in its set.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from momapos.apps.bench.articulated import parts, set_of
from momapos.apps.synthetic_scans.surfaces import Paint, patches, urdf_paints
from momapos.core.geometry import apply, pose
from momapos.model.scene import SceneObject
from momapos.model.scene.formats import urdf_text
from momapos.model.urdf import Geometry, Link
from objects import objects, room

_FRONT = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Turns a front toward -x, as in `objects.room`, to -y, as in `object_rooms`."""


def rolls(item: SceneObject) -> int:
    """Return the roll direction after which most doors are hinged below.

    Returns:
        1 to roll to the left side, -1 to the right side, 0 without a door.
    """
    poses, votes = item.link_poses(), 0.0
    for joint in parts(item.model):
        T = poses[joint.parent] @ joint.T_parent_joint
        if joint.kind == "prismatic" or abs(T[2, :3] @ joint.axis) < np.sqrt(0.5):
            continue
        links = item.model.moved_by(joint.name)
        points = np.concatenate(
            [apply(poses[n], hull.vertices) for n in links for hull in item.model.hulls[n]]
        )
        size = np.ptp(points, axis=0)
        votes += np.sign(points[:, 1].mean() - T[1, 3]) * size[1] * size[2]
    return int(np.sign(votes))


def write(item: SceneObject, stretch: np.ndarray, turn: np.ndarray, home: Path) -> Path:
    """Write an object, stretched along the axes of its room and then turned.

    Every link gets the orientation of the model, so that a stretched part still moves rigidly.

    Returns:
        The URDF file.
    """
    home.mkdir(parents=True, exist_ok=True)
    poses, joints = item.link_poses(), item.model.urdf.joints
    own = {j.child: poses[j.parent] @ j.T_parent_joint for j in joints}
    origins = {
        name: turn @ stretch @ own[name][:3, 3] if name in own else np.zeros(3)
        for name in item.model.urdf.links
    }
    paints = urdf_paints(item.model.urdf.path)
    colors: dict[str, tuple[float, float, float]] = {}
    links = {}
    for name, link in item.model.urdf.links.items():
        made: dict[str, tuple[Geometry, ...]] = {}
        for kind, shapes in _shapes(link):
            known = paints.get(name, []) if kind == "visual" else []
            for k, shape in enumerate(shapes):
                paint = known[k] if k < len(known) else None
                text = _mesh(shape, paint, poses[name], turn @ stretch, origins[name], colors)
                mesh = home / f"{name}_{kind}_{k}.obj"
                mesh.write_text(text, encoding="utf-8")
                label, file = shape.name or name, Path(mesh.name)
                one = Geometry("mesh", (1.0, 1.0, 1.0), np.eye(4), label, file)
                made[kind] = (*made.get(kind, ()), one)
        links[name] = Link(name, made.get("collision", ()), made.get("visual", ()))
    placed = tuple(
        replace(
            joint,
            T_parent_joint=pose(origins[joint.child] - origins[joint.parent]),
            axis=turn @ own[joint.child][:3, :3] @ joint.axis,
        )
        for joint in joints
    )
    (home / "paints.mtl").write_text(
        "".join(f"newmtl {name}\nKd {_words(color)}\n" for name, color in colors.items()),
        encoding="utf-8",
    )
    file = home / "model.urdf"
    urdf = replace(item.model.urdf, name=home.name, links=links, joints=placed)
    file.write_text(urdf_text(urdf), encoding="utf-8")
    return file


def _shapes(link: Link) -> list[tuple[str, tuple[Geometry, ...]]]:
    return [
        ("visual", link.visuals or link.collisions),
        ("collision", link.collisions or link.visuals),
    ]


def _mesh(
    shape: Geometry,
    paint: Paint,
    T: np.ndarray,
    A: np.ndarray,
    origin: np.ndarray,
    colors: dict[str, tuple[float, float, float]],
) -> str:
    """Return a shape as an OBJ file in the frame of its new link; add its colors to `colors`."""
    lines, count = ["mtllib paints.mtl"], 0
    for patch in patches(shape, paint):
        points = apply(T, patch.triangles.reshape(-1, 3)) @ A.T - origin
        name = "none" if patch.paint is None else "rgb_" + _words(patch.paint).replace(" ", "_")
        if patch.paint is not None:
            colors[name] = patch.paint
        lines.append(f"usemtl {name}")
        lines += [f"v {_words(point)}" for point in points]
        corners = count + 1 + np.arange(len(points)).reshape(-1, 3)
        lines += [f"f {a} {b} {c}" for a, b, c in corners.tolist()]
        count += len(points)
    return "\n".join(lines) + "\n"


def _words(values: np.ndarray | tuple[float, float, float]) -> str:
    return " ".join(f"{v:.6f}" for v in values)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the URDFs")
    parser.add_argument("--wide", type=float, default=1.0, help="factor of the width")
    parser.add_argument("--high", type=float, default=1.0, help="factor of the height")
    parser.add_argument("--rolled", action="store_true", help="roll objects on their side")
    args = parser.parse_args()
    if not (0.2 <= args.wide <= 5.0 and 0.2 <= args.high <= 5.0):
        parser.error("--wide and --high must be from 0.2 to 5")
    rows = []
    for name, file, usual in objects():
        scene = room(name, file, usual)
        item = None if scene is None else scene.object("object")
        direction = rolls(item) if args.rolled and item is not None else 0
        if item is None or (args.rolled and not direction):
            continue
        roll = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -direction], [0.0, direction, 0.0]])
        turn = _FRONT @ (roll if args.rolled else np.eye(3))
        home = args.out / name.replace("/", "_")
        urdf = write(item, np.diag([1.0, args.wide, args.high]), turn, home)
        place = {"above": usual.above, "counter": usual.counter}
        rows.append({"name": name, "urdf": urdf.relative_to(args.out).as_posix(), **place})
    (args.out / "models.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(f"{dict(Counter(set_of(str(row['name'])) for row in rows))} in {args.out}")


if __name__ == "__main__":
    main()
