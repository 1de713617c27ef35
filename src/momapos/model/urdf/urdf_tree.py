"""Check the XML tree of an untrusted URDF, and convert its elements to records.

Acceleration, deceleration and jerk limits are of URDF 1.2 (urdfdom 6.0), and are read in files of
any version. Source: https://wiki.ros.org/urdf/XML/joint and urdfdom's README.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast
from xml.etree.ElementTree import Element

import numpy as np

from momapos.core import RobotError, UrdfError, is_name, parse_xml, unknown_name
from momapos.core.geometry import pose, pose_wxyz

from .urdf_records import Geometry, Joint, JointKind, Link, Mimic, Urdf, joint_motion

if TYPE_CHECKING:
    from jaxtyping import Float


SHAPES = {
    "box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",),
    "capsule": ("radius", "length"), "mesh": ("filename",),
}  # fmt: skip
"""Shapes of a URDF and their required attributes."""
MAX_MASS = 1e6
"""Largest mass of a link [kg]."""
_NO_ORIGIN = Element("origin")


def numbers(element: Element, key: str, default: str = "") -> list[float]:
    """Return the numbers of an attribute; commas count as spaces."""
    return [float(word) for word in element.get(key, default).replace(",", " ").split()]


def origin_pose(element: Element | None, scale: float = 1.0) -> Float[np.ndarray, "4 4"]:
    """Return the pose of an `<origin>`, by `rpy` or, from URDF 1.1 on, by `quat_xyzw`.

    Args:
        element: The element; None for the identity.
        scale: Factor of its translation [-].
    """
    origin = _NO_ORIGIN if element is None else element
    xyz = np.array(numbers(origin, "xyz", "0 0 0")) + 0.0  # without negative zeros
    if origin.get("quat_xyzw") is not None:
        x, y, z, w = numbers(origin, "quat_xyzw")
        T = pose_wxyz(tuple(xyz), (w, x, y, z))
    else:
        T = pose(xyz, _rotation(*numbers(origin, "rpy", "0 0 0")))
    T[:3, 3] *= scale
    return T


def _rotation(roll: float, pitch: float, yaw: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of roll, pitch and yaw about fixed axes [rad].

    Products of sines and cosines, not of quaternions as in `pose_rpy`: quarter turns, which most
    angles of URDFs are, keep the digits that other URDF readers give them.
    """
    (si, sj, sk), (ci, cj, ck) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    R = np.array([
        [cj * ck, sj * (si * ck) - ci * sk, sj * (ci * ck) + si * sk],
        [cj * sk, sj * (si * sk) + ci * ck, sj * (ci * sk) - si * ck],
        [-sj, cj * si, cj * ci],
    ])  # fmt: skip
    return R + 0.0


def capsule_shapes(
    radius: float, length: float, T: Float[np.ndarray, "4 4"], name: str = ""
) -> list[Geometry]:
    """Return a capsule along z as a cylinder and two balls, which is exact.

    Args:
        radius: Radius [m].
        length: Length of the straight part [m]; a capsule without one is a ball.
        T: Pose of the capsule.
        name: Name of all shapes.
    """
    if length == 0.0:
        return [Geometry("sphere", (radius,), T, name)]
    ends = (pose(np.array([0.0, 0.0, z])) for z in (length / 2, -length / 2))
    balls = [Geometry("sphere", (radius,), T @ end, name) for end in ends]
    return [Geometry("cylinder", (radius, length), T, name), *balls]


class LinkReader:
    """Converts `<link>` elements to records, and collects the names of their meshes in order."""

    def __init__(self, path: Path, scale: float) -> None:
        self.path, self.scale = path, scale
        self.meshes: list[str] = []

    def link(self, element: Element) -> Link:
        """Return the record of a link.

        Raises:
            UrdfError: Its mass, or the size of a shape, is unusable.
        """
        name = element.get("name", "")
        shapes = [
            tuple(s for part in element.findall(tag) for s in self._shapes(name, part))
            for tag in ("collision", "visual")
        ]
        return Link(name, shapes[0], shapes[1], *self._inertial(name, element))

    def _shapes(self, link: str, part: Element) -> Sequence[Geometry]:
        """Return the shapes of a `<collision>` or `<visual>`: one, or those of a capsule."""
        shape = cast("Element", part.find("geometry"))[0]
        T, s = origin_pose(part.find("origin"), self.scale), self.scale
        name, kind = part.get("name", ""), shape.tag
        if kind == "mesh":
            self.meshes.append(shape.get("filename", ""))
            size = s * np.broadcast_to(numbers(shape, "scale", "1"), 3)
        else:
            size = s * np.array([v for key in SHAPES[kind] for v in numbers(shape, key)])
        sizes = np.abs(size)
        if not (np.isfinite(sizes).all() and (sizes[:1] if kind == "capsule" else sizes).min() > 0):
            raise UrdfError(f"{self.path}: a {kind} of link {link!r} has size {tuple(size)}")
        if kind == "capsule":
            return capsule_shapes(float(size[0]), float(size[1]), T, name)
        return [Geometry(kind, tuple(size), T, name)]  # type: ignore[arg-type]

    def _inertial(
        self, name: str, link: Element
    ) -> tuple[float, tuple[float, float, float]] | tuple[()]:
        """Return mass [kg] and center of mass [m]; nothing without a mass > 0."""
        mass = link.find("inertial/mass")
        text = None if mass is None else mass.get("value")
        if text is None:
            return ()
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not abs(value) <= MAX_MASS:
            raise UrdfError(
                f"{self.path}: link {name!r}: value={text!r:.80} in <mass> must be a finite number "
                f"of at most {MAX_MASS:g}"
            )
        x, y, z = origin_pose(link.find("inertial/origin"), self.scale)[:3, 3].tolist()
        return (value, (x, y, z)) if value > 0 else ()


MAX_URDF_BYTES = 20_000_000
MAX_LINKS = 5_000
MAXSHAPES = 2_000
"""Largest number of collision elements, and of visual ones; detailed furniture has 150 [-]."""
MAX_SIZE = 1e4
"""Largest edge, radius, length or distance [m]."""
MIN_QUATERNION = 1e-6
"""Length of a quaternion below which its direction means nothing [-]."""
MAX_DEPTH = 50
VERSIONS = ("1.0", "1.1", "1.2")
"""Known versions of URDF; files without a version have the first."""
_LARGEST = {"velocity", "effort", "acceleration", "deceleration", "jerk"}
"""Limits of a joint that are magnitudes; infinity means none."""
_UNLIMITED = {*_LARGEST, "lower", "upper", "soft_lower_limit", "soft_upper_limit"}
_UNEXPANDED = ("macro", "include", "arg", "if", "unless")
"""Elements of xacro without which a file is incomplete. Others remain where xacro was to go on,
such as properties, which have no effect any more, and calls of unknown macros."""
_COUNTS = {
    "xyz": (3,), "rpy": (3,), "quat_xyzw": (4,), "size": (3,), "scale": (1, 3), "radius": (1,),
    "length": (1,), "k_position": (1,), "k_velocity": (1,), **dict.fromkeys(_UNLIMITED, (1,)),
}  # fmt: skip
"""Allowed numbers of values in an attribute."""
_LENGTHS = {"xyz", "size", "radius", "length", "scale"}
_PREFIXES = re.compile(r"[<\s]([A-Za-z]\w{0,30}):(?=[A-Za-z])")
_DECLARED = re.compile(r"\bxmlns:(\w+)\s*=")
_OPTENV = re.compile(r"\$\(optenv\s([^()]{0,1000}+)\)")


def read_tree(text: str, path: Path) -> Element:
    """Parse the XML of a URDF, and check what the URDF parser would accept silently or crash on.

    Raises:
        UrdfError: The URDF is unusable.
    """
    tree: Element = parse_xml(_with_prefixes(_OPTENV.sub(_default, text)), path, error=UrdfError)
    if tree.tag != "robot":
        raise UrdfError(f"{path}: the root element must be <robot>, not <{tree.tag}>")
    _check_tree(path, tree)
    return tree


def _with_prefixes(text: str) -> str:
    """Declare undeclared prefixes, such as `drake:`, which ROS accepts."""
    unknown = set(_PREFIXES.findall(text)) - set(_DECLARED.findall(text)) - {"xmlns", "xml"}
    names = "".join(f' xmlns:{prefix}="{prefix}"' for prefix in sorted(unknown))
    return re.sub(r"<robot(?=[\s>])", f"<robot{names}", text, count=1) if names else text


def _default(optenv: re.Match[str]) -> str:
    """Return the default of `$(optenv NAME DEFAULT)`; environment variables are not read."""
    words = optenv[1].split(None, 1)
    return words[1] if len(words) == 2 else ""


def _check_tree(path: Path, tree: Element) -> None:
    if not tree.get("name"):
        raise UrdfError(f"{path}: <robot> has no name")
    if len(tree.findall("link")) > MAX_LINKS or len(tree.findall("joint")) > MAX_LINKS:
        raise UrdfError(f"{path}: more than {MAX_LINKS} links")
    for kind in ("collision", "visual"):
        if len(tree.findall(f"link/{kind}")) > MAXSHAPES:
            raise UrdfError(f"{path}: more than {MAXSHAPES} {kind} elements; use simpler shapes")
    level = [tree]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise UrdfError(f"{path}: elements are nested deeper than {MAX_DEPTH}")
    for part in tree:
        if not isinstance(part.tag, str):
            continue
        if "xacro" in part.tag and _local(part.tag) in _UNEXPANDED:
            raise UrdfError(
                f"{path}: contains xacro macros; expand them first, with xacro IN > OUT.urdf, or, "
                "for a robot, name the file NAME.urdf.xacro and momapos robot check expands it"
            )
        if part.tag in ("link", "joint"):
            name = part.get("name", "")
            if not is_name(name, longest=500):
                raise UrdfError(f"{path}: a {part.tag} has no usable name: {name!r:.60}")
            _check_part(part, f"{path}: {part.tag} {name!r}")


def _check_part(part: Any, where: str) -> None:
    """Check the numbers and shapes of a link or joint; commas count as spaces."""
    for element in part.iter():
        if element.tag == "geometry":
            _check_geometry(element, where)
        if element.tag == "origin":
            _check_origin(element, where)
        if element.tag in ("collision", "visual") and element.find("geometry") is None:
            raise UrdfError(f"{where}: a <{element.tag}> has no <geometry>")
        for key in _COUNTS.keys() & set(element.keys()):
            if element.tag not in ("texture", "color"):
                _check_numbers(element, key, where)
    if part.tag == "joint":
        for end in ("parent", "child"):
            element = part.find(end)
            if element is None:
                raise UrdfError(f"{where} has no <{end}>")
            if not element.get("link"):
                raise UrdfError(f"{where}: <{end}> has no link")


def _check_numbers(element: Any, key: str, where: str) -> None:
    text = element.get(key)
    values = [_float(word) for word in text.replace(",", " ").split()]
    unlimited = key in _UNLIMITED
    usable = all(math.isfinite(v) or (unlimited and math.isinf(v)) for v in values)
    if len(values) not in _COUNTS[key] or not usable:
        count = " or ".join(map(str, _COUNTS[key]))
        raise UrdfError(
            f"{where}: {key}={text!r:.80} in <{element.tag}> must be {count} finite "
            f"number{'s' * (count != '1')}{' or inf' * unlimited}"
        )
    if key in _LENGTHS and max(map(abs, values)) > MAX_SIZE:
        raise UrdfError(f"{where}: {key}={text!r:.80} is larger than {MAX_SIZE:g}")
    ball = key == "length" and element.tag == "capsule" and values == [0.0]
    if key in ("size", "radius", "length") and min(values) <= 0 and not ball:
        raise UrdfError(f"{where}: {key}={text!r:.80} in <{element.tag}> must be > 0")
    if key in _LARGEST and min(values) < 0:
        raise UrdfError(f"{where}: {key}={text!r:.80} in <{element.tag}> must not be negative")


def _check_origin(origin: Any, where: str) -> None:
    text = origin.get("quat_xyzw")
    if text is None:
        return
    if origin.get("rpy") is not None:
        raise UrdfError(f"{where}: <origin> has both rpy and quat_xyzw; keep the one that is meant")
    values = [_float(word) for word in text.replace(",", " ").split()]
    if values and math.hypot(*values) < MIN_QUATERNION:
        raise UrdfError(
            f"{where}: quat_xyzw={text!r:.80} in <origin> has length 0; no rotation is 0 0 0 1"
        )


def _check_geometry(geometry: Any, where: str) -> None:
    tags = [child.tag for child in geometry]
    if len(tags) != 1 or tags[0] not in SHAPES:
        found, shapes = ", ".join(map(str, tags)) or "nothing", ", ".join(SHAPES)
        raise UrdfError(f"{where}: <geometry> must contain one of {shapes}, not {found:.80}")
    for key in SHAPES[tags[0]]:
        if not geometry[0].get(key):
            raise UrdfError(f"{where}: <{tags[0]}> has no {key}")


def _float(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def fix_root_joints(tree: Element) -> tuple[str, ...]:
    """Fix planar and floating joints at the root, which represent a mobile base.

    Returns:
        The names of these joints.
    """
    joints = tree.findall("joint")
    children = {link_of(joint, "child") for joint in joints}
    fixed = [
        joint
        for joint in joints
        if joint.get("type") in ("planar", "floating") and link_of(joint, "parent") not in children
    ]
    for joint in fixed:
        joint.set("type", "fixed")
    return tuple(joint.get("name", "") for joint in fixed)


def link_of(joint: Element, end: str) -> str:
    """Return the link that `<parent>` or `<child>` of a joint names."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def leftover_notes(tree: Element) -> list[str]:
    """Return in words which calls of macros a xacro has left in a URDF; ROS leaves them out, too.

    Definitions of properties have no effect any more.
    """
    calls = (_local(part.tag) for part in tree if isinstance(part.tag, str) and "xacro" in part.tag)
    names = sorted({name for name in calls if name != "property"})
    if not names:
        return []
    listed = ", ".join(f"<xacro:{name}>" for name in names[:5])
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return [f"{listed}{more} of <robot> is not expanded; what it stands for is left out"]


def _local(tag: str) -> str:
    """Return the name of a tag without its namespace."""
    return tag.rpartition("}")[2]


def version_notes(tree: Element) -> list[str]:
    """Return in words how the version of a URDF differs from its content.

    Every known feature is read in a file of any version.
    """
    stated = tree.get("version", VERSIONS[0])
    if stated not in VERSIONS:
        return [f"version {stated!r:.40} of <robot> is unknown; the file is read as {VERSIONS[-1]}"]
    if stated > VERSIONS[0]:
        return []
    later = [
        word
        for word, found in (
            ("quat_xyzw", any(origin.get("quat_xyzw") for origin in tree.iter("origin"))),
            ("<capsule>", tree.find(".//geometry/capsule") is not None),
        )
        if found
    ]
    words = f"{' and '.join(later)} are of URDF 1.1, but <robot> states no version above 1.0; they"
    return [f"{words} are read, while ROS leaves them out"] if later else []


def mimics(tree: Element, path: Path, scale: float) -> dict[str, Mimic]:
    """Return the scaled mimic relations by joint name.

    Raises:
        UrdfError: A number is unusable, or the leader does not exist.
    """
    slides = {
        joint.get("name", ""): joint.get("type") == "prismatic" for joint in tree.findall("joint")
    }
    found = {}
    for joint in tree.findall("joint"):
        mimic, name = joint.find("mimic"), joint.get("name", "")
        if mimic is None or joint.get("type") == "fixed":
            continue
        where, other = f"{path}: joint {name!r}", mimic.get("joint", "")
        if other not in slides:
            raise UrdfError(f"{where}: mimic names the joint {other!r:.80}, which does not exist")
        texts = mimic.get("multiplier", "1"), mimic.get("offset", "0")
        ratio, offset = map(_float, texts)
        if not (abs(ratio) <= MAX_SIZE and abs(offset) <= MAX_SIZE):
            raise UrdfError(
                f"{where}: mimic has multiplier={texts[0]!r:.40} and offset={texts[1]!r:.40}; both "
                "must be finite numbers"
            )
        lengths = scale if slides[name] else 1.0
        found[name] = Mimic(
            other, ratio * lengths / (scale if slides[other] else 1.0), offset * lengths
        )
    return found


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


def check_coupled(urdf: Urdf, names: Iterable[str], where: str) -> None:
    """Check joints that a robot file couples to leaders.

    Args:
        urdf: The model with the couplings.
        names: The coupled joints.
        where: Source of the couplings, for messages.

    Raises:
        UnknownNameError: A coupled joint or its leader does not exist or is fixed.
        RobotError: The limits of a coupled joint leave its leader no range.
    """
    moving = {joint.name: joint for joint in urdf.joints if joint.movable}
    for name in names:
        joint = moving.get(name)
        if joint is None or joint.mimic is None:
            raise unknown_name("movable joint", name, moving, where)
        mimic = joint.mimic
        if not _shared(moving[mimic.joint], joint, mimic):
            raise RobotError(
                f"{where}: the limits of {name!r} leave {mimic.joint!r} no range; check the ratio "
                f"{mimic.ratio:g} and the offset {mimic.offset:g}"
            )


def follow(
    joints: Sequence[Joint], follows: Mapping[str, Mimic], where: str, error: type[Exception]
) -> tuple[Joint, ...]:
    """Return joints with mimic relations resolved: leaders are no mimic joints themselves.

    A leader's limits are narrowed to those of its mimic joints. Limits that would leave it no range
    are ignored: few programs read the limits of mimic joints, so files often have wrong ones.

    Args:
        joints: All joints of a model.
        follows: Mimic relations by the name of the mimic joint.
        where: Prefix of messages.
        error: Class of the error to raise if relations are cyclic.
    """
    leaders = {name: leader_of(name, follows, where, error) for name in follows}
    narrowed = {joint.name: joint for joint in joints}
    for name, mimic in leaders.items():
        narrowed[mimic.joint] = _narrowed(narrowed[mimic.joint], narrowed[name], mimic)
    return tuple(replace(narrowed[joint.name], mimic=leaders.get(joint.name)) for joint in joints)


def leader_of(name: str, follows: Mapping[str, Mimic], where: str, error: type[Exception]) -> Mimic:
    """Return a joint's relation to its final leader; see `follow` for the arguments."""
    mimic, seen = follows[name], {name}
    while mimic.joint in follows:
        if mimic.joint in seen:
            raise error(f"{where}: joint {name!r} follows itself")
        seen.add(mimic.joint)
        above = follows[mimic.joint]
        offset = mimic.ratio * above.offset + mimic.offset
        mimic = Mimic(above.joint, mimic.ratio * above.ratio, offset)
    return mimic


def _shared(leader: Joint, follower: Joint, mimic: Mimic) -> tuple[float, float] | None:
    """Return the leader's limits within which the follower keeps its own, or None."""
    if mimic.ratio == 0.0:
        return leader.lower, leader.upper
    ends = sorted((end - mimic.offset) / mimic.ratio for end in (follower.lower, follower.upper))
    lower, upper = max(leader.lower, ends[0]), min(leader.upper, ends[1])
    return (lower, upper) if lower < upper else None


def _narrowed(leader: Joint, follower: Joint, mimic: Mimic) -> Joint:
    """Return the leader with all limits narrowed for a follower."""
    shared = _shared(leader, follower, mimic)
    if shared is None or mimic.ratio == 0.0:
        return leader
    velocity = min(leader.velocity, follower.velocity / abs(mimic.ratio))
    acceleration = min(leader.acceleration, follower.acceleration / abs(mimic.ratio))
    jerk = min(leader.jerk, follower.jerk / abs(mimic.ratio))
    return replace(
        leader, lower=shared[0], upper=shared[1], velocity=velocity, acceleration=acceleration,
        jerk=jerk,
    )  # fmt: skip
