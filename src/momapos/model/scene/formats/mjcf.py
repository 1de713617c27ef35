"""Read rooms and robots in MJCF, MuJoCo's format, from the model that MuJoCo compiles.

Every body and every geom of the world becomes an object. If a body only contains several fixed
bodies, these become objects instead. A robot is one body of the world, with sites as frames.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import tostring

import numpy as np

from momapos.core import FileFormatError, require
from momapos.core.geometry import invert, pose, pose_wxyz
from momapos.model.urdf import (
    Geometry,
    Joint,
    JointKind,
    Link,
    Mesh,
    Mimic,
    Urdf,
    capsule_shapes,
    joint_motion,
)

from .imported_room import (
    MIN_FLOOR_NORMAL_Z,
    ImportedRoom,
    ImportReport,
    Names,
    RoomObject,
    ellipsoid,
    plane,
)
from .mjcf_files import OWN_TEXT, Mjcf, read_mjcf

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass
class GeomShapes:
    """Converts geoms to shapes, and counts approximations."""

    model: Any
    approximated: Counter[str]
    dropped: Counter[str]
    meshes: dict[Path, Mesh] = field(default_factory=dict)
    """Meshes of the converted shapes, by file name."""

    def solid(self, geom: int) -> bool:
        """Return whether a geom has collisions."""
        return bool(self.model.geom_contype[geom] or self.model.geom_conaffinity[geom])

    def pose(self, geom: int) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a geom in its body's frame."""
        return pose_wxyz(
            tuple(self.model.geom_pos[geom].tolist()), tuple(self.model.geom_quat[geom].tolist())
        )

    def level(self, geom: int, T_world_body: Float[np.ndarray, "4 4"]) -> bool:
        """Return whether a geom is a floor plane."""
        upward = (T_world_body @ self.pose(geom))[2, 2]
        return self._kind(geom) == "plane" and bool(upward >= MIN_FLOOR_NORMAL_Z)

    def top(self, geom: int, T_world_body: Float[np.ndarray, "4 4"]) -> float:
        """Return the height of a geom's bounding box [m]; for a plane, of its origin."""
        T, box = T_world_body @ self.pose(geom), self.model.geom_aabb[geom]
        if self._kind(geom) == "plane":
            return float(T[2, 3])
        return float(T[2, 3] + T[2, :3] @ box[:3] + np.abs(T[2, :3]) @ box[3:])

    def shapes(
        self, geom: int, T: Float[np.ndarray, "4 4"], name: str, *, solid: bool
    ) -> list[Geometry]:
        """Return the shapes of a geom; empty for unbounded planes.

        Args:
            geom: Index of the geom.
            T: Pose of its body in the frame of the shapes.
            name: Name of the shapes.
            solid: Whether the report counts it, as it does not for visual geoms.
        """
        T, size = T @ self.pose(geom), self.model.geom_size[geom].tolist()
        kind = self._kind(geom)
        count = self.approximated if solid else Counter[str]()
        if kind == "box":
            return [Geometry("box", (2 * size[0], 2 * size[1], 2 * size[2]), T, name)]
        if kind == "sphere":
            return [Geometry("sphere", (size[0],), T, name)]
        if kind == "cylinder":
            return [Geometry("cylinder", (size[0], 2 * size[1]), T, name)]
        if kind == "capsule":
            return capsule_shapes(size[0], 2 * size[1], T, name)
        if kind == "mesh":
            file = self._mesh(int(self.model.geom_dataid[geom]))
            return [Geometry("mesh", (1.0, 1.0, 1.0), T, name, file)]
        if kind == "ellipsoid":
            count["ellipsoids as meshes"] += 1
            shape, file, mesh = ellipsoid((size[0], size[1], size[2]), T, name)
            self.meshes[file] = mesh
            return [shape]
        if kind == "plane" and min(size[:2]) > 0:
            count["bounded planes as boxes"] += 1
            return [plane(2 * size[0], 2 * size[1], T, name)]
        if solid:
            self.dropped["unbounded planes" if kind == "plane" else f"geoms of type {kind}"] += 1
        return []

    def _kind(self, geom: int) -> str:
        import mujoco

        kind: str = mujoco.mjtGeom(int(self.model.geom_type[geom])).name
        return kind.removeprefix("mjGEOM_").lower()

    def _mesh(self, number: int) -> Path:
        """Return the file of a mesh, and add the mesh."""
        file = self._files[number]
        if file not in self.meshes:
            m = self.model
            first, count = m.mesh_vertadr[number], m.mesh_vertnum[number]
            points = m.mesh_vert[first : first + count].astype(float)
            first, count = m.mesh_faceadr[number], m.mesh_facenum[number]
            faces = m.mesh_face[first : first + count].astype(np.int64)
            self.meshes[file] = Mesh(points, faces)
        return file

    @cached_property
    def _files(self) -> list[Path]:
        """File names of all meshes, because MuJoCo's names can contain any characters."""
        names = (self.model.mesh(i).name for i in range(self.model.nmesh))
        plain = ("".join(c if c.isalnum() and c.isascii() else "_" for c in n)[:60] for n in names)
        return [Path(f"mesh{i}_{name}.obj") for i, name in enumerate(plain)]


_NUMBER = re.compile(r"#\d+$")
"""Suffix of geom names that would otherwise be equal."""


@dataclass
class Tree:
    """Collects the links and joints of one object."""

    model: Any
    shapes: GeomShapes
    children: Mapping[int, Sequence[int]]
    """Child bodies by body."""
    name: str
    prefix: str
    """Prefix of the part names, which is removed."""
    approximated: Counter[str]
    weighed: Collection[int]
    """Bodies whose mass the file states."""
    links: dict[str, Link] = field(default_factory=dict)
    joints: dict[int, Joint] = field(default_factory=dict)
    """Movable joints by MuJoCo's index."""
    values: dict[str, float] = field(default_factory=dict)
    solid: list[int] = field(default_factory=list)
    """Geoms with collisions, by MuJoCo's index."""
    bodies: dict[int, tuple[str, Float[np.ndarray, "4 4"]]] = field(default_factory=dict)
    """Link of each body, and the body's pose in it."""
    _order: list[Joint] = field(default_factory=list)
    _link_names: Names = field(default_factory=Names)
    _joint_names: Names = field(default_factory=Names)

    def object(
        self, T: Float[np.ndarray, "4 4"], follows: Mapping[int, Mimic], extras: Mapping[str, Any]
    ) -> RoomObject:
        """Return the object.

        Args:
            T: Pose in the world.
            follows: Mimic relations by MuJoCo's joint index.
            extras: See `RoomObject`.
        """
        numbers = {joint.name: number for number, joint in self.joints.items()}
        joints = tuple(
            replace(joint, mimic=follows.get(numbers.get(joint.name, -1))) for joint in self._order
        )
        urdf = Urdf(self.name, None, next(iter(self.links)), self.links, joints)
        return RoomObject(self.name, T, urdf, self.values, extras)

    def add_geom(self, geom: int, link: str) -> None:
        """Add a geom of the world as the whole object, in the geom's frame."""
        self._add_link(self._link_names(link, "body"), 0, [geom], invert(self.shapes.pose(geom)))

    def add_body(self, body: int, link: str) -> None:
        """Add a body of the world, and all bodies below it."""
        waiting: list[tuple[int, str | None, Float[np.ndarray, "4 4"]]] = [(body, None, np.eye(4))]
        while waiting:
            number, parent, T_parent_body = waiting.pop()
            wanted = link if parent is None else self._bare(self.model.body(number).name)
            name = self._link_names(wanted, f"body_{number}")
            T_link_body = self._add_joints(number, parent, T_parent_body, name)
            self.bodies[number] = name, T_link_body
            first, count = self.model.body_geomadr[number], self.model.body_geomnum[number]
            self._add_link(name, number, range(first, first + count), T_link_body)
            waiting += [
                (child, name, T_link_body @ self._offset(child))
                for child in reversed(self.children[number])
            ]

    def add_sites(self) -> None:
        """Add the named sites of all bodies as links without shapes."""
        none = np.array([1.0, 0.0, 0.0])
        for k in range(self.model.nsite):
            body, site = int(self.model.site_bodyid[k]), self._bare(self.model.site(k).name)
            if body not in self.bodies or not site:
                continue
            parent, T_link_body = self.bodies[body]
            link = self._link_names(site, "site")
            self.links[link] = Link(link, (), ())
            T = T_link_body @ pose_wxyz(
                tuple(self.model.site_pos[k].tolist()), tuple(self.model.site_quat[k].tolist())
            )
            name = self._joint_names(f"{link}_fixed", "fixed")
            self._order.append(Joint(name, "fixed", parent, link, T, none, 0.0, 0.0, math.inf))

    def _offset(self, body: int) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a body in its parent, with joints as in the file."""
        return pose_wxyz(
            tuple(self.model.body_pos[body].tolist()), tuple(self.model.body_quat[body].tolist())
        )

    def _bare(self, name: str) -> str:
        return name.removeprefix(f"{self.prefix}/")

    def _add_joints(
        self, body: int, parent: str | None, T_parent_body: Float[np.ndarray, "4 4"], link: str
    ) -> Float[np.ndarray, "4 4"]:
        """Add the joints of a body; several joints become a chain of links without shapes.

        Args:
            body: Index of the body.
            parent: Link of its parent; None for the object's first body.
            T_parent_body: Its pose in the parent.
            link: Name of its link.

        Returns:
            The body's pose in its link, whose origin is the anchor of its last joint.
        """
        first, count = self.model.body_jntadr[body], self.model.body_jntnum[body]
        moving = [j for j in range(first, first + count) if self._kind(j) is not None]
        if parent is None and moving:
            parent = self._link_names("base", "base")
            self.links[parent] = Link(parent, (), ())
        if parent is None:
            return np.eye(4)
        if not moving:
            name = self._joint_names(f"{link}_fixed", "fixed")
            none = np.array([1.0, 0.0, 0.0])
            joint = Joint(name, "fixed", parent, link, T_parent_body, none, 0.0, 0.0, math.inf)
            self._order.append(joint)
            return np.eye(4)
        T, offset = T_parent_body, np.zeros(3)
        for joint_id in moving:
            turns = self._kind(joint_id) != "prismatic"
            anchor = np.array(self.model.jnt_pos[joint_id]) if turns else offset
            T, offset = T @ pose(anchor - offset), anchor
            last = joint_id == moving[-1]
            child = link if last else self._link_names(f"{link}_{joint_id}", "between")
            if not last:
                self.links[child] = Link(child, (), ())
            self._add_joint(joint_id, parent, child, T, link)
            parent, T = child, np.eye(4)
        return pose(-offset)

    def _kind(self, joint: int) -> JointKind | None:
        """Return the kind of a joint; None if URDF has no counterpart."""
        import mujoco

        kind, kinds = int(self.model.jnt_type[joint]), mujoco.mjtJoint
        if kind == kinds.mjJNT_SLIDE:
            return "prismatic"
        if kind == kinds.mjJNT_HINGE:
            return "revolute" if self.model.jnt_limited[joint] else "continuous"
        return None

    def _add_joint(
        self, number: int, parent: str, child: str, T: Float[np.ndarray, "4 4"], link: str
    ) -> None:
        m, kind = self.model, self._kind(number)
        assert kind is not None
        word = "slide" if kind == "prismatic" else "hinge"
        wanted = self._bare(m.joint(number).name) or f"{link}_{word}"
        name = self._joint_names(wanted, word)
        lower, upper = -math.inf, math.inf
        if m.jnt_limited[number]:
            lower, upper = m.jnt_range[number].tolist()
        axis, start = np.array(m.jnt_axis[number]), float(m.qpos0[m.jnt_qposadr[number]])
        joint = Joint(name, kind, parent, child, T, axis, lower, upper, math.inf)
        back = joint_motion(joint, -start)  # the file defines the body at joint value `start`
        dof = int(m.jnt_dofadr[number])
        joint = replace(
            joint, T_parent_joint=T @ back,
            friction=float(m.dof_frictionloss[dof].item()),
            damping=float(m.dof_damping[dof].item()),
        )  # fmt: skip
        self._order.append(joint)
        self.joints[number] = joint
        value = min(max(start, joint.lower), joint.upper)
        if value != start:
            self.approximated["joint values outside their limits, clipped"] += 1
        if value != min(max(0.0, joint.lower), joint.upper):
            self.values[name] = value

    def _add_link(
        self, link: str, body: int, geoms: Sequence[int], T_link_body: Float[np.ndarray, "4 4"]
    ) -> None:
        solid: list[Geometry] = []
        drawn: list[Geometry] = []
        for geom in geoms:
            touched = self.shapes.solid(geom)
            if touched or self.model.geom_rgba[geom][3] > 0:
                name = self._shape_name(geom, link)
                shapes = self.shapes.shapes(geom, T_link_body, name, solid=touched)
                (solid if touched else drawn).extend(shapes)
                self.solid += [geom] if touched and shapes else []
        center = (T_link_body[:3, :3] @ self.model.body_ipos[body] + T_link_body[:3, 3]).tolist()
        mass = float(self.model.body_mass[body]) if body in self.weighed else 0.0
        self.links[link] = Link(link, tuple(solid), tuple(drawn), mass, tuple(center))

    def _shape_name(self, geom: int, link: str) -> str:
        name = self._bare(self.model.geom(geom).name).removeprefix(f"{link}/")
        return "".join(c if c.isprintable() else "_" for c in _NUMBER.sub("", name))[:200]


WATER_DENSITY = 1000.0
"""Density of geoms without one in MuJoCo [kg/m^3]."""
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
    return _compiled(path, root).room()


def read_robot(path: Path, root: Path) -> tuple[Urdf, Mapping[Path, Mesh], ImportReport]:
    """Read a robot, or a part of one, in MJCF: the body of the world that has joints.

    Sites become links without shapes, and limits of motors become efforts. MJCF has no speed
    limits.

    Args:
        path: The file.
        root: Folder that no file may leave.

    Returns:
        Its links and joints, its meshes by the names in its shapes, and what was left out.

    Raises:
        FileFormatError: The file is invalid, or not one robot; one line says why.
        MissingExtraError: MuJoCo is not installed.
    """
    return _compiled(path, root, actuators=True).robot()


def _compiled(path: Path, root: Path, *, actuators: bool = False) -> _MjcfReader:
    """Compile a file; see `read_room` for errors."""
    with require("physics"):
        import mujoco

    source = read_mjcf(path, root, actuators=actuators)
    text = tostring(source.tree, encoding="unicode")
    try:
        spec = mujoco.MjSpec.from_string(text, assets=source.meshes)
        model = spec.compile()
    except ValueError as error:
        words = re.sub(r"\bmesh\d+\.\w+", lambda m: str(source.files.get(m[0], m[0])), str(error))
        raise FileFormatError(f"{path}: MuJoCo rejects it: {words}") from error
    return _MjcfReader(path, model, source, _weighed(spec))


def _weighed(spec: Any) -> frozenset[int]:
    """Return the bodies whose mass, or the mass or density of whose geoms, a file states.

    MuJoCo gives all others the density of water.
    """
    return frozenset(
        int(body.id)
        for body in spec.bodies
        if body.explicitinertial
        or any(geom.mass > 0.0 or geom.density != WATER_DENSITY for geom in body.geoms)
    )


@dataclass
class _MjcfReader:
    """Converts a compiled model to our records."""

    path: Path
    model: Any
    source: Mjcf
    weighed: frozenset[int]
    """See `_weighed`."""
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

    def robot(self) -> tuple[Urdf, Mapping[Path, Mesh], ImportReport]:
        """Return the robot; see `read_robot`."""
        m = self.model
        self.report.dropped.update(self.source.dropped)
        moving = {int(m.body_rootid[body]) for body in m.jnt_bodyid[m.jnt_type > 1].tolist()}
        roots = sorted(moving) or self.children[0]  # a mast has no joints
        if len(roots) != 1:
            names = ", ".join(repr(self._named(body)) for body in roots) or "none"
            raise FileFormatError(
                f"{self.path}: a robot is one body of the world; there are {len(roots)} ({names})"
            )
        name = self.source.tree.get("model") or self.path.stem
        tree = Tree(m, self.shapes, self.children, name, "", self.report.approximated, self.weighed)
        tree.add_body(roots[0], self._named(roots[0]))
        tree.add_sites()
        urdf = tree.object(np.eye(4), self._follows([tree]), {}).urdf
        efforts = {tree.joints[k].name: self._effort(k) for k in tree.joints}
        joints = tuple(replace(j, effort=efforts.get(j.name, math.inf)) for j in urdf.joints)
        return replace(urdf, joints=joints), self.shapes.meshes, self.report

    def _effort(self, joint: int) -> float:
        """Return the largest torque or force of a joint's motors; infinite if unlimited."""
        m, force = self.model, math.inf
        if m.jnt_actfrclimited[joint]:
            force = float(np.abs(m.jnt_actfrcrange[joint]).max())
        for k in range(m.nu):
            if int(m.actuator_trntype[k]) != 0 or int(m.actuator_trnid[k, 0]) != joint:
                continue
            largest = math.inf
            if m.actuator_forcelimited[k]:
                largest = float(np.abs(m.actuator_forcerange[k]).max())
            elif m.actuator_ctrllimited[k] and not m.actuator_biastype[k]:  # a motor
                largest = float(np.abs(m.actuator_ctrlrange[k] * m.actuator_gainprm[k, 0]).max())
            force = min(force, largest * abs(float(m.actuator_gear[k, 0])))
        return force

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
            tree = Tree(
                m, self.shapes, self.children, name, prefix, self.report.approximated, self.weighed
            )
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
        self.report.dropped["springs of joints"] += int((self.model.jnt_stiffness != 0.0).sum())
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
