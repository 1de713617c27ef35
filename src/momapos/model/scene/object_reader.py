"""Read one object of a momapos scene."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec

from momapos.core import Cache, FileFormatError, SceneError, resolved, unknown_name
from momapos.core.geometry import pose_wxyz
from momapos.model.records import Confidence, Hypothesis, JointResistance
from momapos.model.urdf import Articulated, box_urdf, read_furniture

from .contents import WORLD
from .latches import read_latch
from .scene_members import ROUNDING_TOLERANCE, SceneConfidence, SceneEntry, SceneHypothesis, Unset
from .scene_object import SceneObject


def confidence_to_json(sure: Confidence) -> dict[str, Any]:
    """Convert the confidence of an object to the content of a scene file."""
    entry: dict[str, Any] = {"object": round(sure.object, 3), "label": round(sure.label, 3)}
    for key, found in (("joints", sure.joints), ("handles", sure.handles)):
        if found:
            entry[key] = {name: round(value, 3) for name, value in found.items()}
    return entry


def _check_joints(names: Iterable[str], joints: Collection[str], where: str) -> None:
    for name in names:
        if name not in joints:
            raise unknown_name("movable joint", name, joints, where)


def _confidence(
    sure: SceneConfidence | None, joints: Sequence[str], where: str
) -> Confidence | None:
    if sure is None:
        return None
    _check_joints(sure.joints, joints, f"{where}: confidence: joints")
    _check_joints(sure.handles, joints, f"{where}: confidence: handles")
    return Confidence(sure.object, sure.label, sure.joints, sure.handles)


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


def _hypotheses(
    given: Mapping[str, Sequence[SceneHypothesis]], joints: Mapping[str, bool], where: str
) -> dict[str, tuple[Hypothesis, ...]]:
    """Return the hypotheses of an object's joints.

    Args:
        given: Those of the file.
        joints: The object's movable joints, and whether each slides.
        where: File and object, for messages.

    Raises:
        SceneError: The probabilities of a joint do not sum to 1 or increase, or the first
            hypothesis is not the joint of the URDF.
        UnknownNameError: The object has no such joint.
    """
    _check_joints(given, joints, f"{where}: hypotheses")
    found = {}
    for name, rows in given.items():
        at = f"{where}: hypotheses of {name!r}"
        found[name] = tuple(Hypothesis(**msgspec.structs.asdict(row)) for row in rows)
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


def _check_resistance(
    known: Mapping[str, JointResistance], followers: Mapping[str, str], where: str
) -> None:
    """Refuse resistances of joints that do not exist, or that follow another one.

    Args:
        known: The resistances.
        followers: Leader of each movable joint that follows another; "" for the others.
        where: File and object, for messages.
    """
    _check_joints(known, followers, f"{where}: resistance")
    for name in known:
        if leader := followers[name]:
            raise SceneError(
                f"{where}: resistance of {name!r}: it follows {leader!r}; give the resistance of "
                f"{leader!r}"
            )


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
        self, item: SceneEntry, where: str, folder: Path, root: Path, models: ObjectModels
    ) -> None:
        self.item, self.folder, self.root, self.models = item, folder, root, models
        self.where = f"{where} ({item.name!r})"

    def read(self) -> SceneObject:
        """Return the object."""
        item, where, model = self.item, self.where, self.model()
        on = item.inside if isinstance(item.on, Unset) else item.on
        joints, names = self.joint_values("joints", item.joints, model), list(model.joints)
        closed = self.joint_values("closed", item.closed, model)
        if closed:
            model = model.changed(closed=closed)
        slides = {name: joint.kind == "prismatic" for name, joint in model.joints.items()}
        followers = {name: j.mimic.joint if j.mimic else "" for name, j in model.joints.items()}
        _check_resistance(item.resistance, followers, where)
        return SceneObject(
            item.name, item.category, pose_wxyz(item.pose.xyz, item.pose.wxyz), model, joints,
            _hypotheses(item.hypotheses, slides, where), _confidence(item.confidence, names, where),
            item.resistance, None if isinstance(item.mass, Unset) else item.mass,
            latch=read_latch(item.latch, model, where),
            on=None if isinstance(on, Unset) else on or WORLD,
        )  # fmt: skip

    def model(self) -> Articulated:
        """Return its model from a box or a URDF."""
        if isinstance(self.item.urdf, str):
            return self.models(self.file(self.item.urdf), self.item.scale)
        assert not isinstance(self.item.box, Unset)
        return Articulated(box_urdf(self.item.name, self.item.box))

    def file(self, text: str) -> Path:
        """Return the path of its URDF, which exists inside the root."""
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

    def joint_values(
        self, key: str, given: Mapping[str, float], model: Articulated
    ) -> dict[str, float]:
        """Return the joint values of a member, which are within the joints' limits."""
        _check_joints(given, model.joints, self.where)
        for name, number in given.items():
            joint = model.joint(name)
            if not joint.lower - 1e-6 <= number <= joint.upper + 1e-6:
                raise SceneError(
                    f"{self.where}: {key}: {name!r} is {number:g}, its limits are "
                    f"{joint.lower:g} to {joint.upper:g}"
                )
        return self.without_mimics(key, given, model)

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
