"""A room as a reader of another format hands it on, and the account of what became of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import unknown_name
from momapos.model.urdf import Urdf

if TYPE_CHECKING:
    from jaxtyping import Float, Int

DECIMALS = 6
"""Of the vertices of a mesh that is written [m]."""


@dataclass(frozen=True)
class Resistance:
    """How a joint resists, as the file says."""

    damping: float
    """[Nms/rad] or [Ns/m]"""
    friction: float
    """[Nm] or [N]"""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles."""

    vertices: Float[np.ndarray, "v 3"]
    """[m]"""
    faces: Int[np.ndarray, "f 3"]
    """Corners, from 0."""


@dataclass(frozen=True, eq=False)
class RoomObject:
    """One thing in a room of another format."""

    name: str
    T_world_object: Float[np.ndarray, "4 4"]
    urdf: Urdf
    """Its links and joints; the mesh of a shape is named by a key of the room's `meshes`."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """Values that are not at rest [rad] or [m]."""
    resistance: Mapping[str, Resistance] = field(default_factory=dict)
    extras: Mapping[str, Any] = field(default_factory=dict)
    """Members of its entry in a momapos scene that the format holds beside: a category, say."""


@dataclass(frozen=True)
class Report:
    """What was kept, approximated and dropped: how many of what."""

    kept: Counter[str] = field(default_factory=Counter)
    approximated: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    """What a reader must know beside."""

    def lines(self) -> list[str]:
        """The report as text, a line for each of its parts that holds something."""
        parts = (
            ("kept", self.kept), ("approximated", self.approximated), ("dropped", self.dropped)
        )  # fmt: skip
        lines = [
            f"{word}: {', '.join(f'{what} {count}' for what, count in found.items() if count)}"
            for word, found in parts
            if found.total()
        ]
        return [*lines, *(f"note: {text}" for text in self.notes)]

    def as_json(self) -> dict[str, Any]:
        """The report as plain values."""
        return {
            "kept": dict(self.kept),
            "approximated": dict(self.approximated),
            "dropped": dict(self.dropped),
            "notes": list(self.notes),
        }


@dataclass(frozen=True, eq=False)
class Room:
    """A room of another format."""

    name: str
    objects: tuple[RoomObject, ...]
    meshes: Mapping[Path, Mesh]
    report: Report
    extras: Mapping[str, Any] = field(default_factory=dict)
    """Members of a momapos scene that the format holds beside: `floor`, `start`, `areas`."""

    def without(self, names: Collection[str]) -> Room:
        """The room without some objects.

        Raises:
            UnknownNameError: There is no such object; the message offers the nearest.
        """
        known = [item.name for item in self.objects]
        for name in names:
            if name not in known:
                raise unknown_name("object", name, known, f"room {self.name}")
        if names:
            self.report.dropped["objects, as asked"] += len(set(names))
        return replace(self, objects=tuple(o for o in self.objects if o.name not in names))

    def told(self) -> Report:
        """The report, with what is in the room now as kept."""
        joints = [joint for item in self.objects for joint in item.urdf.joints if joint.movable]
        links = [link for item in self.objects for link in item.urdf.links.values()]
        slides = sum(joint.kind == "prismatic" for joint in joints)
        kept = Counter({
            "objects": len(self.objects),
            "hinges": len(joints) - slides,
            "slides": slides,
            "joints that follow others": sum(joint.mimic is not None for joint in joints),
            "solid shapes": sum(len(link.collisions) for link in links),
            "drawn shapes": sum(len(link.visuals) for link in links),
        })  # fmt: skip
        return replace(self.report, kept=kept + self.report.kept)


class Names:
    """Gives names that can stand in our files, no two alike."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    def __call__(self, wanted: str, otherwise: str) -> str:
        """A printable name without `/`, as near to the one that is wanted as can be."""
        text = "".join(c if c.isprintable() and c != "/" else "_" for c in wanted.strip())[:200]
        name = text = text or otherwise
        number = 1
        while name in self._used:
            number += 1
            name = f"{text}_{number}"
        self._used.add(name)
        return name
