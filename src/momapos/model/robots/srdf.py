"""What an SRDF says of a robot: pairs of links, fingers, states; and where one may lie."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.core import MomaposError, RobotError, read_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from momapos.model.urdf import Articulated

MAX_SRDF_BYTES = 5_000_000
_FOLDERS = (".", "../srdf", "srdf", "../config", "..")
"""Where an SRDF may lie, relative to the URDF's folder, the nearest first."""
_MOVEIT = ("*_moveit_config/config", "../*_moveit_config/config", "../../*_moveit_config/config")
_MOST = 200
"""Files that are looked at [-]."""


@dataclass(frozen=True)
class Group:
    """A group of joints, such as an arm."""

    joints: tuple[str, ...]
    chains: tuple[tuple[str, str], ...]
    """First and last link of the chains whose joints belong to it too."""

    def members(self, model: Articulated) -> set[str]:
        """The movable joints of a robot that belong to the group."""
        above = {joint.child: joint for joint in model.urdf.joints}
        names = set(self.joints)
        for base, link in self.chains:
            way = set()
            while link != base and link in above:
                way.add(above[link].name)
                link = above[link].parent
            names |= way if link == base else set()
        return names & set(model.joints)


@dataclass(frozen=True)
class Srdf:
    """An SRDF; all empty where there is none."""

    path: Path | None = None
    disabled: frozenset[frozenset[str]] = frozenset()
    """Pairs of links whose contact is never checked."""
    reasons: Mapping[tuple[str, str], str] = field(default_factory=dict)
    """Why, by pair."""
    hands: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Links of the hand that hangs from a link, by that link."""
    states: tuple[Mapping[str, float], ...] = ()
    """States of joints that it names [rad] or [m]."""
    groups: Mapping[str, Group] = field(default_factory=dict)
    """What it groups, by name."""


def read_srdf(path: Path) -> frozenset[frozenset[str]]:
    """Pairs of links that an SRDF disables; none where there is no such file."""
    return _open(path).disabled if _exists(path) else frozenset()


def beside(urdf: Path) -> Path | None:
    """The SRDF of the URDF's name beside it, if there is one; every command reads it."""
    path = urdf.with_suffix(".srdf")
    return path if path.is_file() else None


def find_srdf(urdf: Path, robot: str) -> Srdf:
    """The SRDF of a URDF: of its file name, or of the robot's, where such files usually lie.

    Args:
        urdf: The URDF.
        robot: The name that the URDF gives the robot.
    """
    here = urdf.resolve().parent
    folders = [here / folder for folder in _FOLDERS]
    folders += [f for pattern in _MOVEIT for f in sorted((here / "..").glob(pattern))]
    files = [file for folder in folders for file in sorted(folder.glob("*.srdf"))[:_MOST]]
    named = [file for file in files if file.stem == urdf.stem]
    for file in dict.fromkeys(path.resolve() for path in [*named, *files]):
        try:
            found = _open(file, robot=None if file.stem == urdf.stem else robot)
        except MomaposError:
            if file.stem == urdf.stem:
                raise
            continue  # a damaged file of some other robot
        if found.path is not None:
            return found
    return Srdf()


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError as error:  # too long, or links in a circle
        raise RobotError(f"{path}: cannot be looked up ({error.strerror})") from error


def _open(path: Path, robot: str | None = None) -> Srdf:
    """Read an SRDF; an empty record where it is of another robot than the one asked for."""
    root = read_xml(path, MAX_SRDF_BYTES, error=RobotError)
    if robot is not None and root.get("name") != robot:
        return Srdf()
    reasons = {}
    for element in root.iter("disable_collisions"):
        a, b = element.get("link1"), element.get("link2")
        if a is not None and b is not None:
            reasons[a, b] = element.get("reason", "User")
    return Srdf(
        path=path,
        disabled=frozenset(frozenset(pair) for pair in reasons),
        reasons=reasons,
        hands=_hands(root),
        states=tuple(filter(None, map(_state, root.iter("group_state")))),
        groups={element.get("name", ""): _group(element) for element in root.findall("group")},
    )


def _group(element: Element) -> Group:
    chains = element.findall("chain")
    return Group(
        tuple(joint.get("name", "") for joint in element.findall("joint")),
        tuple((chain.get("base_link", ""), chain.get("tip_link", "")) for chain in chains),
    )


def _hands(root: Element) -> dict[str, tuple[str, ...]]:
    """Links of end effectors, by the link that each hangs from."""
    links = {
        group.get("name"): tuple(e.get("name", "") for e in group.iter("link"))
        for group in root.iter("group")
    }
    return {
        effector.get("parent_link", ""): links.get(effector.get("group"), ())
        for effector in root.iter("end_effector")
    }


def _state(element: Element) -> dict[str, float]:
    """Values of joints that have one; others have several."""
    values = {}
    for joint in element.iter("joint"):
        try:
            values[joint.get("name", "")] = float(joint.get("value", ""))
        except ValueError:
            continue
    return values


def srdf_text(name: str, pairs: Mapping[tuple[str, str], str]) -> str:
    """Write an SRDF that disables pairs of links, each with its reason."""
    from xml.sax.saxutils import quoteattr

    lines = disable_lines(pairs)
    return "\n".join([f"<robot name={quoteattr(name)}>", *lines, "</robot>", ""])


def disable_lines(pairs: Mapping[tuple[str, str], str]) -> list[str]:
    """The lines of an SRDF that disable pairs of links, each with its reason."""
    from xml.sax.saxutils import quoteattr

    return [
        f"  <disable_collisions link1={quoteattr(a)} link2={quoteattr(b)} reason={quoteattr(why)}/>"
        for (a, b), why in pairs.items()
    ]
