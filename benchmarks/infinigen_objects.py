"""Dishwashers that Infinigen draws, as URDFs that `scan_objects.py` takes.

    python3.11 -m venv drawn && drawn/bin/pip install infinigen==1.15.5
    drawn/bin/python -c "from pathlib import Path; from infinigen.core.sim.sim_factory import *;
    [spawn_simready('dishwasher', 'urdf', Path('drawn'), 64, seed, visual_only=True)
     for seed in range(14)]"
    python benchmarks/infinigen_objects.py drawn/urdf --out FOLDER
    python benchmarks/scan_objects.py --models FOLDER --no-answers

Doors, drawers, handles and materials are drawn by a program of others, so that nothing here was
tuned to them. What moves and is no door or drawer, a knob, a rack inside, is made fast. Each is as
high as such a thing is in a kitchen, and has one color a triangle, that of its texture. A hash of
the name says which half may be looked at, as in `objects.py`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import trimesh
from trimesh.visual import ColorVisuals

from momapos.kinematics.urdf import read_urdf
from momapos.kinematics.urdf_records import Joint, Link, Urdf
from objects import half_of

HEIGHT = 0.85
"""Of a dishwasher [m]; what Infinigen draws is in no unit."""
MOVES = {"revolute": "door", "prismatic": "drawer"}
"""What in the name of a mesh says that a joint of a type is one of the object's."""
BODY, PAINTS = "body", "paints.mtl"
Color = tuple[int, int, int]
LEVELS = 32
"""Shades of each color [-]."""
_TURNED = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From a front toward +x to one toward -y, as in `object_rooms`."""


def write(urdf: Urdf, height: float, home: Path) -> Path:
    """Write an object of Infinigen as one that stands in a kitchen.

    Args:
        urdf: As drawn; none of its frames is turned.
        height: That it shall have [m].
        home: Folder for the URDF and its meshes.

    Returns:
        The URDF file.
    """
    home.mkdir(parents=True, exist_ok=True)
    places = _origins(urdf)
    shapes = {name: list(_shapes(link, places[name])) for name, link in urdf.links.items()}
    scale = height / np.ptp([z for one in shapes.values() for m in one for z in m.bounds[:, 2]])
    owner = {name: _owner(urdf, name) for name in urdf.links}
    moving = [joint for joint in urdf.joints if owner[joint.child] == joint.child]
    places[BODY] = np.zeros(3)
    robot = ElementTree.Element("robot", name=home.name)
    colors: set[Color] = set()
    for name in (BODY, *(joint.child for joint in moving)):
        link = ElementTree.SubElement(robot, "link", name=name)
        meshes = [mesh for one, mine in shapes.items() if owner[one] == name for mesh in mine]
        for k, mesh in enumerate(meshes):
            points = scale * (mesh.vertices - places[name]) @ _TURNED.T
            file = home / f"{name}_{k}.obj"
            file.write_text(_obj(points, mesh, colors), encoding="utf-8")
            for kind in ("visual", "collision"):
                shape = ElementTree.SubElement(link, kind, name=file.stem)
                geometry = ElementTree.SubElement(shape, "geometry")
                ElementTree.SubElement(geometry, "mesh", filename=file.name)
    for joint in moving:
        parent = owner[joint.parent]
        robot.append(_joint(joint, parent, places[joint.child] - places[parent], scale))
    paints = (f"newmtl {_paint(c)}\nKd {_words((np.array(c) + 0.5) / LEVELS)}\n" for c in colors)
    (home / PAINTS).write_text("".join(sorted(paints)), encoding="utf-8")
    path = home / "model.urdf"
    ElementTree.indent(robot)
    ElementTree.ElementTree(robot).write(path)
    return path


def _joint(joint: Joint, parent: str, at: np.ndarray, scale: float) -> ElementTree.Element:
    element = ElementTree.Element("joint", name=joint.name, type=joint.kind)
    ElementTree.SubElement(element, "parent", link=parent)
    ElementTree.SubElement(element, "child", link=joint.child)
    ElementTree.SubElement(element, "origin", xyz=_words(scale * _TURNED @ at))
    ElementTree.SubElement(element, "axis", xyz=_words(_TURNED @ joint.axis))
    unit = scale if joint.kind == "prismatic" else 1.0
    limits = {"lower": f"{unit * joint.lower:.6f}", "upper": f"{unit * joint.upper:.6f}"}
    ElementTree.SubElement(element, "limit", limits, effort="100", velocity="1")
    return element


def _origins(urdf: Urdf) -> dict[str, np.ndarray]:
    """Where the frame of each link is, in the first one [m]."""
    above = {joint.child: joint for joint in urdf.joints}
    origins = {}
    for name in urdf.links:
        at, link = np.zeros(3), name
        while link in above:
            at = at + above[link].T_parent_joint[:3, 3]
            link = above[link].parent
        origins[name] = at
    return origins


def _owner(urdf: Urdf, name: str) -> str:
    """The door or drawer that a link is part of, or the body."""
    above = {joint.child: joint for joint in urdf.joints}
    while name in above:
        joint = above[name]
        word = MOVES.get(joint.kind, "")
        if word and any(word in Path(g.mesh).stem for g in urdf.links[name].visuals if g.mesh):
            return name
        name = joint.parent
    return BODY


def _shapes(link: Link, at: np.ndarray) -> Iterable[trimesh.Trimesh]:
    """The meshes of a link in the first link's frame, each face with a color."""
    for shape in link.visuals:
        mesh = trimesh.load(shape.mesh, force="mesh", process=False)
        mesh.apply_translation(at + shape.T_link_geometry[:3, 3])
        if len(mesh.faces):
            yield mesh


def _obj(points: np.ndarray, mesh: trimesh.Trimesh, colors: set[Color]) -> str:
    """A mesh as an OBJ file; its colors are added to `colors`."""
    visual = mesh.visual if isinstance(mesh.visual, ColorVisuals) else mesh.visual.to_color()
    shades = visual.vertex_colors[mesh.faces, :3].mean(axis=1)
    shades = (shades * LEVELS / 256).astype(int)
    lines = [f"mtllib {PAINTS}", *(f"v {_words(point)}" for point in points)]
    for color in np.unique(shades, axis=0):
        r, g, b = color.tolist()
        colors.add((r, g, b))
        lines.append(f"usemtl {_paint((r, g, b))}")
        faces = mesh.faces[(shades == color).all(axis=1)] + 1
        lines += [f"f {i} {j} {k}" for i, j, k in faces.tolist()]
    return "\n".join(lines) + "\n"


def _paint(color: Color) -> str:
    return "rgb_{}_{}_{}".format(*color)


def _words(values: np.ndarray) -> str:
    return " ".join(f"{v:.6f}" for v in values)


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drawn", type=Path, help="folder with what Infinigen drew")
    parser.add_argument("--out", type=Path, required=True, help="folder for the URDFs")
    args = parser.parse_args()
    rows = []
    for file in sorted(args.drawn.glob("dishwasher/*/dishwasher.urdf")):
        name = f"Infinigen/dishwasher/{file.parent.name}"
        urdf = write(read_urdf(file), HEIGHT, args.out / name.replace("/", "_"))
        path = urdf.relative_to(args.out).as_posix()
        rows.append({"name": name, "urdf": path, "above": 0.0, "counter": False})
    if not rows:
        sys.exit(f"{args.drawn}: nothing of Infinigen is there; see --help")
    (args.out / "models.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(f"{dict(Counter(half_of(str(row['name'])) for row in rows))} in {args.out}")


if __name__ == "__main__":
    main()
