"""Furniture of Sweet Home 3D as URDFs: doors and drawers that nothing here was tuned to.

    apt-get download sweethome3d sweethome3d-furniture && for f in *.deb; do dpkg-deb -x $f x; done
    python benchmarks/sweet_home.py x/usr/share/sweethome3d --out FOLDER
    python benchmarks/scan_objects.py --models FOLDER --no-answers

The interior design program names the parts of its models that move (`opening_on_hinge_1`), what
they turn about (`hinge_1`) and what they slide along (`rail_1`, `unique_rail`). Each becomes a
joint: a hinge turns about the longest side of the box about its fittings, a drawer slides forward.
Nothing of these models is part of the repository. Of furniture of this kind, a hash of the name
says which half may be looked at, as in `objects.py`.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

KINDS = frozenset(
    (
        "chest", "clothesWasher", "cooker", "desk", "dishwasher", "dresser", "fridge",
        "fridgeFreezer", "glassDoorCabinet", "kitchenCabinet", "kitchenUpperCabinet", "oven",
        "sink", "sinkCabinet", "small-oven", "wardrobe", "washbasinWithCabinet",
    )
)  # fmt: skip
"""Furniture with doors or drawers, by the names of its models."""
ON_COUNTER = frozenset(("oven", "small-oven"))
COUNTER = 0.9
"""Height of what small ovens stand on [m]."""
TURN, SLIDE = np.pi / 2, 0.7
"""How far doors open [rad], and drawers, as a share of their depth."""
_LIST = "FurnitureCatalog.properties"
_LOADER = "OBJLoader.class"
_MOVING = re.compile(r"sweethome3d_(?:opening|window_pane)_on_(hinge|rail)_(\d+)")
_MATERIAL = re.compile(rb"newmtl ([\w.]+)\n(?:K[as] [^\n]*\n)*?Kd ([\d. ]+)\n")
_TURNED = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From y up, front toward z, to z up, front toward -y."""


@dataclass(frozen=True)
class Model:
    """One piece of furniture as its catalog has it."""

    name: str
    creator: str
    size: tuple[float, float, float]
    """Width, depth, height [m]."""
    above: float
    """Floor to its lower side [m]."""
    text: str
    """Its OBJ file."""
    paints: dict[str, str]
    """Diffuse color of each material, as its files write it."""


@dataclass(frozen=True)
class Group:
    """A named part of an OBJ file."""

    name: str
    faces: dict[str, list[list[int]]]
    """Corners of its faces by material, counted from 0."""

    def corners(self) -> list[int]:
        """Every vertex that it uses."""
        return sorted({k for faces in self.faces.values() for face in faces for k in face})


def models(folder: Path) -> Iterator[Model]:
    """Furniture with doors or drawers, of the program and of its further libraries.

    Args:
        folder: Holds `sweethome3d.jar` and `furniture/*.sh3f`, in one or more folders.
    """
    archives = [*sorted(folder.rglob("sweethome3d.jar")), *sorted(folder.rglob("*.sh3f"))]
    if not archives:
        sys.exit(f"{folder}: holds no sweethome3d.jar; name the folder of the unpacked package")
    usual: dict[str, str] = {}
    for archive in archives:
        with zipfile.ZipFile(archive) as file:
            for name in file.namelist():
                if name.endswith(_LOADER):
                    usual = _paints(file.read(name))
            catalog = next(n for n in file.namelist() if n.endswith(_LIST))
            for entry in _entries(file.read(catalog).decode("latin-1")):
                if (path := entry.get("model", "").lstrip("/")).endswith(".obj"):
                    name = Path(path).stem
                    if name not in KINDS or "rotation" in entry:
                        continue
                    text = file.read(path).decode("latin-1")
                    if not _MOVING.search(text):
                        continue
                    beside = path.removesuffix(".obj") + ".mtl"
                    own = _paints(file.read(beside)) if beside in file.namelist() else {}
                    yield _model(name, entry, text, usual | own)


def _entries(text: str) -> list[dict[str, str]]:
    """What a catalog says about each of its models."""
    found: dict[str, dict[str, str]] = {}
    for key, number, value in re.findall(r"^(\w+)#(\d+)=(.*?)\s*$", text, re.MULTILINE):
        found.setdefault(number, {})[key] = value
    return list(found.values())


def _model(name: str, entry: dict[str, str], text: str, paints: dict[str, str]) -> Model:
    width, depth, height = (float(entry[key]) / 100 for key in ("width", "depth", "height"))
    above = float(entry.get("elevation", "0")) / 100
    above = COUNTER if name in ON_COUNTER else above
    return Model(name, entry["creator"], (width, depth, height), above, text, paints)


def _paints(data: bytes) -> dict[str, str]:
    return {name.decode(): color.decode() for name, color in _MATERIAL.findall(data)}


def read_groups(text: str) -> tuple[np.ndarray, list[Group]]:
    """Vertices (n, 3) of an OBJ file, and its groups."""
    points: list[list[float]] = []
    groups: dict[str, Group] = {}
    group, material = "body", ""
    for line in text.splitlines():
        head, _, rest = line.strip().partition(" ")
        if head == "v":
            points.append([float(word) for word in rest.split()[:3]])
        elif head == "g":
            group = rest.strip()
        elif head == "usemtl":
            material = rest.strip()
        elif head == "f":
            face = [int(word.split("/", 1)[0]) for word in rest.split()]
            face = [k - 1 if k > 0 else len(points) + k for k in face]
            own = groups.setdefault(group, Group(group, {}))
            own.faces.setdefault(material, []).append(face)
    return np.array(points), list(groups.values())


def write(model: Model, home: Path) -> Path:
    """Write a model as a URDF with a mesh for each group; its front is toward -y.

    Returns:
        The URDF file.
    """
    home.mkdir(parents=True, exist_ok=True)
    points, groups = read_groups(model.text)
    points = points @ _TURNED.T
    used = points[sorted({k for group in groups for k in group.corners()})]
    low, high = used.min(axis=0), used.max(axis=0)
    points = (points - (low + high) / 2) * (np.array(model.size) / (high - low))

    robot = ElementTree.Element("robot", name=model.name)
    links: dict[str, ElementTree.Element] = {}
    origins: dict[str, np.ndarray] = {}
    moving: dict[str, list[Group]] = {}
    for group in groups:
        match = _MOVING.match(group.name)
        key = f"{match[1]}_{match[2]}" if match else "body"
        moving.setdefault(key, []).append(group)
    for key in sorted(moving):
        links[key] = ElementTree.SubElement(robot, "link", name=key)
        origins[key] = np.zeros(3)
    for key in links:
        if key != "body":
            origins[key] = _joint(robot, key, points, groups, moving[key])
    (home / "paints.mtl").write_text(
        "".join(f"newmtl {name}\nKd {color}\n" for name, color in model.paints.items())
    )
    for key, own in moving.items():
        for k, group in enumerate(own):
            mesh = home / f"{key}_{k}.obj"
            mesh.write_text(_mesh(points - origins[key], group))
            for kind in ("visual", "collision"):
                shape = ElementTree.SubElement(links[key], kind, name=group.name)
                ElementTree.SubElement(
                    ElementTree.SubElement(shape, "geometry"), "mesh", filename=mesh.name
                )
    file = home / "model.urdf"
    ElementTree.indent(robot)
    ElementTree.ElementTree(robot).write(file)
    return file


def _joint(
    robot: ElementTree.Element, key: str, points: np.ndarray, groups: list[Group], own: list[Group]
) -> np.ndarray:
    """Add the joint of a moving part; return its origin [m]."""
    part = points[sorted({k for group in own for k in group.corners()})]
    kind, number = key.split("_")
    origin = np.zeros(3)
    if kind == "rail":
        axis, upper = np.array([0.0, -1.0, 0.0]), SLIDE * float(np.ptp(part[:, 1]))
    else:
        names = re.compile(rf"sweethome3d_hinge_{number}(?:_|$)")
        corners = {k for group in groups if names.match(group.name) for k in group.corners()}
        fittings = points[sorted(corners)]
        low, high = fittings.min(axis=0), fittings.max(axis=0)
        origin = (low + high) / 2
        axis, upper = np.eye(3)[np.argmax(high - low)], TURN
        # it opens toward the front
        way = np.cross(axis, (part.min(axis=0) + part.max(axis=0)) / 2 - origin)
        axis = axis if way[1] < 0 else -axis
    joint = ElementTree.SubElement(
        robot, "joint", name=key, type="revolute" if kind == "hinge" else "prismatic"
    )
    ElementTree.SubElement(joint, "parent", link="body")
    ElementTree.SubElement(joint, "child", link=key)
    ElementTree.SubElement(joint, "origin", xyz=" ".join(f"{v:.6f}" for v in origin))
    ElementTree.SubElement(joint, "axis", xyz=" ".join(f"{v:g}" for v in axis))
    ElementTree.SubElement(
        joint, "limit", lower="0", upper=f"{upper:.6f}", effort="100", velocity="1"
    )
    return origin


def _mesh(points: np.ndarray, group: Group) -> str:
    """A group as an OBJ file of its own."""
    kept = group.corners()
    index = {old: new + 1 for new, old in enumerate(kept)}
    lines = ["mtllib paints.mtl"]
    lines += ["v " + " ".join(f"{v:.6f}" for v in points[k]) for k in kept]
    for material, faces in group.faces.items():
        lines.append(f"usemtl {material}")
        lines += ["f " + " ".join(str(index[k]) for k in face) for face in faces]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="the unpacked packages")
    parser.add_argument("--out", type=Path, required=True, help="folder for the URDFs")
    args = parser.parse_args()
    rows = []
    for model in models(args.folder):
        name = f"SweetHome3D/{model.name}/{model.creator}"
        file = write(model, args.out / model.creator / model.name)
        rows.append(
            {
                "name": name, "urdf": file.relative_to(args.out).as_posix(),
                "above": model.above, "counter": model.name in ON_COUNTER,
            }
        )  # fmt: skip
    (args.out / "models.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(f"{len(rows)} models in {args.out}")


if __name__ == "__main__":
    main()
