"""A room imported from another format, and the report on its conversion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import unknown_name
from momapos.model.urdf import Mesh, Urdf

if TYPE_CHECKING:
    from jaxtyping import Float

DECIMALS = 6
"""Decimals of the vertices of a written mesh [m]."""


@dataclass(frozen=True, eq=False)
class RoomObject:
    """An object of an imported room."""

    name: str
    T_world_object: Float[np.ndarray, "4 4"]
    urdf: Urdf
    """Its links and joints; mesh shapes name keys of the room's `meshes`."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """Values of joints that are not at rest [rad] or [m]."""
    extras: Mapping[str, Any] = field(default_factory=dict)
    """Further members of its entry in a momapos scene, such as the category."""


@dataclass(frozen=True)
class ImportReport:
    """Counts of what was kept, approximated and dropped in the conversion."""

    kept: Counter[str] = field(default_factory=Counter)
    approximated: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    """Further remarks."""

    def lines(self) -> list[str]:
        """Return the report as text, one line for each nonempty part."""
        parts = (
            ("kept", self.kept), ("approximated", self.approximated), ("dropped", self.dropped)
        )  # fmt: skip
        lines = [
            f"{word}: {', '.join(f'{count} {what}' for what, count in found.items() if count)}"
            for word, found in parts
            if found.total()
        ]
        return [*lines, *(f"note: {text}" for text in self.notes)]

    def as_json(self) -> dict[str, Any]:
        """Return the report as plain values."""
        return {
            "kept": dict(self.kept),
            "approximated": dict(self.approximated),
            "dropped": dict(self.dropped),
            "notes": list(self.notes),
        }


@dataclass(frozen=True, eq=False)
class ImportedRoom:
    """A room imported from another format."""

    name: str
    objects: tuple[RoomObject, ...]
    meshes: Mapping[Path, Mesh]
    report: ImportReport
    extras: Mapping[str, Any] = field(default_factory=dict)
    """Further members of a momapos scene: `floor`, `start`, `areas`."""

    def without(self, names: Collection[str]) -> ImportedRoom:
        """Return the room without some objects.

        Raises:
            UnknownNameError: An object does not exist; the message suggests similar names.
        """
        known = [item.name for item in self.objects]
        for name in names:
            if name not in known:
                raise unknown_name("object", name, known, f"room {self.name}")
        if names:
            self.report.dropped["objects, as requested"] += len(set(names))
        return replace(self, objects=tuple(o for o in self.objects if o.name not in names))

    def final_report(self) -> ImportReport:
        """Return the report, including the present content of the room as kept."""
        joints = [joint for item in self.objects for joint in item.urdf.joints if joint.movable]
        links = [link for item in self.objects for link in item.urdf.links.values()]
        slides = sum(joint.kind == "prismatic" for joint in joints)
        kept = Counter({
            "objects": len(self.objects),
            "hinges": len(joints) - slides,
            "slides": slides,
            "mimic joints": sum(joint.mimic is not None for joint in joints),
            "collision shapes": sum(len(link.collisions) for link in links),
            "visual shapes": sum(len(link.visuals) for link in links),
        })  # fmt: skip
        return replace(self.report, kept=kept + self.report.kept)


class Names:
    """Makes valid and unique names for our files."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    def __call__(self, wanted: str, otherwise: str) -> str:
        """Return a printable name without `/`, as similar to the wanted one as possible."""
        text = "".join(c if c.isprintable() and c != "/" else "_" for c in wanted.strip())[:200]
        name = text = text or otherwise
        number = 1
        while name in self._used:
            number += 1
            name = f"{text}_{number}"
        self._used.add(name)
        return name
