"""Check the XML tree of an untrusted URDF."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from momapos.core import UrdfError, is_name, parse_xml

from .link_elements import SHAPES
from .urdf_records import Mimic

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
