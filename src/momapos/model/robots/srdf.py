"""Find and read SRDFs: disabled link pairs, hands, named states and joint groups."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.core import MomaposError, RobotError, read_xml, resolved

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from momapos.model.urdf import Articulated

MAX_SRDF_BYTES = 5_000_000
NEVER = "Never"
"""Reason of a pair that is said to touch in no state."""
_FOLDERS = (".", "../srdf", "srdf", "../config", "..")
"""Folders of SRDFs relative to the URDF's folder, in order of search."""
_MOVEIT = ("*_moveit_config/config", "../*_moveit_config/config", "../../*_moveit_config/config")
_MAX_FILES = 200
"""Maximum number of files per folder [-]."""


@dataclass(frozen=True)
class Group:
    """A joint group, such as an arm."""

    joints: tuple[str, ...]
    chains: tuple[tuple[str, str], ...]
    """First and last links of chains whose joints belong to the group."""

    def members(self, model: Articulated) -> set[str]:
        """Return the movable joints of a robot that belong to the group."""
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
    """Content of an SRDF; empty without a file."""

    path: Path | None = None
    disabled: frozenset[frozenset[str]] = frozenset()
    """Pairs of links whose contact is never checked."""
    reasons: Mapping[tuple[str, str], str] = field(default_factory=dict)
    """Reason by pair."""
    hands: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Links of each hand, by the link that carries it."""
    states: tuple[Mapping[str, float], ...] = ()
    """Named joint states [rad] or [m]."""
    groups: Mapping[str, Group] = field(default_factory=dict)
    """Joint groups by name."""


def read_srdf(path: Path) -> frozenset[frozenset[str]]:
    """Return the link pairs that an SRDF disables; empty if the file is missing."""
    return _open(path).disabled if _exists(path) else frozenset()


def claimed_apart(path: Path) -> frozenset[frozenset[str]]:
    """Return the link pairs that an SRDF says never touch; empty if the file is missing."""
    return claims(_open(path).reasons) if _exists(path) else frozenset()


def claims(reasons: Mapping[tuple[str, str], str]) -> frozenset[frozenset[str]]:
    """Return the pairs that are said never to touch."""
    return frozenset(frozenset(pair) for pair, why in reasons.items() if why == NEVER)


def srdf_next_to(urdf: Path) -> Path | None:
    """Return the SRDF next to a URDF with the same name, which every command reads, or None."""
    path = urdf.with_suffix(".srdf")
    return path if path.is_file() else None


def find_srdf(urdf: Path, robot: str) -> Srdf:
    """Find the SRDF of a URDF by its file name or its robot's name, in the usual folders.

    Args:
        urdf: The URDF.
        robot: Name of the robot in the URDF.
    """
    here = resolved(urdf).parent
    folders = [here / folder for folder in _FOLDERS]
    folders += [f for pattern in _MOVEIT for f in sorted((here / "..").glob(pattern))]
    files = [file for folder in folders for file in sorted(folder.glob("*.srdf"))[:_MAX_FILES]]
    named = [file for file in files if file.stem == urdf.stem]
    for file in dict.fromkeys(resolved(path) for path in [*named, *files]):
        try:
            found = _open(file, robot=None if file.stem == urdf.stem else robot)
        except MomaposError:
            if file.stem == urdf.stem:
                raise
            continue  # a damaged file of another robot
        if found.path is not None:
            return found
    return Srdf()


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError as error:  # too long, or a cycle of links
        raise RobotError(f"{path}: is not a valid path ({error.strerror})") from error


def _open(path: Path, robot: str | None = None) -> Srdf:
    """Read an SRDF; return an empty record if it belongs to another robot."""
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
    """Return the links of the end effectors, by their parent link."""
    links = {
        group.get("name"): tuple(e.get("name", "") for e in group.iter("link"))
        for group in root.iter("group")
    }
    return {
        effector.get("parent_link", ""): links.get(effector.get("group"), ())
        for effector in root.iter("end_effector")
    }


def _state(element: Element) -> dict[str, float]:
    """Return the values of single-axis joints in a named state."""
    values = {}
    for joint in element.iter("joint"):
        try:
            values[joint.get("name", "")] = float(joint.get("value", ""))
        except ValueError:
            continue
    return values


def srdf_text(name: str, pairs: Mapping[tuple[str, str], str]) -> str:
    """Return an SRDF that disables pairs of links, each with its reason."""
    from xml.sax.saxutils import quoteattr

    lines = disable_lines(pairs)
    return "\n".join([f"<robot name={quoteattr(name)}>", *lines, "</robot>", ""])


def disable_lines(pairs: Mapping[tuple[str, str], str]) -> list[str]:
    """Return the SRDF lines that disable pairs of links, each with its reason."""
    from xml.sax.saxutils import quoteattr

    return [
        f"  <disable_collisions link1={quoteattr(a)} link2={quoteattr(b)} reason={quoteattr(why)}/>"
        for (a, b), why in pairs.items()
    ]
