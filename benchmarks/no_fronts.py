"""Count the doors and drawers that a scan finds on furniture without any.

    python benchmarks/no_fronts.py [--rooms 2] [--seed 0] [--frames 100]
                                   [--folder bench_out/no_fronts]

Every room holds ten objects without doors and drawers along two walls: blank boxes, side panels,
tables, benches, open shelves with books, screens, machines, columns, radiators and picture frames.
Every part that the scan finds is a false one. Seeds below 100 may be examined; the others are
counted once.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from momapos.core import MomaposError
from momapos.core.geometry import apply
from momapos.model.scene import Scene, SceneObject
from momapos.perception import default_tools
from momapos.perception.recordings import read_scan
from momapos.workflows import scan_to_scene
from rows import commands
from scan import scanned
from scan_objects import Place, kitchen

OBJECTS = 10
"""Objects in a room [-]."""
MARGIN = 0.05
"""Gap between an object and the wall [m]."""

Piece = tuple[str, Sequence[float], Sequence[float]]
"""Category, lower and upper corner [m]; the front is toward -x, the back at x = 0."""


def blank(rng: np.random.Generator) -> list[Piece]:
    """Return a box of the size of a cabinet, fridge, oven or microwave, some on a plinth."""
    sizes = ((0.6, 0.6, 0.9), (0.65, 0.7, 1.75), (0.6, 1.2, 0.85), (0.4, 0.5, 0.35))
    depth, width, height = np.array(sizes[rng.integers(4)]) * rng.uniform(0.85, 1.15, 3)
    low = float(rng.choice([0.0, 0.1]))
    word = str(rng.choice(["cabinet", "fridge", "crate", "counter"]))
    return [(word, (-depth, -width / 2, low), (0.0, width / 2, height))]


def panel(rng: np.random.Generator) -> list[Piece]:
    """Return the blank side of a cabinet row with a worktop that protrudes."""
    depth, width, height = rng.uniform(0.3, 0.7), rng.uniform(0.5, 1.0), rng.uniform(0.7, 0.95)
    over = rng.uniform(0.01, 0.04)
    return [
        ("cabinet", (-depth, -width / 2, 0.0), (0.0, width / 2, height)),
        (
            "counter",
            (-depth - over, -width / 2 - over, height),
            (0.0, width / 2 + over, height + 0.04),
        ),
    ]


def table(rng: np.random.Generator) -> list[Piece]:
    """Return a table with four legs and an apron."""
    depth, width, height = rng.uniform(0.6, 0.9), rng.uniform(0.8, 1.5), rng.uniform(0.7, 0.78)
    apron = rng.uniform(0.05, 0.15)
    legs: list[Piece] = [
        ("table", (x - 0.06, y, 0.0), (x, y + 0.06, height - 0.03))
        for x in (0.0, -depth + 0.06)
        for y in (-width / 2, width / 2 - 0.06)
    ]
    low, half = height - 0.03, width / 2
    top: Piece = ("table", (-depth - 0.02, -half - 0.02, low), (0.0, half + 0.02, height))
    board: Piece = (
        "table",
        (-depth + 0.01, -half + 0.06, low - apron),
        (-depth + 0.03, half - 0.06, low),
    )
    return [*legs, top, board]


def bench(rng: np.random.Generator) -> list[Piece]:
    """Return a sofa or a bench: a base, a back and two arms."""
    depth, width = rng.uniform(0.7, 0.9), rng.uniform(1.0, 1.8)
    arm = rng.uniform(0.1, 0.2)
    return [
        ("sofa", (-depth, -width / 2, 0.05), (0.0, width / 2, 0.42)),
        ("sofa", (-0.2, -width / 2, 0.42), (0.0, width / 2, 0.85)),
        ("sofa", (-depth, -width / 2 - arm, 0.0), (0.0, -width / 2, 0.6)),
        ("sofa", (-depth, width / 2, 0.0), (0.0, width / 2 + arm, 0.6)),
    ]


def books(rng: np.random.Generator) -> list[Piece]:
    """Return an open shelf with books of different sizes."""
    depth, width, height = rng.uniform(0.25, 0.4), rng.uniform(0.6, 1.1), rng.uniform(0.9, 1.9)
    side, levels = 0.02, int(rng.integers(2, 5))
    found: list[Piece] = [
        ("shelf", (-depth, y, 0.0), (0.0, y + side, height)) for y in (-width / 2, width / 2 - side)
    ]
    found.append(("shelf", (-0.01, -width / 2, 0.0), (0.0, width / 2, height)))
    boards = np.linspace(0.05, height - side, levels + 1)
    for z in boards:
        found.append(("shelf", (-depth, -width / 2, z), (0.0, width / 2, z + side)))
    for below, above in pairwise(boards):
        y = -width / 2 + side
        while y < width / 2 - 0.12:
            thick = rng.uniform(0.02, 0.06)
            tall = min(rng.uniform(0.18, 0.32), above - below - 0.05)
            front = -depth + rng.uniform(0.0, 0.05)
            if rng.random() < 0.85:
                z = below + side
                book = f"book{len(found) % 7}"
                found.append((book, (front, y, z), (-0.02, y + thick, z + tall)))
            y += thick + 0.001
    return found


def screen(rng: np.random.Generator) -> list[Piece]:
    """Return a screen with a frame on a low table."""
    width, height = rng.uniform(0.5, 1.1), rng.uniform(0.35, 0.65)
    top = rng.uniform(0.45, 0.75)
    return [
        ("table", (-0.45, -width / 2 - 0.1, top - 0.04), (0.0, width / 2 + 0.1, top)),
        ("table", (-0.4, -0.3, 0.0), (-0.1, 0.3, top - 0.04)),
        ("monitor", (-0.3, -0.15, top), (-0.1, 0.15, top + 0.06)),
        ("monitor", (-0.24, -width / 2, top + 0.06), (-0.18, width / 2, top + 0.06 + height)),
        ("image", (-0.243, -width / 2 + 0.03, top + 0.09), (-0.2, 0.0, top + 0.03 + height)),
        ("picture", (-0.243, 0.0, top + 0.09), (-0.2, width / 2 - 0.03, top + 0.03 + height)),
    ]


def machine(rng: np.random.Generator) -> list[Piece]:
    """Return a printer or coffee machine on a table: a body with a slot, a tray and buttons."""
    depth, width, height = rng.uniform(0.35, 0.5), rng.uniform(0.35, 0.6), rng.uniform(0.3, 0.5)
    top = rng.uniform(0.6, 0.9)
    slot = top + height * rng.uniform(0.3, 0.6)
    return [
        ("table", (-0.6, -0.5, top - 0.03), (0.0, 0.5, top)),
        ("table", (-0.55, -0.45, 0.0), (-0.5, -0.4, top - 0.03)),
        ("table", (-0.55, 0.4, 0.0), (-0.5, 0.45, top - 0.03)),
        ("machine", (-depth - 0.05, -width / 2, top), (-0.05, width / 2, slot)),
        ("slot", (-depth, -width / 2 + 0.02, slot), (-0.05, width / 2 - 0.02, slot + 0.05)),
        ("machine", (-depth - 0.05, -width / 2, slot + 0.05), (-0.05, width / 2, top + height)),
        (
            "button",
            (-depth - 0.06, width / 2 - 0.1, top + height - 0.06),
            (-depth, width / 2 - 0.04, top + height - 0.03),
        ),
    ]


def column(rng: np.random.Generator) -> list[Piece]:
    """Return a column or a short wall."""
    depth, width = rng.uniform(0.2, 0.5), rng.uniform(0.25, 0.9)
    return [("wall", (-depth, -width / 2, 0.0), (0.0, width / 2, rng.uniform(1.2, 2.2)))]


def radiator(rng: np.random.Generator) -> list[Piece]:
    """Return a radiator of vertical ribs."""
    width, height = rng.uniform(0.6, 1.2), rng.uniform(0.5, 0.8)
    edges = np.arange(-width / 2, width / 2, 0.06)
    return [("radiator", (-0.25, y, 0.1), (-0.05, y + 0.045, height)) for y in edges]


def frames(rng: np.random.Generator) -> list[Piece]:
    """Return a chest-high box with two picture frames leaning on its front."""
    width, height = rng.uniform(0.8, 1.3), rng.uniform(0.7, 1.1)
    found: list[Piece] = [("furniture", (-0.45, -width / 2, 0.0), (0.0, width / 2, height))]
    for y in (-width / 4, width / 4):
        half = rng.uniform(0.1, 0.18)
        found.append(("poster", (-0.46, y - half, 0.2), (-0.45, y + half, height - 0.15)))
    return found


MAKERS: tuple[Callable[[np.random.Generator], list[Piece]], ...] = (
    blank, books, panel, screen, table, blank, machine, bench, column, radiator, frames,
)  # fmt: skip
"""The families; blank boxes twice."""


def alone(kind: Callable[[np.random.Generator], list[Piece]], rng: np.random.Generator) -> Scene:
    """Return an object's own room, its front toward -x, as `object_kitchens.kitchen` expects."""
    items = []
    for k, (category, low, high) in enumerate(kind(rng)):
        size, middle = np.subtract(high, low), np.add(low, high) / 2
        name = "object" if k == 0 else f"piece_{k}"
        items.append(SceneObject.box(name, size, middle, category=category))
    items.append(SceneObject.box("wall", (0.1, 3.0, 2.6), (0.05 + MARGIN, 0.0, 1.3)))
    return Scene(kind.__name__, tuple(items))


def room(seed: int) -> Place:
    """Return a room with ten objects without parts."""
    rng = np.random.default_rng([seed, 49])
    order = rng.permutation(len(MAKERS))[:OBJECTS]
    return kitchen(
        f"no_fronts_{seed}", [(MAKERS[k].__name__, alone(MAKERS[k], rng)) for k in order]
    )


def nearest(place: Place, point: np.ndarray) -> str:
    """Return the family of the object whose front is nearest to a point of the room."""

    def away(pair: tuple[str, np.ndarray]) -> float:
        return float(np.linalg.norm(apply(pair[1], point[None])[0, :2]))

    return min(place.objects.values(), key=away)[0]


def main(
    rooms: int = 2, seed: int = 0, frames: int = 100, folder: Path = Path("bench_out/no_fronts")
) -> None:
    """Count false parts.

    Args:
        rooms: Number of rooms.
        seed: Seed of the first room.
        frames: Number of images of a scan.
        folder: Folder of the scans.
    """
    tools, false, seen = default_tools(), Counter[str](), 0
    for number in range(seed, seed + rooms):
        place = room(number)
        scan = scanned(place.scene, folder / place.name / "scan", frames, number)
        try:
            result = scan_to_scene(
                read_scan(scan), folder / place.name / "found" / "scene.json", tools
            )
        except MomaposError as error:
            print(f"{place.name}: {error}", file=sys.stderr)
            continue
        seen += len(place.objects)
        T = np.linalg.inv(result.T_scene_scan)
        for one in result.decisions:
            if one.parts:
                kind = nearest(place, apply(T, one.detection.box.center[None])[0])
                false[kind] += len(one.parts)
                kinds = ", ".join(f"{p.kind} {p.score:.2f}" for p in one.parts)
                print(f"{place.name}: {one.detection.name} on {kind}: {one.source} {kinds}")
    print(f"{sum(false.values())} false parts on {seen} objects: {dict(false)}")


if __name__ == "__main__":
    commands(__doc__, main)
