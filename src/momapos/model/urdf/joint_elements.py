"""Convert `<joint>` elements of a checked URDF to records, scaled to meters.

Acceleration, deceleration and jerk limits are of URDF 1.2 (urdfdom 6.0), and are read in files of
any version. Source: https://wiki.ros.org/urdf/XML/joint and urdfdom's README.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast
from xml.etree.ElementTree import Element

import numpy as np

from momapos.core import UrdfError

from .link_elements import numbers, origin_pose
from .urdf_records import Joint, JointKind, Mimic, joint_motion
from .urdf_tree import link_of

MAX_NAMED = 4
"""Number of joints that a note names [-]."""
MAX_RESISTANCE = 1e5
"""Maximum friction and damping; excludes mistaken units, see `JointResistance` [-]."""


class JointReader:
    """Converts `<joint>` elements to records, and collects what it reads differently."""

    def __init__(self, path: Path, scale: float, *, actuated: bool) -> None:
        """Set what all joints share.

        Args:
            path: The URDF.
            scale: Factor of lengths [-].
            actuated: Whether motors move the joints, so that soft limits count.
        """
        self.path, self.scale, self.actuated = path, scale, actuated
        self.without_axis: list[str] = []
        self.notes: dict[str, list[str]] = {}

    def joint(self, element: Element) -> Joint:
        """Return the record of a joint.

        Raises:
            UrdfError: Its type, axis or limits are unusable.
        """
        name, kind = element.get("name", ""), element.get("type")
        where = f"{self.path}: joint {name!r}"
        if kind not in ("revolute", "continuous", "prismatic", "fixed"):
            raise UrdfError(
                f"{where} is {kind!r}; revolute, continuous, prismatic and fixed are supported"
            )
        tag = element.find("axis")
        axis = np.array([1.0, 0.0, 0.0] if tag is None else numbers(tag, "xyz", "1 0 0"))
        length = float(np.linalg.norm(axis))
        if kind != "fixed" and length < 1e-9:
            raise UrdfError(f"{where} has a zero axis")
        if kind != "fixed" and tag is None:
            self.without_axis.append(name)
        limit = element.find("limit")
        limits = (
            {} if limit is None else {k: numbers(limit, k)[0] for k in _LIMITS & set(limit.keys())}
        )
        factor = self.scale if kind == "prismatic" else 1.0
        lower, upper = _range(where, kind, limits, factor)
        joint = Joint(
            name, cast("JointKind", kind), link_of(element, "parent"), link_of(element, "child"),
            origin_pose(element.find("origin"), self.scale),
            axis / length if length > 1e-9 else axis, lower, upper,
            limits.get("velocity") or math.inf,
            effort=limits.get("effort") or math.inf,
            acceleration=self._least(name, limits, "acceleration", "deceleration"),
            jerk=self._least(name, limits, "jerk"),
            friction=self._resistance(where, element, "friction"),
            damping=self._resistance(where, element, "damping"),
        )  # fmt: skip
        return self._within_soft_limits(joint, element.find("safety_controller"), factor)

    def _resistance(self, where: str, element: Element, key: str) -> float:
        """Return a value of `<dynamics>`, which counts for joints without a motor; 0 for none."""
        tag = None if self.actuated else element.find("dynamics")
        text = "0" if tag is None else tag.get(key, "0")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 <= value <= MAX_RESISTANCE:
            raise UrdfError(
                f"{where}: {key}={text!r:.80} in <dynamics> must be a number from 0 to "
                f"{MAX_RESISTANCE:g}"
            )
        return value

    def _least(self, name: str, limits: Mapping[str, float], *keys: str) -> float:
        """Return the smallest of some limits; infinite without one."""
        found = [limits[key] for key in keys if key in limits]
        if 0.0 in found:
            self._note(_STILL, name)
        return min((value for value in found if value > 0), default=math.inf)

    def _within_soft_limits(self, joint: Joint, safety: Element | None, factor: float) -> Joint:
        """Return the joint within the soft limits of its `<safety_controller>`; zeros mean none."""
        if safety is None or not self.actuated or not joint.movable:
            return joint
        keys = ("soft_lower_limit", "soft_upper_limit")
        lower, upper = (factor * numbers(safety, key, "0")[0] for key in keys)
        if any(numbers(safety, key, "0")[0] for key in ("k_position", "k_velocity")):
            self._note(_GAINS, joint.name)
        if lower == upper == 0.0:
            return joint
        both = max(lower, joint.lower), min(upper, joint.upper)
        if both[0] >= both[1]:
            self._note(_OUTSIDE, joint.name)
            return joint
        turns = joint.kind == "continuous" and math.isfinite(both[1] - both[0])
        kind = "revolute" if turns else joint.kind
        return replace(joint, kind=kind, lower=both[0], upper=both[1])

    def _note(self, what: str, joint: str) -> None:
        self.notes.setdefault(what, []).append(joint)

    def words(self) -> list[str]:
        """Return what is not honored, or read differently, one line each."""
        return [f"{_named(names)}: {what}" for what, names in self.notes.items()]


_LIMITS = {"lower", "upper", "velocity", "effort", "acceleration", "deceleration", "jerk"}
_STILL = "an acceleration, deceleration or jerk of 0 in <limit> counts as none"
_OUTSIDE = "the soft limits of <safety_controller> leave no range and count as none"
_GAINS = (
    "k_position and k_velocity of <safety_controller> are gains of the robot's controller; plans "
    "keep its soft limits only"
)
_EQUAL = "equal limits in <limit>; it is fixed at them"


def _range(
    where: str, kind: str, limits: Mapping[str, float], factor: float
) -> tuple[float, float]:
    if kind == "fixed":
        return 0.0, 0.0
    if kind == "continuous" or not limits.keys() & {"lower", "upper"}:
        return -math.inf, math.inf
    lower, upper = (factor * limits.get(key, 0.0) for key in ("lower", "upper"))
    if lower > upper:
        raise UrdfError(f"{where} has lower limit {lower:g} above upper limit {upper:g}")
    return lower, upper


def fix_equal_limits(
    joints: Sequence[Joint], follows: Mapping[str, Mimic], reader: JointReader
) -> tuple[list[Joint], dict[str, Mimic]]:
    """Fix the joints that may not move, and what follows them, at their values.

    The limits of a follower mean nothing here, because few programs read them; see `follow`.

    Returns:
        The joints, and the mimic relations that are left.
    """
    value = {
        joint.name: joint.lower
        for joint in joints
        if joint.movable and joint.lower == joint.upper and joint.name not in follows
    }
    for name in value:
        reader._note(_EQUAL, name)
    left = dict(follows)
    while found := [name for name, mimic in left.items() if mimic.joint in value]:
        for name in found:
            mimic = left.pop(name)
            value[name] = mimic.at(value[mimic.joint])
    fixed = [
        replace(
            joint, kind="fixed", lower=0.0, upper=0.0,
            T_parent_joint=joint.T_parent_joint @ joint_motion(joint, value[joint.name]),
        )
        if joint.name in value
        else joint
        for joint in joints
    ]  # fmt: skip
    return fixed, left


def _named(names: Sequence[str]) -> str:
    """Return the first names of joints, in words."""
    more = len(names) - MAX_NAMED
    named = ", ".join(map(repr, names[:MAX_NAMED]))
    return f"joint{'s' * (len(names) > 1)} {named}" + (f" and {more} more" if more > 0 else "")
