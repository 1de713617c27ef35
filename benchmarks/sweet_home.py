"""Convert Sweet Home 3D furniture to URDFs: doors and drawers that momapos is not tuned to.

    apt-get download sweethome3d sweethome3d-furniture && for f in *.deb; do dpkg-deb -x $f x; done
    python benchmarks/sweet_home.py x/usr/share/sweethome3d --out FOLDER
    python benchmarks/scan_objects.py --models FOLDER --no-answers

The interior design program names the moving parts of its models (`opening_on_hinge_1`) and their
fittings (`hinge_1`). Each part becomes a joint: a hinge turns about the longest side of the box
around its fittings, toward the front, or upward for a lid on top; a drawer slides forward. Parts
without fittings, or as slim as a tap, are fixed. Colors come from a model's material file or from
the program's own list; textured and unknown materials have none. The repository contains none of
these models. A hash of the name decides whether a model is in the development or the test set, as
in `objects.py`.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from momapos.core.geometry import pose
from momapos.model.scene.formats import urdf_text
from momapos.model.urdf import Geometry, Joint, JointKind, Link, Urdf

KINDS = frozenset(
    (
        "chest", "clothesWasher", "cooker", "desk", "dishwasher", "dresser", "fridge",
        "fridgeFreezer", "glassDoorCabinet", "kitchenCabinet", "kitchenUpperCabinet", "oven",
        "sink", "sinkCabinet", "small-oven", "wardrobe", "washbasinWithCabinet",
    )
)  # fmt: skip
"""Model names of furniture with doors or drawers."""
MAX_SMALL_HEIGHT, COUNTER = 0.5, 0.9
"""Lower furniture that does not hang is placed on a counter, and the counter's height [m]."""
MIN_SIZE = 0.2
"""Parts narrower than this in two directions are taps or knobs, not doors or drawers [m]."""
TURN, SLIDE = np.pi / 2, 0.7
"""Range of doors [rad], and of drawers as a share of their depth [-]."""
_LIST = "FurnitureCatalog.properties"
_LOADER = "OBJLoader.class"
_MOVING = re.compile(
    r"(?<!\S)sweethome3d_(?:opening|window_pane|window_mirror)_on_(hinge|rail)_([^\W_]+)", re.I
)
_SPECIAL = re.compile(r"(?<!\S)sweethome3d_", re.I)
_TURNED = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Turns y up, front toward z, to z up, front toward -y."""


@dataclass(frozen=True)
class Model:
    """One piece of furniture of a catalog."""

    name: str
    creator: str
    size: tuple[float, float, float]
    """Width, depth, height [m]."""
    above: float
    """Height of its lower side above the floor [m]."""
    counter: bool
    """Whether it stands on a counter."""
    text: str
    """Content of its OBJ file."""
    paints: dict[str, str]
    """Diffuse color of each material that has one, as text."""

    @cached_property
    def placed(self) -> tuple[np.ndarray, list[Group]]:
        """Return vertices (n, 3) [m], z up, front toward -y, origin in the center; and groups."""
        points, groups = read_groups(self.text)
        points = points @ _TURNED.T
        used = points[sorted({k for group in groups for k in group.corners()})]
        low, high = used.min(axis=0), used.max(axis=0)
        return (points - (low + high) / 2) * (np.array(self.size) / (high - low)), groups

    @cached_property
    def moving(self) -> tuple[dict[str, list[Group]], dict[str, str]]:
        """Return groups of the body and by joint, and why other named parts are fixed."""
        return moving_parts(*self.placed)


@dataclass(frozen=True)
class Group:
    """A named part of an OBJ file."""

    name: str
    """Name of the group; the object's name if only that names a moving part."""
    faces: dict[str, list[list[int]]]
    """Vertex indices of its faces by material, from 0."""

    def corners(self) -> list[int]:
        """Return all vertex indices that it uses."""
        return sorted({k for faces in self.faces.values() for face in faces for k in face})


def models(folder: Path) -> Iterator[Model]:
    """Yield furniture with doors or drawers of the program and of its additional libraries.

    Args:
        folder: Contains `sweethome3d.jar` and `furniture/*.sh3f`, in one or more folders.
    """
    archives = [*sorted(folder.rglob("sweethome3d.jar")), *sorted(folder.rglob("*.sh3f"))]
    if not archives:
        sys.exit(f"{folder}: contains no sweethome3d.jar; name the folder of the unpacked package")
    usual: dict[str, str] = {}
    for archive in archives:
        try:
            with zipfile.ZipFile(archive) as file:
                for name in file.namelist():
                    if name.endswith(_LOADER):
                        usual = paints(file.read(name))
                yield from _of_archive(file, usual)
        except (zipfile.BadZipFile, KeyError, ValueError) as error:
            sys.exit(f"{archive}: not a furniture library of Sweet Home 3D ({error})")


def _of_archive(file: zipfile.ZipFile, usual: dict[str, str]) -> Iterator[Model]:
    """Yield furniture with doors or drawers of one archive."""
    names = frozenset(file.namelist())
    catalogs = [name for name in names if name.endswith(_LIST)]
    if not catalogs:
        raise ValueError(f"it contains no {_LIST}")
    for entry in _entries(file.read(catalogs[0]).decode("latin-1")):
        path = entry.get("model", "").lstrip("/")
        if Path(path).stem not in KINDS or not path.endswith(".obj") or "modelRotation" in entry:
            continue
        text = file.read(path).decode(errors="replace")
        if _MOVING.search(text):
            mtl = path.removesuffix(".obj") + ".mtl"
            own = paints(file.read(mtl)) if mtl in names else {}
            yield _model(Path(path).stem, entry, text, usual | own)


def _entries(text: str) -> list[dict[str, str]]:
    """Return the entries of a catalog."""
    found: dict[str, dict[str, str]] = {}
    for key, number, value in re.findall(r"^(\w+)#(\d+)=(.*?)\s*$", text, re.MULTILINE):
        found.setdefault(number, {})[key] = value
    return list(found.values())


def _model(name: str, entry: dict[str, str], text: str, found: dict[str, str]) -> Model:
    width, depth, height = (float(entry[key]) / 100 for key in ("width", "depth", "height"))
    above = float(entry.get("elevation", "0")) / 100
    counter = height < MAX_SMALL_HEIGHT and above == 0.0
    given = {material: color for material, color in found.items() if color}
    size, above = (width, depth, height), COUNTER if counter else above
    creator = re.sub(r"^\.+|[^\w .-]", "_", entry["creator"])  # it becomes a folder
    return Model(name, creator, size, above, counter, text, given)


def paints(data: bytes) -> dict[str, str]:
    """Return the diffuse color of each material; "" with a texture or without a color.

    Args:
        data: A material file, or a class file that contains its text.
    """
    found: dict[str, str] = {}
    for block in data.decode(errors="replace").split("newmtl ")[1:]:
        name, _, rest = block.partition("\n")
        keys = [line.split(None, 1) for line in rest.split("\n")]
        values = {words[0]: words[1].strip() for words in keys if len(words) == 2}
        color = "" if "map_Kd" in values else values.get("Kd", "")
        found[name.strip()] = color if re.fullmatch(r"[\d.eE+-]+(\s+[\d.eE+-]+){2}", color) else ""
    return found


def read_groups(text: str) -> tuple[np.ndarray, list[Group]]:
    """Return the vertices (n, 3) of an OBJ file, and its groups.

    Exporters write groups, objects or both: a group's own name counts, unless the program only
    knows its object's name.
    """
    points: list[list[float]] = []
    groups: dict[str, Group] = {}
    whole, group, material = "body", "body", ""
    for line in text.split("\n"):
        head, *words = line.split(None, 1)[:2] or ("",)
        rest = words[0] if words else ""
        if head == "v":
            points.append([float(word) for word in rest.split()[:3]])
        elif head == "o":
            whole = group = rest.strip()
        elif head == "g":
            known = _SPECIAL.search(rest) or not _SPECIAL.search(whole)
            group = rest.strip() if known else whole
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
    points, groups = model.placed
    moving, _ = model.moving
    joints = tuple(
        _joint(key, points, groups, moving[key]) for key in sorted(moving.keys() - {"body"})
    )
    origins = {joint.name: joint.T_parent_joint[:3, 3] for joint in joints}
    (home / "paints.mtl").write_text(
        "".join(f"newmtl {name}\nKd {color}\n" for name, color in model.paints.items()),
        encoding="utf-8",
    )
    links = {}
    for key, own in moving.items():
        shapes = []
        for k, group in enumerate(own):
            mesh = home / f"{key}_{k}.obj"
            text = _mesh(points - origins.get(key, np.zeros(3)), group)
            mesh.write_text(text, encoding="utf-8")
            file = Path(mesh.name)
            shapes.append(Geometry("mesh", (1.0, 1.0, 1.0), np.eye(4), group.name, file))
        links[key] = Link(key, tuple(shapes), tuple(shapes))
    path = home / "model.urdf"
    path.write_text(urdf_text(Urdf(model.name, None, "body", links, joints)), encoding="utf-8")
    return path


def _key(group: Group) -> str:
    """Return the joint of a group's name: `hinge_1`, `rail_2`; `body` if none."""
    match = _MOVING.search(group.name)
    return f"{match[1].lower()}_{match[2]}" if match else "body"


def _fittings(key: str, groups: list[Group]) -> list[int]:
    """Return all vertices of a hinge's fittings."""
    names = re.compile(rf"(?<!\S)sweethome3d_{key}(?![^\W_])", re.I)
    return sorted({k for group in groups if names.search(group.name) for k in group.corners()})


def moving_parts(
    points: np.ndarray, groups: list[Group]
) -> tuple[dict[str, list[Group]], dict[str, str]]:
    """Separate moving from fixed groups.

    Returns:
        Groups of the body and by joint, and why other named groups are fixed.
    """
    by_joint: dict[str, list[Group]] = {"body": []}
    for group in groups:
        by_joint.setdefault(_key(group), []).append(group)
    fixed: dict[str, str] = {}
    for key in sorted(by_joint.keys() - {"body"}):
        own = [k for group in by_joint[key] for k in group.corners()]
        if np.sort(np.ptp(points[own], axis=0))[1] < MIN_SIZE:
            fixed[key] = "slim"
        elif key.startswith("hinge") and not _fittings(key, groups):
            fixed[key] = "no fittings"
    for key in fixed:
        by_joint["body"] += by_joint.pop(key)
    return by_joint, fixed


def _joint(key: str, points: np.ndarray, groups: list[Group], own: list[Group]) -> Joint:
    """Return the joint of a moving part."""
    part = points[sorted({k for group in own for k in group.corners()})]
    kind = key.split("_")[0]
    origin = np.zeros(3)
    if kind == "rail":
        axis, upper = np.array([0.0, -1.0, 0.0]), SLIDE * float(np.ptp(part[:, 1]))
    else:
        fittings = points[_fittings(key, groups)]
        low, high = fittings.min(axis=0), fittings.max(axis=0)
        origin = (low + high) / 2
        axis, upper = np.eye(3)[np.argmax(high - low)], TURN
        first = np.cross(axis, (part.min(axis=0) + part.max(axis=0)) / 2 - origin)
        # A door first moves forward or backward, a lid up or down: the larger motion decides.
        toward = -first[1] if abs(first[1]) >= abs(first[2]) else first[2]
        axis = axis if toward > 0 else -axis
    joint_kind: JointKind = "revolute" if kind == "hinge" else "prismatic"
    return Joint(
        key, joint_kind, "body", key, pose(origin), axis, 0.0, upper, velocity=1.0, effort=100.0
    )


def _mesh(points: np.ndarray, group: Group) -> str:
    """Return a group as an OBJ file."""
    kept = group.corners()
    index = {old: new + 1 for new, old in enumerate(kept)}
    lines = ["mtllib paints.mtl"]
    lines += ["v " + " ".join(f"{v:.6f}" for v in points[k]) for k in kept]
    for material, faces in group.faces.items():
        lines.append(f"usemtl {material}")
        lines += ["f " + " ".join(str(index[k]) for k in face) for face in faces]
    return "\n".join(lines) + "\n"


def describe(model: Model) -> str:
    """Describe a converted model in one line."""
    moving, fixed = model.moving
    used = {material for group in model.placed[1] for material in group.faces}
    bare = len(used - model.paints.keys())
    line = f"{len(moving) - 1} joints, {bare} of {len(used)} materials have no color"
    return "; ".join([line, *(f"{key} is fixed: {why}" for key, why in fixed.items())])


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="the unpacked packages")
    parser.add_argument("--out", type=Path, required=True, help="folder for the URDFs")
    args = parser.parse_args()
    rows: dict[str, dict[str, object]] = {}
    for model in models(args.folder):
        name = f"SweetHome3D/{model.name}/{model.creator}"
        if name in rows:
            continue
        try:
            print(f"{name}: {describe(model)}")
            if len(model.moving[0]) == 1:
                continue
            file = write(model, args.out / model.creator / model.name)
        except (ValueError, IndexError) as error:
            sys.exit(f"{name}: not a usable OBJ file ({error})")
        rows[name] = {
            "name": name, "urdf": file.relative_to(args.out).as_posix(),
            "above": model.above, "counter": model.counter,
        }  # fmt: skip
    if not rows:
        sys.exit(f"{args.folder}: none of its furniture has doors or drawers that move")
    (args.out / "models.json").write_text(json.dumps(list(rows.values()), indent=1) + "\n")
    print(f"{len(rows)} models in {args.out}")


if __name__ == "__main__":
    main()
