"""Evaluate the front network on unseen faces: doors, drawers and handles.

    PYTHONPATH=. python benchmarks/parts.py [--drawn 100] [--variants 3] [--pictures DIR]
                                            [--set development|test] [--walls 250]

Four sets: newly drawn faces, ordinary and hard; rendered simulator objects, optionally of one set
(`objects.py`); and real photos. Only sums are printed for the test set. With --walls there are two
sets instead: drawn low cabinets, and wall cabinets with many lifted doors, each evaluated with and
without knowledge of the height. A part is located if a predicted part of any kind overlaps it with
an IoU of 0.5; a handle, if the center of the predicted one lies within it.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from PIL import Image, ImageDraw
from training.fronts import cabinets, generator

from momapos.apps.bench.articulated import SETS
from momapos.model.records import FaceImage, Front
from momapos.perception.reconstruction import FrontNetwork, weighted_by_height
from momapos.perception.reconstruction.decode import overlaps
from momapos.perception.reconstruction.usual_kinds import EYE_HEIGHT
from parts_real import TrueFace, TruePart, photo_faces, real_faces
from placement import shared as default_shared

MAX_HUNG_HEIGHT = 1.05
"""Lower cabinets may hang on a wall [m]."""
LIFTED = generator.Mix({cabinets.hung: 1.0}, bare=generator.LAST.bare)
"""Wall cabinets only."""
COLORS = {
    "door_left": "red",
    "door_right": "lime",
    "door_down": "cyan",
    "door_up": "magenta",
    "drawer": "yellow",
}


@dataclass
class Tally:
    """Counts over some faces."""

    parts: int = 0
    located: int = 0
    found: int = 0
    kinds: int = 0
    hinges: int = 0
    doors: int = 0
    handles: int = 0
    held: int = 0
    faces: int = 0
    seconds: list[float] = field(default_factory=list)
    wrong: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Number of parts of the first kind that are classified as the second."""

    def row(self, name: str) -> str:
        """Return one line of the table."""
        return (
            f"| {name} | {self.faces} | {_share(self.located, self.parts)} "
            f"| {_share(self.located, self.found)} | {_share(self.kinds, self.located)} "
            f"| {_share(self.hinges, self.doors)} | {_share(self.held, self.handles)} |"
        )


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.2f} ({part}/{whole})" if whole else "-"


def matches(true: TrueFace, front: Front) -> list[tuple[int, int]]:
    """Return pairs of overlapping true and predicted parts, the best first."""
    if not true.parts or not front.parts:
        return []
    common = overlaps(
        np.array([p.box for p in true.parts]), np.array([p.box for p in front.parts])
    )[0]
    pairs = []
    while common.max() >= 0.5:
        i, j = np.unravel_index(int(common.argmax()), common.shape)
        pairs.append((int(i), int(j)))
        common[i], common[:, j] = -1, -1
    return pairs


def count(true: TrueFace, front: Front, tallies: Iterable[Tally]) -> None:
    """Add one face to tallies."""
    pairs = matches(true, front)
    for tally in tallies:
        tally.faces += 1
        tally.parts += len(true.parts)
        tally.found += len(front.parts)
        tally.located += len(pairs)
        tally.handles += sum(bool(p.handles) for p in true.parts)
        for i, j in pairs:
            part, predicted = true.parts[i], front.parts[j]
            tally.kinds += part.kind == predicted.kind
            tally.wrong[str(part.kind), predicted.kind] += part.kind != predicted.kind
            if part.kind in ("door_left", "door_right"):
                tally.doors += 1
                tally.hinges += part.kind == predicted.kind
            tally.held += predicted.handle is not None and _within(predicted.handle, part)


def _within(handle: tuple[float, float, float, float], part: TruePart) -> bool:
    x, y = (handle[0] + handle[2]) / 2, (handle[1] + handle[3]) / 2
    return any(h[0] <= x <= h[2] and h[1] <= y <= h[3] for h in part.handles)


def drawn_faces(number: int, seed: int, mix: generator.Mix) -> Iterator[TrueFace]:
    """Yield faces of the generator that training did not use."""
    return itertools.islice(_drawn(seed, mix), number)


def wall_faces(number: int, seed: int) -> Iterator[TrueFace]:
    """Yield drawn cabinets that may hang: low, with doors and flaps only."""

    def hangs(true: TrueFace) -> bool:
        kinds = {part.kind for part in true.parts}
        low = true.name == "cabinet" and true.face.height < MAX_HUNG_HEIGHT
        return low and bool(kinds) and "drawer" not in kinds

    return itertools.islice(filter(hangs, _drawn(seed, generator.ORDINARY)), number)


def _drawn(seed: int, mix: generator.Mix) -> Iterator[TrueFace]:
    for i in itertools.count():
        drawn = generator.draw(np.random.default_rng([seed, i]), mix)
        parts = tuple(TruePart(p.kind, p.box, (p.handle,) if p.handle else ()) for p in drawn.parts)
        yield TrueFace(drawn.family, drawn.face, parts)


def comparison(true: TrueFace, front: Front, side: int = 320) -> Image.Image:
    """Return an image of a face with its true (left) and predicted parts (right)."""
    sheet = Image.new("RGB", (2 * side + 4, side))
    image = Image.fromarray(true.face.color).resize((side, side))
    right = image.copy()
    for canvas, parts in ((image, true.parts), (right, front.parts)):
        pen = ImageDraw.Draw(canvas)
        for part in parts:
            pen.rectangle([v * side for v in part.box], outline=COLORS[part.kind or "drawer"])
            grips = part.handles if isinstance(part, TruePart) else (part.handle,)
            for grip in grips:
                if grip is not None:
                    pen.rectangle([v * side for v in grip], outline="orange", width=2)
    sheet.paste(image, (0, 0))
    sheet.paste(right, (side + 4, 0))
    ImageDraw.Draw(sheet).text((side + 8, 4), f"{true.name} front {front.score:.2f}", fill="blue")
    return sheet


def evaluate(
    name: str,
    faces: Iterable[TrueFace],
    network: Callable[[FaceImage, str], Front],
    out: Path | None,
    *,
    sums: bool = False,
) -> None:
    """Print a table of one set, or its sums only."""
    tallies: defaultdict[str, Tally] = defaultdict(Tally)
    whole = Tally()
    right = [0, 0, 0, 0]
    for i, true in enumerate(faces):
        began = time.perf_counter()
        front = network(true.face, true.name)
        whole.seconds.append(time.perf_counter() - began)
        count(true, front, (whole, tallies[true.name.split("/")[0]]))
        real = bool(true.parts)
        right[2 * real] += 1
        right[2 * real + 1] += (front.score > 0.5) == real
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            comparison(true, front).save(out / f"{name}_{i:03d}.png")
    print(f"\n| {name} | faces | located | precision | kind | hinge side | handles |")
    print("|---|---|---|---|---|---|---|")
    for key in () if sums else sorted(tallies):
        print(tallies[key].row(key))
    print(whole.row("all"))
    for (kind, predicted), times in () if sums else (+whole.wrong).most_common():
        print(f"{times} {kind} classified as {predicted}")
    print(
        f"fronts recognized: {_share(right[3], right[2])}, "
        f"others recognized: {_share(right[1], right[0])}; "
        f"{1000 * float(np.median(whole.seconds)):.0f} ms a face, "
        f"slowest {1000 * max(whole.seconds):.0f} ms"
    )


def main(
    shared: Path | None = None,
    drawn: int = 100,
    variants: int = 3,
    seed: int = 90001,
    pictures: Path | None = None,
    subset: Annotated[Literal["development", "test"] | None, tyro.conf.arg(name="set")] = None,
    walls: int = 0,
) -> None:
    """Print a table of each set.

    Args:
        shared: Folder of the real data, by default that of MOMAPOS_SHARED; its sets are skipped
            if it is missing.
        drawn: Number of newly drawn faces of each of the two mixes.
        variants: Number of renderings of each real object.
        seed: Seed of drawn faces, light, view and noise; training used others.
        pictures: Folder for an image of each face.
        subset: Only the real objects of one set, see `objects.py`.
        walls: Number of drawn cabinets that may hang; they replace all other sets.
    """
    network = FrontNetwork()

    def hung(face: FaceImage, label: str) -> Front:
        front = network(face, label)
        return replace(front, parts=weighted_by_height(front.parts, face, EYE_HEIGHT))

    if walls:
        for name, more in (
            ("wall cabinets", wall_faces(walls, seed)),
            ("wall cabinets, many lifted", drawn_faces(walls, seed, LIFTED)),
        ):
            faces = list(more)
            evaluate(name, faces, network, pictures)
            evaluate(f"{name}, height known", faces, hung, None)
        return
    evaluate("drawn", drawn_faces(drawn, seed, generator.ORDINARY), network, pictures)
    evaluate("drawn, hard", drawn_faces(drawn, seed + 1, generator.HARD), network, pictures)
    data = default_shared() if shared is None else shared
    if not (data / "bestman").is_dir():
        print(f"\nno simulator objects and no photos: {data / 'bestman'} does not exist")
        return
    objects, sums = real_faces(data, variants, seed, subset), subset == SETS[1]
    kept = None if sums else pictures
    evaluate("simulator objects", objects, network, kept, sums=sums)
    evaluate("photos", photo_faces(data), network, pictures)


if __name__ == "__main__":
    tyro.cli(main)
