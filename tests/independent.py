"""Scenes as read by pinocchio and coal, without any code of the package."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float

BOX = (
    '<robot name="box"><link name="box"><collision><geometry><box size="{} {} {}"/></geometry>'
    "</collision></link></robot>"
)


@dataclass(frozen=True)
class Placed:
    """A box of a link, at a pose in the world."""

    link: str
    joint: int
    """Number of the joint that moves it; 0 if it is fixed."""
    T: pin.SE3
    box: coal.Box

    @cached_property
    def corners(self) -> Float[np.ndarray, "8 3"]:
        """Return its corners in the world [m]."""
        signs = np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), -1).reshape(-1, 3)
        return signs * self.box.halfSide @ self.T.rotation.T + self.T.translation

    def distance(self, other: Placed) -> float:
        """Return the signed distance [m]; negative if the boxes overlap."""
        request = coal.DistanceRequest()
        request.enable_signed_distance = True
        Ts = [coal.Transform3s(p.T.rotation, p.T.translation) for p in (self, other)]
        result = coal.DistanceResult()
        return float(coal.distance(self.box, Ts[0], other.box, Ts[1], request, result))


class Item:
    """An object of a scene: boxes on a tree of joints."""

    def __init__(self, entry: dict[str, Any], folder: Path) -> None:
        self.name, self.category = entry["name"], entry["category"]
        text = BOX.format(*entry["box"]) if "box" in entry else (folder / entry["urdf"]).read_text()
        self.model = pin.buildModelFromXML(text)
        self._geometry = pin.buildGeomFromUrdfString(self.model, text, pin.GeometryType.COLLISION)
        assert entry.get("scale", 1.0) == 1.0, "pinocchio does not support scale"
        w, *xyz = entry["pose"]["wxyz"]
        self._T = pin.SE3(pin.Quaternion(w, *xyz).normalized(), np.array(entry["pose"]["xyz"]))
        self.q = np.zeros(self.model.nq)
        for joint, value in entry.get("joints", {}).items():
            self.q[self.model.joints[self.model.getJointId(joint)].idx_q] = value

    @cached_property
    def joints(self) -> dict[str, int]:
        """Return the numbers of the joints by name."""
        return {self.model.names[j]: j for j in range(1, self.model.njoints)}

    @property
    def front(self) -> Float[np.ndarray, "3"]:
        """Return the front direction in the world: furniture of the package faces its own -y."""
        return -self._T.rotation[:, 1]

    def limits(self, joint: str) -> tuple[float, float]:
        """Return the lower and upper limit [rad] or [m]."""
        at = self.model.joints[self.joints[joint]].idx_q
        return float(self.model.lowerPositionLimit[at]), float(self.model.upperPositionLimit[at])

    def at(self, joint: str, value: float) -> Float[np.ndarray, " n"]:
        """Return the scene's joint values with one of them changed."""
        q = self.q.copy()
        q[self.model.joints[self.joints[joint]].idx_q] = value
        return q

    def shapes(self, q: Float[np.ndarray, " n"] | None = None) -> list[Placed]:
        """Return all boxes in the world, by default at the scene's joint values."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, self.q if q is None else q)
        return [
            Placed(
                self.model.frames[shape.parentFrame].name, shape.parentJoint,
                self._T * data.oMi[shape.parentJoint] * shape.placement, shape.geometry,
            )
            for shape in self._geometry.geometryObjects
        ]  # fmt: skip

    def moved_by(self, joint: str, shape: Placed) -> bool:
        """Return whether a shape moves with a joint."""
        return self.joints[joint] in list(self.model.supports[shape.joint])


@dataclass(frozen=True)
class Room:
    """The objects, floor and start of a scene file."""

    items: tuple[Item, ...]
    floor: Float[np.ndarray, "k 2"]
    start: Float[np.ndarray, "2"]

    @staticmethod
    def read(path: Path) -> Room:
        """Read a scene file of the package."""
        data = json.loads(path.read_text())
        start = np.array([data["start"]["x"], data["start"]["y"]])
        items = tuple(Item(entry, path.parent) for entry in data["objects"])
        return Room(items, np.array(data["floor"]), start)
