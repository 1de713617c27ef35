"""Compare the part poses of an MJCF room in MuJoCo and in our scene.

Geoms are compared by their extents along 26 directions, in closed form on both sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from momapos.core.geometry import apply
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import mesh_points
from momapos.model.urdf.reader import Geometry

DIRECTIONS = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)], float)
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
_KINDS = mujoco.mjtGeom
_JOINTS = mujoco.mjtJoint


def reach(kind: str, size: Float[np.ndarray, " n"], R: Float[np.ndarray, "3 3"]) -> Any:
    """Return the extents of a shape from its center along the directions [m].

    Args:
        kind: box, sphere, cylinder, capsule or ellipsoid.
        size: MuJoCo's size: half edges, or radius and half length.
        R: Its orientation.
    """
    local = DIRECTIONS @ R
    across, along = np.linalg.norm(local[:, :2], axis=1), np.abs(local[:, 2])
    if kind == "box":
        return np.abs(local) @ size
    if kind == "sphere":
        return np.full(len(local), size[0])
    if kind == "cylinder":
        return size[0] * across + size[1] * along
    if kind == "capsule":
        return size[0] + size[1] * along
    return np.linalg.norm(local * size, axis=1)


@dataclass(frozen=True)
class Found:
    """A joint of a room, and the errors of our scene."""

    name: str
    ours: str | None
    """OBJECT/JOINT of our scene; None if missing."""
    error: float
    """Maximum error of a moved geom, at either end of the range [m]."""
    limits: float
    """Maximum error of its limits [rad] or [m]."""


class Truth:
    """A room as read by MuJoCo."""

    def __init__(self, path: Path) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.data = mujoco.MjData(self.model)

    @cached_property
    def floor(self) -> float:
        """Return the height of the lowest horizontal plane [m]; 0 if there is none."""
        mujoco.mj_kinematics(self.model, self.data)
        planes = self.model.geom_type == _KINDS.mjGEOM_PLANE
        level = planes & (self.data.geom_xmat[:, 8] > 0.999)
        return float(min(self.data.geom_xpos[level, 2], default=0.0))

    def parts(self) -> list[int]:
        """Return bounded hinges and slides of solid parts, without robot joints and followers."""
        m = self.model
        kinds = (int(_JOINTS.mjJNT_HINGE), int(_JOINTS.mjJNT_SLIDE))
        # All joints of a chain with an actuated joint belong to a robot.
        motors = m.actuator_trnid[m.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT), 0]
        robots = {int(m.body_rootid[m.jnt_bodyid[joint]]) for joint in motors}
        follows = {one for one, _, _ in self.coupled()}
        return [
            joint
            for joint in range(m.njnt)
            if joint not in follows
            and int(m.jnt_type[joint]) in kinds
            and m.jnt_limited[joint]
            and int(m.body_rootid[m.jnt_bodyid[joint]]) not in robots
            and any(self.solid(body) for body in self.below(int(m.jnt_bodyid[joint])))
        ]

    def coupled(self) -> list[tuple[int, int, Float[np.ndarray, "5"]]]:
        """Return joints that follow another one, with that one and the polynomial coefficients."""
        m = self.model
        kind = int(mujoco.mjtEq.mjEQ_JOINT)
        rows = range(m.neq)
        found = [
            k for k in rows if m.eq_type[k] == kind and m.eq_active0[k] and m.eq_obj2id[k] >= 0
        ]
        return [(int(m.eq_obj1id[k]), int(m.eq_obj2id[k]), m.eq_data[k, :5]) for k in found]

    def below(self, body: int) -> list[int]:
        """Return a body and its descendants."""
        m, found = self.model, {body}
        for other in range(body + 1, m.nbody):
            if int(m.body_parentid[other]) in found:
                found.add(other)
        return sorted(found)

    def solid(self, body: int) -> list[int]:
        """Return the geoms of a body that can collide."""
        m = self.model
        geoms = range(m.body_geomadr[body], m.body_geomadr[body] + m.body_geomnum[body])
        return [g for g in geoms if m.geom_contype[g] or m.geom_conaffinity[g]]

    def set(self, joint: int, value: float) -> None:
        """Set one joint and its followers; all others keep the values of the file."""
        m = self.model
        self.data.qpos = m.qpos0
        address = m.jnt_qposadr
        self.data.qpos[address[joint]] = value
        for one, other, coefficients in self.coupled():
            if other == joint:
                way = value - m.qpos0[address[joint]]
                bent = np.polynomial.polynomial.polyval(way, coefficients)
                self.data.qpos[address[one]] = m.qpos0[address[one]] + bent
        mujoco.mj_kinematics(m, self.data)

    def reach(self, geom: int) -> Float[np.ndarray, " d"]:
        """Return the extents of a geom from the floor's origin along the directions [m]."""
        m, R = self.model, self.data.geom_xmat[geom].reshape(3, 3)
        center = self.data.geom_xpos[geom] - [0, 0, self.floor]
        kind = _KINDS(int(m.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
        if kind == "mesh":
            number = int(m.geom_dataid[geom])
            first = m.mesh_vertadr[number]
            points = m.mesh_vert[first : first + m.mesh_vertnum[number]]
            return (points @ R.T @ DIRECTIONS.T).max(0) + DIRECTIONS @ center
        return reach(kind, m.geom_size[geom], R) + DIRECTIONS @ center


def our_reach(shape: Geometry, T_world_link: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " d"]:
    """Return the extents of a shape of our scene along the directions [m]."""
    T = T_world_link @ shape.T_link_geometry
    if shape.mesh is not None:
        points = apply(T, mesh_points(shape.mesh) * shape.size)
        return (points @ DIRECTIONS.T).max(0)
    size = np.array(shape.size)
    size = size / 2 if shape.kind == "box" else size / [1, 2][: len(size)]
    return reach(shape.kind, size, T[:3, :3]) + DIRECTIONS @ T[:3, 3]


def compare(truth: Truth, scene: Scene) -> Iterator[Found]:
    """Move each part to both ends of its range, in MuJoCo and in our scene."""
    m = truth.model
    for joint in truth.parts():
        name, body = m.joint(joint).name, int(m.jnt_bodyid[joint])
        slides = m.jnt_type[joint] == int(_JOINTS.mjJNT_SLIDE)
        wanted = name or f"{_bare(m.body(body).name)}_{'slide' if slides else 'hinge'}"
        item = _owner(scene, wanted)
        if item is None:
            yield Found(wanted, None, np.inf, np.inf)
            continue
        ours = item.model.joint(_bare(wanted))
        limits = float(np.abs(m.jnt_range[joint] - [ours.lower, ours.upper]).max())
        errors = []
        for value in (ours.lower, ours.upper):
            truth.set(joint, value)
            errors += [_difference(truth, b, item, ours.name, value) for b in truth.below(body)]
        yield Found(wanted, f"{item.name}/{ours.name}", max(errors), limits)


def _owner(scene: Scene, name: str) -> SceneObject | None:
    """Return the object with a joint; None if there is none."""
    head, _, joint = name.rpartition("/")
    owners = [item for item in scene.objects if joint in item.model.joints]
    return next((item for item in owners if item.name == head), next(iter(owners), None))


def _bare(name: str) -> str:
    """Return a name without the prefixes of composed models."""
    return name.rpartition("/")[2]


def _difference(truth: Truth, body: int, item: SceneObject, joint: str, value: float) -> float:
    """Return the maximum error of a body's geoms [m]; infinite if their number differs."""
    link = _bare(truth.model.body(body).name) or f"body_{body}"
    geoms = truth.solid(body)
    if link not in item.model.urdf.links:
        return np.inf if geoms else 0.0
    shapes = list(item.model.urdf.links[link].collisions)
    T = item.link_poses({joint: value})[link]
    worst = 0.0
    for geom in geoms:
        count = 3 if truth.model.geom_type[geom] == int(_KINDS.mjGEOM_CAPSULE) else 1
        group, shapes = shapes[:count], shapes[count:]
        if len(group) < count:
            return np.inf
        ours = np.max([our_reach(shape, T) for shape in group], axis=0)
        worst = max(worst, float(np.abs(ours - truth.reach(geom)).max()))
    return np.inf if shapes else worst
