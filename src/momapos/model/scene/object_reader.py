"""Read one object of a momapos scene."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import FileFormatError, SceneError, is_name, resolved, unknown_name
from momapos.core.geometry import pose_wxyz
from momapos.model.urdf import Articulated, box_urdf

from .confidence import read_confidence
from .floor_areas import MAX_DISTANCE, read_numbers
from .hypotheses import read_hypotheses
from .latches import read_latch
from .object_models import ObjectModels
from .resistance_members import read_resistance
from .scene_object import MAX_MASS, SceneObject
from .usual_sizes import size_hint, usual_edge

if TYPE_CHECKING:
    from jaxtyping import Float

MIMIC_TOLERANCE = 1e-3
"""Largest difference between a mimic joint's value in a file and that of its leader [rad], [m]."""
MAX_EDGE = 1e3  # maximum edge of a box [m]


class ObjectReader:
    """Reads one object of a momapos scene.

    Args:
        item: The object of the file.
        where: File and index, for messages.
        folder: Folder of the file, to which the URDF's path is relative.
        root: Folder that no path may leave.
        models: Reads URDFs.

    Raises:
        SceneError, UnknownNameError: A member is invalid.
    """

    def __init__(
        self, item: Mapping[str, Any], where: str, folder: Path, root: Path, models: ObjectModels
    ) -> None:
        self.item, self.folder, self.root, self.models = item, folder, root, models
        self.name = read_text(item.get("name"), f"{where}: name")
        self.where = f"{where} ({self.name!r})"

    def read(self) -> SceneObject:
        """Return the object."""
        category = self.item.get("category", "")
        if category != "":
            category = read_text(category, f"{self.where}: category")
        model = self.model()
        joints, names = self.joint_values("joints", model), list(model.joints)
        closed = self.joint_values("closed", model)
        if closed:
            model = model.changed(closed=closed)
        slides = {name: joint.kind == "prismatic" for name, joint in model.joints.items()}
        found = read_hypotheses(self.item.get("hypotheses", {}), slides, self.where)
        sure = read_confidence(self.item.get("confidence"), names, self.where)
        followers = {name: j.mimic.joint if j.mimic else "" for name, j in model.joints.items()}
        known = read_resistance(self.item.get("resistance", {}), followers, self.where)
        return SceneObject(
            self.name, category, self.pose(), model, joints, found, sure, known, self.mass(),
            latch=read_latch(self.item.get("latch"), model, self.where),
        )  # fmt: skip

    def mass(self) -> float | None:
        """Return its known mass [kg]; None if the file gives none."""
        if "mass" not in self.item:
            return None
        mass = float(read_numbers([self.item["mass"]], 1, f"{self.where}: mass")[0])
        if not 0 < mass <= MAX_MASS:
            raise SceneError(
                f"{self.where}: mass must be above 0 and at most {MAX_MASS:g} kg, not {mass:g}"
            )
        return mass

    def pose(self) -> Float[np.ndarray, "4 4"]:
        """Return the pose of its frame in the world."""
        pose = self.item.get("pose")
        if not isinstance(pose, dict):
            raise SceneError(f"{self.where}: pose must be {{'xyz': [...], 'wxyz': [...]}}")
        xyz = read_numbers(pose.get("xyz"), 3, f"{self.where}: pose.xyz")
        wxyz = read_numbers(pose.get("wxyz", [1, 0, 0, 0]), 4, f"{self.where}: pose.wxyz")
        if np.abs(xyz).max() > MAX_DISTANCE:
            raise SceneError(f"{self.where}: pose.xyz is more than 10 km away")
        length = math.hypot(*wxyz)
        if not 0.9 < length < 1.1:
            raise SceneError(f"{self.where}: pose.wxyz has length {length:g}; it must be 1")
        return pose_wxyz(tuple(xyz), tuple(wxyz))

    def model(self) -> Articulated:
        """Return its model from a box or a URDF."""
        if ("urdf" in self.item) == ("box" in self.item):
            raise SceneError(f"{self.where}: needs either 'urdf' or 'box'")
        if "box" in self.item:
            size = read_numbers(self.item["box"], 3, f"{self.where}: box")
            if size.min() <= 0 or size.max() > MAX_EDGE:
                category = str(self.item.get("category", ""))
                usual = usual_edge(category, self.name, jointed=False)
                hint = size_hint(size.tolist(), usual) if size.min() > 0 else ""
                raise SceneError(
                    f"{self.where}: box edges must be between 0 and {MAX_EDGE:g} m, not "
                    f"{', '.join(f'{v:g}' for v in size)}" + (f"; {hint}" if hint else "")
                )
            x, y, z = map(float, size)
            return Articulated(box_urdf(self.name, (x, y, z)))
        scale = float(read_numbers([self.item.get("scale", 1.0)], 1, f"{self.where}: scale")[0])
        if not 1e-3 <= scale <= 1e3:
            raise SceneError(f"{self.where}: scale must be between 0.001 and 1000, not {scale:g}")
        return self.models(self.file(), scale)

    def file(self) -> Path:
        """Return the path of its URDF, which exists inside the root."""
        text = read_text(self.item["urdf"], f"{self.where}: urdf")
        try:
            file = resolved(self.folder / text)
            inside, exists = file.is_relative_to(self.root), file.is_file()
        except (FileFormatError, OSError) as error:  # too long, cyclic links, a NUL
            raise SceneError(f"{self.where}: urdf {text!r:.80} cannot be looked up") from error
        if Path(text).is_absolute() or not inside:
            raise SceneError(
                f"{self.where}: urdf {text!r} leaves the scene's folder {self.root}; "
                "paths are relative and stay inside it"
            )
        if not exists:
            raise SceneError(f"{self.where}: urdf {text!r} does not exist below {self.folder}")
        return self.folder / text

    def joint_values(self, key: str, model: Articulated) -> dict[str, float]:
        """Return the joint values of a member, which are within the joints' limits."""
        joints = self.item.get(key, {})
        if not isinstance(joints, dict):
            raise SceneError(f"{self.where}: {key} must be {{name: value}}")
        values = {}
        for name, value in joints.items():
            if name not in model.joints:
                raise unknown_name("movable joint", name, model.joints, self.where)
            number = float(read_numbers([value], 1, f"{self.where}: {key}: {name!r}")[0])
            joint = model.joint(name)
            if not joint.lower - 1e-6 <= number <= joint.upper + 1e-6:
                raise SceneError(
                    f"{self.where}: {key}: {name!r} is {number:g}, its limits are "
                    f"{joint.lower:g} to {joint.upper:g}"
                )
            values[name] = number
        return self.without_mimics(key, values, model)

    def without_mimics(
        self, key: str, values: Mapping[str, float], model: Articulated
    ) -> dict[str, float]:
        """Return values without those of mimic joints, which must agree with their leaders."""
        there = model.all_values(values)
        for name, value in values.items():
            mimic = model.joint(name).mimic
            if mimic is not None and abs(there[name] - value) > MIMIC_TOLERANCE:
                raise SceneError(
                    f"{self.where}: {key}: {name!r} is {value:g}, but it follows {mimic.joint!r} "
                    f"and is at {there[name]:g}; set {mimic.joint!r} instead"
                )
        return {name: v for name, v in values.items() if model.joint(name).mimic is None}


def read_text(value: object, where: str) -> str:
    """Return a printable string of limited length.

    Raises:
        SceneError: It is none; the message starts with `where`.
    """
    if not is_name(value):
        raise SceneError(f"{where} must be a printable string of 1 to 1000 characters")
    return value
