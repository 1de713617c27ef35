"""Read one object of a momapos scene."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from momapos.core import (
    Cache,
    FileFormatError,
    InputError,
    SceneError,
    is_name,
    resolved,
    unknown_name,
)
from momapos.core.geometry import pose_wxyz
from momapos.model.records import Confidence, Hypothesis, JointResistance, PartKind
from momapos.model.urdf import Articulated, box_urdf, read_furniture

from .latches import read_latch
from .scene import MAX_DISTANCE, read_numbers
from .scene_object import MAX_MASS, SceneObject

if TYPE_CHECKING:
    from jaxtyping import Float


def confidence_to_json(sure: Confidence) -> dict[str, Any]:
    """Convert the confidence of an object to the content of a scene file."""
    entry: dict[str, Any] = {"object": round(sure.object, 3), "label": round(sure.label, 3)}
    for key, found in (("joints", sure.joints), ("handles", sure.handles)):
        if found:
            entry[key] = {name: round(value, 3) for name, value in found.items()}
    return entry


def read_confidence(value: object, joints: Sequence[str], where: str) -> Confidence | None:
    """Read the confidence of an object; None if the file has none.

    Args:
        value: Content of the file.
        joints: The object's movable joints.
        where: File and object, for messages.

    Raises:
        SceneError: A value is not a number from 0 to 1.
        UnknownNameError: The object has no such joint.
    """
    if value is None:
        return None
    where = f"{where}: confidence"
    if not isinstance(value, dict):
        raise SceneError(f'{where} must be {{"object": ..., "label": ...}}')
    both = _shares({key: value.get(key) for key in ("object", "label")}, where)
    parts = []
    for key in ("joints", "handles"):
        found = value.get(key, {})
        if not isinstance(found, dict):
            raise SceneError(f"{where}: {key} must be {{joint: number}}")
        for name in found:
            if name not in joints:
                raise unknown_name("movable joint", name, joints, f"{where}: {key}")
        parts.append(_shares(found, f"{where}: {key}"))
    return Confidence(both["object"], both["label"], *parts)


def _shares(values: Mapping[str, Any], where: str) -> dict[str, float]:
    for name, value in values.items():
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not 0 <= value <= 1:
            raise SceneError(f"{where}: {name!r:.60} must be a number from 0 to 1")
    return {name: float(value) for name, value in values.items()}


KINDS: tuple[PartKind, ...] = get_args(PartKind)
MAX_HYPOTHESES = 16
"""Maximum number of hypotheses of a joint [-]."""
ROUNDING_TOLERANCE = 1e-3
"""Tolerance of rounded probabilities and of unit vectors [-]."""
MAX_COORDINATE = 1e3
"""Maximum coordinate of a point on an axis, in the object's frame [m]."""


def hypotheses_to_json(found: Sequence[Hypothesis]) -> list[dict[str, Any]]:
    """Convert the hypotheses of a joint to the content of a scene file."""
    return [
        {
            "kind": one.kind,
            "probability": round(one.probability, 4),
            "point": list(one.point),
            "axis": list(one.axis),
            "upper": round(one.upper, 5),
        }
        for one in found
    ]


def read_hypotheses(
    value: object, joints: Mapping[str, bool], where: str
) -> dict[str, tuple[Hypothesis, ...]]:
    """Read the hypotheses of an object's joints.

    Args:
        value: Content of the file.
        joints: The object's movable joints, and whether each slides.
        where: File and object, for messages.

    Raises:
        SceneError: A value is invalid, the probabilities of a joint do not sum to 1 or increase, or
            the first hypothesis is not the joint of the URDF.
        UnknownNameError: The object has no such joint.
    """
    if not isinstance(value, dict):
        raise SceneError(f"{where}: hypotheses must be {{joint: [...]}}")
    found = {}
    for name, rows in value.items():
        if name not in joints:
            raise unknown_name("movable joint", name, list(joints), f"{where}: hypotheses")
        at = f"{where}: hypotheses of {name!r}"
        if not isinstance(rows, list) or not 1 <= len(rows) <= MAX_HYPOTHESES:
            raise SceneError(f"{at} must be a list of 1 to {MAX_HYPOTHESES} hypotheses")
        found[name] = tuple(_hypothesis(row, f"{at}: {k}") for k, row in enumerate(rows))
        total = sum(one.probability for one in found[name])
        if abs(total - 1.0) > ROUNDING_TOLERANCE * len(rows):
            raise SceneError(f"{at}: the probabilities sum to {total:.4g}; they must sum to 1")
        _check_first(found[name], joints[name], at)
    return found


def _check_first(found: Sequence[Hypothesis], slides: bool, at: str) -> None:
    """Check that the most probable hypothesis stands first and fits the joint of the URDF.

    Planners take the joint of the URDF for the most probable one.
    """
    for before, after in pairwise(found):
        if after.probability > before.probability:
            raise SceneError(
                f"{at}: {after.kind} ({after.probability:g}) stands after the less probable "
                f"{before.kind} ({before.probability:g}); list the most probable first, which is "
                "the joint of the URDF"
            )
    if (found[0].kind == "drawer") != slides:
        joint = "prismatic" if slides else "a hinge"
        raise SceneError(
            f"{at}: the first is a {found[0].kind}, but the joint of the URDF is {joint}; the "
            "first must be the joint of the URDF"
        )


def _hypothesis(row: object, where: str) -> Hypothesis:
    if not isinstance(row, dict):
        raise SceneError(f"{where} must be a JSON object")
    kind = next((known for known in KINDS if known == row.get("kind")), None)
    if kind is None:
        given = f"{row.get('kind')!r:.40}"
        raise SceneError(f"{where}: kind {given} must be one of {', '.join(KINDS)}")
    point, axis = (_triple(row, key, where) for key in ("point", "axis"))
    if abs(float(np.linalg.norm(axis)) - 1.0) > ROUNDING_TOLERANCE:
        raise SceneError(f"{where}: axis must have length 1")
    probability, upper = (_number(row, key, where) for key in ("probability", "upper"))
    if not 0.0 <= probability <= 1.0:
        raise SceneError(f"{where}: probability {probability:g} must be from 0 to 1")
    if not 0.0 <= upper <= MAX_COORDINATE:
        raise SceneError(f"{where}: upper must be 0 or more, not {upper:g}")
    return Hypothesis(kind, probability, point, axis, upper)


def _triple(row: Mapping[str, Any], key: str, where: str) -> tuple[float, float, float]:
    values = row.get(key)
    if not isinstance(values, list) or len(values) != 3:
        raise SceneError(f"{where}: {key} must be 3 numbers")
    x, y, z = (_number({key: value}, key, where) for value in values)
    return x, y, z


def _number(row: Mapping[str, Any], key: str, where: str) -> float:
    value = row.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SceneError(f"{where}: {key} must be a number")
    # Compare integers of any length before converting to float, which may overflow.
    if not -MAX_COORDINATE <= value <= MAX_COORDINATE:
        raise SceneError(f"{where}: {key} must be a finite number within {MAX_COORDINATE:g}")
    return float(value)


_KEYS = tuple(item.name for item in fields(JointResistance))


def read_resistance(
    value: object, followers: Mapping[str, str], where: str
) -> dict[str, JointResistance]:
    """Read the known resistance of an object's joints.

    Args:
        value: Content of the file.
        followers: Leader of each movable joint that follows another; "" for the others.
        where: File and object, for messages.

    Raises:
        SceneError: A value is unusable, or a key is unknown.
        UnknownNameError: The object has no such joint.
    """
    if not isinstance(value, dict):
        raise SceneError(f"{where}: resistance must be {{joint: {{...}}}}")
    found = {}
    for name, members in value.items():
        if name not in followers:
            raise unknown_name("movable joint", name, list(followers), f"{where}: resistance")
        at = f"{where}: resistance of {name!r}"
        if followers[name]:
            leader = followers[name]
            raise SceneError(f"{at}: it follows {leader!r}; give the resistance of {leader!r}")
        if not isinstance(members, dict):
            raise SceneError(f"{at} must be a JSON object")
        for key in members:
            if key not in _KEYS:
                raise unknown_name("key", key, _KEYS, at)
        try:
            found[name] = JointResistance(**members)
        except InputError as error:
            raise SceneError(f"{at}: {str(error).removeprefix('JointResistance.')}") from error
    return found


class ObjectModels:
    """Reads each URDF of a scene once per scale, so that objects share their models."""

    def __init__(self, root: Path | None, cache: Cache | None, visual_collisions: bool) -> None:
        self.root, self.cache, self.visual_collisions = root, cache, visual_collisions
        self.read: dict[tuple[Path, float], Articulated] = {}

    def __call__(self, path: Path, scale: float) -> Articulated:
        key = (resolved(path), scale)
        if key not in self.read:
            urdf = read_furniture(
                path,
                root=self.root,
                scale=scale,
                cache=self.cache,
                visual_collisions=self.visual_collisions,
            )
            self.read[key] = Articulated(urdf, cache=self.cache)
        return self.read[key]

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed or left out, once per file."""
        return tuple(dict.fromkeys(n for model in self.read.values() for n in model.urdf.notes))


UNITS = (("millimeters", 0.001), ("centimeters", 0.01), ("inches", 0.0254))
"""Units in which files are often written, with their length [m]."""
_LARGE, _SMALL = (0.2, 5.0), (0.015, 1.2)
_WORDS = {
    _LARGE: (
        "fridge", "refrigerator", "freezer", "oven", "stove", "dishwasher", "microwave", "cabinet",
        "cupboard", "wardrobe", "closet", "drawer", "dresser", "chest", "table", "desk", "counter",
        "chair", "sofa", "couch", "bed", "shelf", "door", "sink", "washer", "bench",
    ),
    _SMALL: (
        "cup", "mug", "bottle", "bowl", "plate", "apple", "banana", "pear", "fork", "spoon",
        "knife", "phone",
    ),
}  # fmt: skip
_ARTICULATED, _RIGID = (0.05, 6.0), (0.004, 8.0)
"""Usual largest edge of an object with joints, and of any other object [m]. Taps and small boxes
are 6 cm, a wall of cupboards is 5 m, and a pea is 7 mm."""
FLOOR_EDGE = (0.8, 50.0)
"""Usual edge of a floor: a robot is 0.4 to 0.8 m wide, and larger rooms are refused [m]."""


def usual_edge(category: str, name: str, *, jointed: bool) -> tuple[float, float]:
    """Return the usual range of an object's largest edge [m].

    Args:
        category: For example "fridge"; the last known word counts.
        name: Its name, which counts if the category is unknown.
        jointed: Whether it has movable joints.
    """
    for text in (category, name):
        words = re.findall(r"[a-z]+", text.lower())
        for word in reversed(words):
            for usual, known in _WORDS.items():
                if word in known:
                    return usual
    return _ARTICULATED if jointed else _RIGID


def unit_factors(edge: float, usual: tuple[float, float]) -> list[tuple[str, float]]:
    """Return the units in which a length may have been written, and the factors that correct it.

    Args:
        edge: The length as read in meters.
        usual: Range of usual lengths [m].

    Returns:
        Unit, and a factor below 1 if it was read as meters, above 1 if it was converted once too
        often. The most probable comes first: that which leads nearest to the middle of the range,
        inches last. Nothing if the length is usual, or unusual in every unit.
    """
    low, high = usual
    if low <= edge <= high:
        return []
    found = [
        (name, factor)
        for name, unit in UNITS
        for factor in (unit, 1 / unit)
        if low <= edge * factor <= high
    ]
    middle = (low * high) ** 0.5
    return sorted(found, key=lambda f: (f[0] == "inches", abs(math.log(edge * f[1] / middle))))


def size_hint(size: Sequence[float], usual: tuple[float, float]) -> str:
    """Return the question whether a size was written in another unit; "" if it is usual."""
    found = unit_factors(max(size), usual)
    if not found:
        return ""
    words = [
        f"{unit} (factor {factor:.4g}: {' x '.join(f'{factor * v:.3g}' for v in size)} m)"
        for unit, factor in found
    ]
    if found[0][1] < 1:
        return f"lengths are meters; are these {' or '.join(words)}?"
    return f"were meters converted as {' or '.join(words)} once too often?"


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
