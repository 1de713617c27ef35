"""Read rooms in MJCF, MuJoCo's format, from the model that MuJoCo compiles.

Every body and every geom of the world becomes an object. If a body only contains several fixed
bodies, these become objects instead.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import tostring

import numpy as np

from momapos.core import FileFormatError, require
from momapos.core.geometry import pose, pose_wxyz
from momapos.model.urdf import Mimic

from .imported_room import ImportedRoom, ImportReport, Names
from .mjcf_files import OWN_TEXT, Mjcf, read_mjcf
from .mjcf_shapes import GeomShapes
from .mjcf_tree import Tree

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_FLOOR_HEIGHT = 1e-3
"""Height above the floor up to which fixed geometry counts as floor [m]."""
MAX_NONLINEAR_COEFFICIENT = 1e-9
"""Maximum nonlinear coefficient of a linear joint coupling [-]."""
_FLOORS = ("floor", "ground")


def read_room(path: Path, root: Path) -> ImportedRoom:
    """Read a room in MJCF.

    Args:
        path: The file.
        root: Folder that no file may leave.

    Raises:
        FileFormatError: The file is invalid; one line says what is wrong and where.
        MissingExtraError: MuJoCo is not installed.
    """
    with require("physics"):
        import mujoco

    source = read_mjcf(path, root)
    text = tostring(source.tree, encoding="unicode")
    try:
        model = mujoco.MjModel.from_xml_string(text, source.meshes)
    except ValueError as error:
        raise FileFormatError(f"{path}: MuJoCo rejects it: {error}") from error
    return _Reader(path, model, source).room()


@dataclass
class _Reader:
    """Converts a compiled model to our records."""

    path: Path
    model: Any
    source: Mjcf
    report: ImportReport = field(default_factory=ImportReport)

    def __post_init__(self) -> None:
        m = self.model
        self.shapes = GeomShapes(m, self.report.approximated, self.report.dropped)
        self.children: dict[int, list[int]] = defaultdict(list)
        self.poses = [np.eye(4)]
        for body in range(1, m.nbody):
            parent = int(m.body_parentid[body])
            self.children[parent].append(body)
            T = pose_wxyz(tuple(m.body_pos[body].tolist()), tuple(m.body_quat[body].tolist()))
            self.poses.append(self.poses[parent] @ T)

    def room(self) -> ImportedRoom:
        """Return the room; the report counts what it lacks."""
        own = _own_members(self.source.own_text, self.path)
        self.report.dropped.update(self.source.dropped)
        self.report.dropped["sites"] += int(self.model.nsite)
        height = self._floor()
        if height:
            self.report.notes.append(f"moved by {-height:.4g} m along z, so that the floor is at 0")
        trees = self._trees(height)
        follows = self._follows([tree for tree, _ in trees])
        T_room = pose(np.array([0.0, 0.0, -height]))
        extras = own.get("objects", {})
        objects = tuple(
            tree.object(T_room @ T, follows, extras.get(tree.name, {})) for tree, T in trees
        )
        self._tell([tree for tree, _ in trees])
        used = {
            shape.mesh
            for item in objects
            for link in item.urdf.links.values()
            for shape in (*link.collisions, *link.visuals)
        }
        meshes = {file: mesh for file, mesh in self.shapes.meshes.items() if file in used}
        members = {key: value for key, value in own.items() if key in ("floor", "start", "areas")}
        return ImportedRoom(self.path.stem, objects, meshes, self.report, members)

    def _trees(self, height: float) -> list[tuple[Tree, Float[np.ndarray, "4 4"]]]:
        """Return the objects on the floor, and their poses."""
        m, roots = self.model, self._roots()
        geoms = [geom for geom in range(m.body_geomnum[0]) if not self._is_level(geom)]
        self.report.dropped["floors"] += int(m.body_geomnum[0]) - len(geoms)
        names = _object_names([
            *(m.geom(geom).name or f"geom_{geom}" for geom in geoms),
            *(self._named(body) for body in roots),
        ])  # fmt: skip
        trees = []
        for number, (name, prefix, link) in enumerate(names):
            tree = Tree(m, self.shapes, self.children, name, prefix, self.report.approximated)
            if number < len(geoms):
                tree.add_geom(geoms[number], link)
                T = self.shapes.pose(geoms[number])
            else:
                body = roots[number - len(geoms)]
                tree.add_body(body, link)
                T = self.poses[body]
            if self._stands(tree, height):
                trees.append((tree, T))
        return trees

    def _roots(self) -> list[int]:
        roots, waiting = [], list(reversed(self.children[0]))
        while waiting:
            body = waiting.pop()
            parts = self.children[body]
            still = not self.model.body_jntnum[[body, *parts]].any()
            if still and len(parts) > 1 and not self.model.body_geomnum[body]:
                waiting += reversed(parts)
            else:
                roots.append(body)
        return roots

    def _named(self, body: int) -> str:
        """Return the name of a body, or of the first named body below it."""
        waiting = [body]
        while waiting:
            part = waiting.pop()
            if name := self.model.body(part).name:
                return str(name)
            waiting += reversed(self.children[part])
        return f"body_{body}"

    def _stands(self, tree: Tree, height: float) -> bool:
        """Return whether an object has collision shapes above the floor; count it otherwise."""
        tops = [self._top(geom) for geom in tree.solid]
        if tops and (tree.joints or max(tops) > height + MAX_FLOOR_HEIGHT):
            return True
        self.report.dropped["floors" if tops else "objects without collision shapes"] += 1
        return False

    def _floor(self) -> float:
        """Return the height of the lowest horizontal plane, or of geometry named floor [m]."""
        m = self.model
        still = [g for g in range(m.ngeom) if m.body_weldid[m.geom_bodyid[g]] == 0]
        planes = [self._top(geom) for geom in still if self._is_level(geom)]
        named = [
            self._top(geom)
            for geom in still
            if any(
                word in f"{m.geom(geom).name} {m.body(int(m.geom_bodyid[geom])).name}".lower()
                for word in _FLOORS
            )
        ]
        return min(planes or named or [0.0])

    def _is_level(self, geom: int) -> bool:
        return self.shapes.level(geom, self.poses[int(self.model.geom_bodyid[geom])])

    def _top(self, geom: int) -> float:
        return self.shapes.top(geom, self.poses[int(self.model.geom_bodyid[geom])])

    def _follows(self, trees: Sequence[Tree]) -> dict[int, Mimic]:
        """Return the mimic relations by MuJoCo's joint index; only linear couplings count."""
        m, follows = self.model, {}
        owner = {number: tree for tree in trees for number in tree.joints}
        for k in range(m.neq):
            one, other = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
            offset, ratio, *bent = m.eq_data[k, :5].tolist()
            straight = max(map(abs, bent)) < MAX_NONLINEAR_COEFFICIENT and ratio != 0.0
            kept = (
                straight and one in owner and owner[one] is owner.get(other)
                and one not in follows and m.eq_active0[k]
            )  # fmt: skip
            if not kept:
                self.report.dropped["equality constraints (joint)"] += 1
                continue
            start, begin = (float(m.qpos0[m.jnt_qposadr[joint]]) for joint in (one, other))
            leader = owner[other].joints[other].name
            follows[one] = Mimic(leader, ratio, start + offset - ratio * begin)
        return follows

    def _tell(self, trees: Sequence[Tree]) -> None:
        """Count joints without a counterpart, and note objects that may be robots."""
        import mujoco

        kinds = Counter(self.model.jnt_type.tolist())
        self.report.kept["free joints"] = kinds[int(mujoco.mjtJoint.mjJNT_FREE)]
        balls = kinds[int(mujoco.mjtJoint.mjJNT_BALL)]
        self.report.approximated["ball joints as fixed"] += balls
        driven = {int(self.model.joint(name).id) for name in self.source.driven}
        for tree in trees:
            if count := len(driven & tree.joints.keys()):
                self.report.notes.append(
                    f"actuators drive {count} joints of {tree.name!r}; if it is a robot, exclude "
                    f"it: without {tree.name}"
                )


def _object_names(full: Sequence[str]) -> list[tuple[str, str, str]]:
    """Return for each body the object's name, the prefix of its part names, and the link's name.

    Programs that combine models name all parts of one MODEL/PART.
    """
    heads = Counter(name.partition("/")[0] for name in full)
    names, found = Names(), []
    for name in full:
        head, _, rest = name.partition("/")
        prefix = head if heads[head] == 1 else name
        found.append((names(prefix, "object"), prefix, rest if prefix == head and rest else prefix))
    return found


def _own_members(text: str | None, path: Path) -> dict[str, Any]:
    """Return what our MJCF writer adds to the model.

    The values are checked when the scene is read.
    """
    damaged = FileFormatError(f"{path}: the custom text {OWN_TEXT!r} is invalid")
    try:
        own = json.loads(text or "{}")
    except (ValueError, RecursionError) as error:
        raise damaged from error
    objects = own.get("objects", {}) if isinstance(own, dict) else None
    if not (isinstance(objects, dict) and all(isinstance(item, dict) for item in objects.values())):
        raise damaged
    return {str(key): value for key, value in own.items()}
