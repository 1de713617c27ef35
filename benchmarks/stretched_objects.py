"""The objects of `objects.py` in other proportions, or lying on their side, as URDFs of their own.

    python benchmarks/stretched_objects.py --out FOLDER [--wide 1.5] [--high 0.75] [--rolled]
    python benchmarks/scan_objects.py --models FOLDER --no-answers

Their doors and drawers are those of things that people build, in sizes that nothing was tuned to.
Rolled by a quarter turn, what was hinged at its side is hinged below, or above: a flap; only
objects with a door are. An object stays in its set.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from momapos.apps.synthetic_scans.surfaces import Paint, patches, urdf_paints
from momapos.core.geometry.transforms import apply, pose
from momapos.model.scene.formats.urdf_writer import urdf_text
from momapos.model.scene.scene import SceneObject
from momapos.model.urdf.urdf_records import Geometry, Link
from objects import objects, parts, room, set_of

_FRONT = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From a front toward -x, as in `objects.room`, to one toward -y, as in `object_rooms`."""


def rolls(item: SceneObject) -> int:
    """Which way an object is rolled so that most of its doors are hinged below.

    Returns:
        1 where its left side comes down, -1 where its right one does, 0 where it has no door.
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
    """Write an object, first stretched along the axes of its room, then turned.

    Every link has the orientation of the model, so that a stretched part moves as a rigid one.

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
    file.write_text(urdf_text(urdf, {}), encoding="utf-8")
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
    """A shape as an OBJ file in the frame of its new link; its colors are added to `colors`."""
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
    parser.add_argument("--rolled", action="store_true", help="lying on their side")
    args = parser.parse_args()
    if not (0.2 <= args.wide <= 5.0 and 0.2 <= args.high <= 5.0):
        parser.error("--wide and --high are factors from 0.2 to 5")
    rows = []
    for name, file, usual in objects():
        scene = room(name, file, usual)
        item = None if scene is None else scene.object("object")
        way = rolls(item) if args.rolled and item is not None else 0
        if item is None or (args.rolled and not way):
            continue
        roll = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -way], [0.0, way, 0.0]])
        turn = _FRONT @ (roll if args.rolled else np.eye(3))
        home = args.out / name.replace("/", "_")
        urdf = write(item, np.diag([1.0, args.wide, args.high]), turn, home)
        place = {"above": usual.above, "counter": usual.counter}
        rows.append({"name": name, "urdf": urdf.relative_to(args.out).as_posix(), **place})
    (args.out / "models.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(f"{dict(Counter(set_of(str(row['name'])) for row in rows))} in {args.out}")


if __name__ == "__main__":
    main()
