"""Read rooms in USD with physics: rigid bodies, colliders, revolute and prismatic joints.

USD opens any file that a layer names. All layers are therefore opened one by one first, without
composition, and each name is checked to be inside the root.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import FileFormatError, open_regular, require, resolved
from momapos.core.geometry import apply, invert, pose, pose_rpy, pose_wxyz
from momapos.model.urdf import (
    MAX_POINTS,
    Geometry,
    Joint,
    JointKind,
    Link,
    Mesh,
    Urdf,
    capsule_shapes,
)

from .imported_room import ImportedRoom, ImportReport, Names, RoomObject, ellipsoid, find_inside

if TYPE_CHECKING:
    from jaxtyping import Float, Int


SCALE_TOLERANCE = 1e-4
"""Relative tolerance for equal scales, and tolerance for right angles [-]."""
_QUARTER = np.pi / 2
_TURNED = {"X": (0.0, _QUARTER, 0.0), "Y": (-_QUARTER, 0.0, 0.0), "Z": (0.0, 0.0, 0.0)}
"""Rotations from z to the axis of a round shape."""


def matrix(found: Any) -> Float[np.ndarray, "4 4"]:
    """Return a USD matrix, which multiplies row vectors, for column vectors."""
    return np.array(found, float).T


def rigid(T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return the nearest transform without scale."""
    u, _, vt = np.linalg.svd(T[:3, :3])
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return pose(T[:3, 3], turn)


class ColliderShapes:
    """Converts colliders to shapes, and counts approximations."""

    kinds = ("Cube", "Sphere", "Cylinder", "Capsule", "Cone", "Mesh", "Plane")

    def __init__(self, report: ImportReport) -> None:
        self.report = report
        self.meshes: dict[Path, Mesh] = {}

    def shapes(
        self, prim: Any, T_world: Float[np.ndarray, "4 4"], T_world_link: Float[np.ndarray, "4 4"]
    ) -> list[Geometry]:
        """Return the shapes of a collider.

        Args:
            prim: The collider.
            T_world: Transform of its coordinates to the world in meters, which may scale.
            T_world_link: Pose of its link.

        Raises:
            FileFormatError: The size or the vertices are invalid.
        """
        kind, name = str(prim.GetTypeName()), prim.GetName()
        T = invert(T_world_link) @ T_world
        if kind == "Mesh":
            return [self._mesh(*_corners(prim), T, name)]
        if kind == "Plane":
            self.report.dropped["planes"] += 1
            return []
        scale = np.linalg.norm(T[:3, :3], axis=0)
        straight = T[:3, :3] / np.maximum(scale, 1e-12)
        if np.abs(straight.T @ straight - np.eye(3)).max() > SCALE_TOLERANCE:
            raise FileFormatError(f"{prim.GetPath()}: a {kind} is sheared; use a mesh instead")
        place = rigid(T)
        if kind == "Cube":
            edge = _size(prim, "size", 2.0)
            return [Geometry("box", tuple((edge * scale).tolist()), place, name)]
        if kind == "Sphere":
            half = _size(prim, "radius", 1.0) * scale
            if np.ptp(half) <= SCALE_TOLERANCE * half.max():
                return [Geometry("sphere", (float(half[0]),), place, name)]
            self.report.approximated["ellipsoids as meshes"] += 1
            shape, file, mesh = ellipsoid((half[0], half[1], half[2]), place, name)
            self.meshes[file] = mesh
            return [shape]
        return self._round(prim, kind, scale, place, name)

    def _round(
        self,
        prim: Any,
        kind: str,
        scale: Float[np.ndarray, "3"],
        place: Float[np.ndarray, "4 4"],
        name: str,
    ) -> list[Geometry]:
        axis = str(prim.GetAttribute("axis").Get() or "Z")
        along = "XYZ".index(axis)
        across = np.delete(scale, along)
        radius = _size(prim, "radius", 0.5 if kind == "Capsule" else 1.0) * float(across.max())
        height = _size(prim, "height", 1.0 if kind == "Capsule" else 2.0) * float(scale[along])
        if np.ptp(across) > SCALE_TOLERANCE * across.max():
            self.report.approximated["elliptic round shapes as circular ones"] += 1
        T = place @ pose_rpy((0.0, 0.0, 0.0), _TURNED[axis])
        if kind == "Capsule":
            return capsule_shapes(radius, height, T, name)
        self.report.approximated["cones as cylinders"] += kind == "Cone"
        return [Geometry("cylinder", (radius, height), T, name)]

    def _mesh(
        self,
        points: Float[np.ndarray, "v 3"],
        faces: Int[np.ndarray, "f 3"],
        T: Float[np.ndarray, "4 4"],
        name: str,
    ) -> Geometry:
        place = rigid(T)
        local = (points @ T[:3, :3].T) @ place[:3, :3]
        file = Path(f"mesh{len(self.meshes)}.obj")
        self.meshes[file] = Mesh(local, faces)
        return Geometry("mesh", (1.0, 1.0, 1.0), place, name, file)


def _size(prim: Any, key: str, otherwise: float) -> float:
    value = prim.GetAttribute(key).Get()
    size = otherwise if value is None else float(value)
    if not 0 < size < 1e6:
        raise FileFormatError(f"{prim.GetPath()}: {key} must be > 0, not {size:g}")
    return size


def _corners(prim: Any) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Return the vertices of a mesh, and its faces split into triangles."""
    found = [
        prim.GetAttribute(k).Get() for k in ("points", "faceVertexCounts", "faceVertexIndices")
    ]
    points = np.array(found[0] if found[0] is not None else [], float).reshape(-1, 3)
    counts, corners = (np.array(f if f is not None else [], np.int64) for f in found[1:])
    where = f"{prim.GetPath()}: a mesh"
    if not 4 <= len(points) <= MAX_POINTS or len(corners) > MAX_POINTS:
        raise FileFormatError(f"{where} has {len(points)} vertices; it must have 4 to {MAX_POINTS}")
    if not np.isfinite(points).all():
        raise FileFormatError(f"{where} contains NaN or infinite vertices")
    if (counts < 0).any() or counts.sum() != len(corners):
        raise FileFormatError(
            f"{where} has faces with {counts.sum()} vertices, but {len(corners)} vertex indices"
        )
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise FileFormatError(f"{where} names a vertex that does not exist")
    fans = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, fans)
    step = np.arange(len(first)) - np.repeat(np.cumsum(fans) - fans, fans)
    faces = np.stack([corners[first], corners[first + step + 1], corners[first + step + 2]], axis=1)
    return points, faces


MAX_BYTES = 200_000_000
"""Maximum size of a layer [bytes]."""
MAX_LAYERS = 1_000
MAX_PRIMS = 200_000
MAX_FRAME_MISMATCH = 1e-3
"""Maximum mismatch of a joint's two frames apart from its motion [m], [rad]."""
_USD_MESSAGE = re.compile(r"at line \d+ in file \S+ : '(.*)'", re.S)
_AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


def read_room(path: Path, root: Path) -> ImportedRoom:
    """Read a room in USD.

    Args:
        path: The file; unpack a `.usdz` first.
        root: Folder that no layer may leave.

    Raises:
        FileFormatError: The file is invalid; one line says what is wrong and where.
        MissingExtraError: The USD library is not installed.
    """
    with require("usd"):
        from pxr import Tf, Usd

    try:
        _check_layers(path, resolved(root))
        return _UsdReader(path, Usd.Stage.Open(str(resolved(path)))).room()
    except Tf.ErrorException as error:
        text = _text(error)
        match = _USD_MESSAGE.search(text)  # without the place in USD's own source
        why = text if match is None else match[1]
        raise FileFormatError(f"{path}: USD rejects it: {why}") from error
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: a name or a text in it is not UTF-8") from error
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        # USD keeps values of unknown types, also where its schemas say which type they have.
        raise FileFormatError(f"{path}: a value is not of its schema's type ({error})") from error


def _text(error: Exception) -> str:
    """Return the message of a USD error, which quotes bytes of the file that may be no UTF-8."""
    try:
        return str(error)
    except UnicodeDecodeError as bad:
        return bad.object.decode("utf-8", errors="replace")


def _check_layers(path: Path, root: Path) -> None:
    """Refuse layers that name files outside the root.

    Raises:
        FileFormatError: A layer does, or a file is missing or too large.
    """
    from pxr import Sdf

    waiting, seen = [resolved(path)], {resolved(path)}
    while waiting:
        file = waiting.pop()
        open_regular(file, MAX_BYTES).close()
        layer = Sdf.Layer.OpenAsAnonymous(str(file))
        if layer is None:
            raise FileFormatError(f"{file}: is not a USD layer")
        for name in layer.GetCompositionAssetDependencies():
            if "://" in name:
                raise FileFormatError(f"{file}: {name!r:.200} is not a file; URLs are not read")
            found = find_inside(name, [file.parent / name], root, file)
            if found.suffix.lower() not in (".usd", ".usda", ".usdc"):
                raise FileFormatError(f"{file}: {name!r:.200} must be a .usd, .usda or .usdc file")
            if found not in seen:
                seen.add(found)
                waiting.append(found)
        if len(seen) > MAX_LAYERS:
            raise FileFormatError(f"{path}: names more than {MAX_LAYERS} layers")


@dataclass
class _StagePrims:
    """Prims of a stage."""

    bodies: list[Any] = field(default_factory=list)
    colliders: list[Any] = field(default_factory=list)
    joints: list[Any] = field(default_factory=list)
    drawn: list[Any] = field(default_factory=list)
    """Shapes without collisions."""


class _UsdReader:
    """Converts a stage to our records."""

    def __init__(self, path: Path, stage: Any) -> None:
        from pxr import Usd, UsdGeom, UsdPhysics

        self.path, self.stage, self.report = path, stage, ImportReport()
        self.unit = float(UsdGeom.GetStageMetersPerUnit(stage))
        if not 1e-6 < self.unit < 1e6:
            raise FileFormatError(
                f"{path}: metersPerUnit is {self.unit:g}; it must be between 1e-6 and 1e6"
            )
        turned = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
        self.T_world_stage = pose_rpy((0, 0, 0), (math.pi / 2 * turned, 0, 0))
        self.cache = UsdGeom.XformCache(Usd.TimeCode.Default())
        self.physics = UsdPhysics
        self.mass_unit = float(UsdPhysics.GetStageKilogramsPerUnit(stage))
        self.shapes = ColliderShapes(self.report)

    def room(self) -> ImportedRoom:
        """Return the room; the report counts what it lacks."""
        from pxr import Usd

        found = _StagePrims()
        prims = iter(Usd.PrimRange(self.stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
        for count, prim in enumerate(prims):
            if count > MAX_PRIMS:
                raise FileFormatError(f"{self.path}: more than {MAX_PRIMS} prims")
            if prim.IsA(self.physics.Joint):
                found.joints.append(prim)
                drives = [s for s in prim.GetAppliedSchemas() if s.startswith("PhysicsDriveAPI")]
                self.report.dropped["drives"] += len(drives)
            self.report.dropped["materials"] += prim.GetTypeName() == "Material"
            if prim.HasAPI(self.physics.RigidBodyAPI):
                found.bodies.append(prim)
            if self._collides(prim):
                found.colliders.append(prim)
            elif prim.GetTypeName() in self.shapes.kinds:
                found.drawn.append(prim)
        names = Names()
        objects = []
        for top in self._tops(found):
            item = self._object(top, names(top.GetName(), "object"), found)
            if item is not None:
                objects.append(item)
        return ImportedRoom(self.path.stem, tuple(objects), self.shapes.meshes, self.report)

    def _collides(self, prim: Any) -> bool:
        if not prim.HasAPI(self.physics.CollisionAPI):
            return False
        enabled = self.physics.CollisionAPI(prim).GetCollisionEnabledAttr().Get()
        return enabled is not False and prim.GetTypeName() in self.shapes.kinds

    def _tops(self, found: _StagePrims) -> list[Any]:
        """Return the prims that become objects, below those that only group others."""
        tops = [
            prim for prim in self.stage.GetPseudoRoot().GetChildren() if self._holds(prim, found)
        ]
        while len(tops) == 1:
            (top,) = tops
            parts = [prim for prim in top.GetChildren() if self._holds(prim, found)]
            own = top in found.bodies or top in found.colliders
            if own or not parts or self._joined(parts, found.joints):
                break
            tops = parts
        return tops

    def _holds(self, prim: Any, found: _StagePrims) -> bool:
        return any(_within(part, prim) for part in found.colliders)

    def _joined(self, parts: list[Any], joints: list[Any]) -> bool:
        for joint in joints:
            ends = [self._body(joint, end) for end in (0, 1)]
            owners = {
                i for end in ends for i, part in enumerate(parts) if end and _within(end, part)
            }
            if len(owners) > 1:
                return True
        return False

    def _body(self, joint: Any, end: int) -> Any:
        """Return the rigid body at one end of a joint; None for the world."""
        rel = (self.physics.Joint(joint).GetBody0Rel, self.physics.Joint(joint).GetBody1Rel)[end]()
        targets = rel.GetTargets()
        prim = self.stage.GetPrimAtPath(targets[0]) if targets else None
        return self._rigid_above(prim) if prim else None

    def _rigid_above(self, prim: Any) -> Any:
        """Return the rigid body that a prim belongs to; None if it is fixed."""
        while prim and not prim.IsPseudoRoot():
            if prim.HasAPI(self.physics.RigidBodyAPI):
                return prim
            prim = prim.GetParent()
        return None

    def _object(self, top: Any, name: str, found: _StagePrims) -> RoomObject | None:
        T_world = rigid(self._matrix(top))
        names, joint_names = Names(), Names()
        base = names("base", "base")
        bodies = {p.GetPath(): p for p in found.bodies if _within(p, top)}
        colliders = [prim for prim in found.colliders if _within(prim, top)]
        links = {path: names(prim.GetName(), "link") for path, prim in bodies.items()}
        origins = {path: rigid(self._matrix(prim)) for path, prim in bodies.items()}
        joints: dict[Any, tuple[Any, JointKind]] = {}
        for prim in found.joints:
            child = self._body(prim, 1)
            if child is None or child.GetPath() not in bodies:
                if child is None:
                    self.report.dropped["joints without a second body"] += top == prim.GetParent()
                continue
            if child.GetPath() in joints:
                self.report.dropped["joints that close loops"] += 1
                continue
            joints[child.GetPath()] = prim, self._kind(prim)
            origins[child.GetPath()] = self._frame(prim, 1)
        records: list[Joint] = []
        values: dict[str, float] = {}
        for path, link in links.items():
            if path not in joints:
                T = invert(T_world) @ origins[path]
                records.append(_fixed(joint_names(f"{link}_fixed", "fixed"), base, link, T))
                continue
            prim, kind = joints[path]
            parent = self._body(prim, 0)
            known = parent is not None and parent.GetPath() in links
            above = links[parent.GetPath()] if known else base
            T_parent = origins[parent.GetPath()] if known else T_world
            wanted = joint_names(prim.GetName(), "joint")
            joint, value = self._joint(prim, kind, wanted, above, link, T_parent)
            records.append(joint)
            if joint.movable and value != min(max(0.0, joint.lower), joint.upper):
                values[wanted] = value
        frames = {base: T_world, **{link: origins[path] for path, link in links.items()}}

        def link_of(prim: Any) -> str:
            owner = self._rigid_above(prim)
            return base if owner is None else links.get(owner.GetPath(), base)

        shapes: dict[str, list[Any]] = {link: [] for link in frames}
        for prim in colliders:
            link = link_of(prim)
            shapes[link] += self.shapes.shapes(prim, self._matrix(prim), frames[link])
        if not any(shapes.values()):
            return None
        drawn: dict[str, list[Any]] = {link: [] for link in frames}
        for prim in (prim for prim in found.drawn if _within(prim, top) and _is_seen(prim)):
            link = link_of(prim)
            with suppress(FileFormatError):  # it is damaged
                drawn[link] += self.shapes.shapes(prim, self._matrix(prim), frames[link])
        weights = {link: self._inertia(bodies[p], origins[p]) for p, link in links.items()}
        tree = {
            link: Link(link, tuple(made), tuple(drawn[link]), *weights.get(link, ()))
            for link, made in shapes.items()
        }
        return RoomObject(name, T_world, Urdf(name, None, base, tree, tuple(records)), values)

    def _inertia(
        self, prim: Any, T_world_link: Float[np.ndarray, "4 4"]
    ) -> tuple[float, tuple[float, float, float]] | tuple[()]:
        """Return mass [kg] and center of mass of a link [m]; nothing without a mass."""
        stated = self.physics.MassAPI(prim)
        mass = float(stated.GetMassAttr().Get() or 0.0) * self.mass_unit
        if not prim.HasAPI(self.physics.MassAPI) or mass <= 0.0:
            return ()
        center = np.array(stated.GetCenterOfMassAttr().Get(), float)
        center = center if np.isfinite(center).all() else np.zeros(3)  # -inf: not stated
        x, y, z = apply(invert(T_world_link) @ self._matrix(prim), center[None])[0].tolist()
        return mass, (x, y, z)

    def _kind(self, prim: Any) -> JointKind:
        if prim.IsA(self.physics.RevoluteJoint):
            return "revolute"
        if prim.IsA(self.physics.PrismaticJoint):
            return "prismatic"
        if not prim.IsA(self.physics.FixedJoint):
            self.report.approximated[f"{prim.GetTypeName()} as fixed"] += 1
        return "fixed"

    def _frame(self, prim: Any, end: int) -> Float[np.ndarray, "4 4"]:
        """Return the frame of a joint at one of its ends, in the world."""
        joint = self.physics.Joint(prim)
        spots = (joint.GetLocalPos0Attr, joint.GetLocalPos1Attr)[end]().Get() or (0, 0, 0)
        turn = (joint.GetLocalRot0Attr, joint.GetLocalRot1Attr)[end]().Get()
        wxyz = (1.0, 0.0, 0.0, 0.0) if turn is None else (turn.real, *turn.imaginary)
        if not (np.isfinite([*spots, *wxyz]).all() and 0.9 < np.linalg.norm(wxyz) < 1.1):
            raise FileFormatError(f"{self.path}: {prim.GetPath()}: has an invalid frame")
        rel = (joint.GetBody0Rel, joint.GetBody1Rel)[end]()
        targets = rel.GetTargets()
        body = self.stage.GetPrimAtPath(targets[0]) if targets else None
        whole = self._matrix(body) if body else self._matrix(self.stage.GetPseudoRoot())
        T = rigid(whole) @ pose_wxyz((0.0, 0.0, 0.0), tuple(map(float, wxyz)))
        T[:3, 3] = whole[:3, :3] @ np.array(spots, float) + whole[:3, 3]
        return T

    def _joint(
        self,
        prim: Any,
        kind: JointKind,
        name: str,
        parent: str,
        link: str,
        T_parent: Float[np.ndarray, "4 4"],
    ) -> tuple[Joint, float]:
        T_first, T_second = self._frame(prim, 0), self._frame(prim, 1)
        if kind == "fixed":
            return _fixed(name, parent, link, invert(T_parent) @ T_second), 0.0
        schema = self.physics.RevoluteJoint if kind == "revolute" else self.physics.PrismaticJoint
        typed = schema(prim)
        axis = np.array(_AXES[str(typed.GetAxisAttr().Get() or "X")])
        factor = math.pi / 180 if kind == "revolute" else self._scale(prim)
        ends = [
            math.inf if value is None else factor * float(value)
            for value in (typed.GetLowerLimitAttr().Get(), typed.GetUpperLimitAttr().Get())
        ]
        lower, upper = ends
        if not (math.isfinite(lower) and math.isfinite(upper)):
            lower, upper = -math.inf, math.inf
            kind = "continuous" if kind == "revolute" else kind
        if lower > upper:
            raise FileFormatError(
                f"{self.path}: {prim.GetPath()}: the lower limit {lower:g} is above {upper:g}"
            )
        T_way = invert(T_first) @ T_second
        if kind == "prismatic":
            value = float(T_way[:3, 3] @ axis)
            rest = pose(value * axis)
        else:
            skew = T_way[:3, :3] - T_way[:3, :3].T
            vector = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / 2
            value = math.atan2(float(vector @ axis), (float(np.trace(T_way[:3, :3])) - 1) / 2)
            rest = pose_wxyz((0, 0, 0), (math.cos(value / 2), *(math.sin(value / 2) * axis)))
        if np.abs(invert(rest) @ T_way - np.eye(4)).max() > MAX_FRAME_MISMATCH:
            self.report.approximated["joints with mismatched frames"] += 1
        value = 0.0 if abs(value) < 1e-9 else value
        clipped = min(max(value, lower), upper)
        self.report.approximated["joint values outside their limits, clipped"] += clipped != value
        T = invert(T_parent) @ T_first
        return Joint(name, kind, parent, link, T, axis, lower, upper, math.inf), clipped

    def _scale(self, prim: Any) -> float:
        """Return the length of a unit of a joint's frame [m]."""
        targets = self.physics.Joint(prim).GetBody0Rel().GetTargets()
        body = self.stage.GetPrimAtPath(targets[0]) if targets else None
        whole = self._matrix(body) if body else self._matrix(self.stage.GetPseudoRoot())
        return float(np.cbrt(abs(np.linalg.det(whole[:3, :3]))))

    def _matrix(self, prim: Any) -> Float[np.ndarray, "4 4"]:
        """Return the transform from a prim to the world in meters, which may scale."""
        T = (
            matrix(self.cache.GetLocalToWorldTransform(prim))
            if not prim.IsPseudoRoot()
            else np.eye(4)
        )
        T[:3] *= self.unit
        if not np.isfinite(T).all():
            raise FileFormatError(f"{self.path}: {prim.GetPath()}: its transform must be finite")
        return self.T_world_stage @ T


def _fixed(name: str, parent: str, link: str, T: Float[np.ndarray, "4 4"]) -> Joint:
    none = np.array([1.0, 0.0, 0.0])
    return Joint(name, "fixed", parent, link, T, none, 0.0, 0.0, math.inf)


def _is_seen(prim: Any) -> bool:
    """Return whether a renderer shows a prim."""
    from pxr import UsdGeom

    shown, tokens = UsdGeom.Imageable(prim), UsdGeom.Tokens
    return shown.ComputeVisibility() != tokens.invisible and shown.ComputePurpose() in (
        tokens.default_,
        tokens.render,
    )


def _within(prim: Any, top: Any) -> bool:
    return bool(prim.GetPath().HasPrefix(top.GetPath()))
