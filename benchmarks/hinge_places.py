"""Bound the number of hinge axes that a constant offset can place correctly.

    python benchmarks/hinge_places.py

The hinge of a closed door is not visible. An oracle knows the leaf of every door and flap of
`objects.py`: kind, side, edges and front. It places the axis at a constant depth behind the front,
and at the distance inside the edge that is best for the development set. Axes within 2 cm of the
true one are counted, as in `scan_objects.py`; drawers count as right. A scan that places all hinges
at one depth can exceed these counts only by chance. The maximum over all constants is also printed
for each set.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from momapos.apps.bench.articulated import SETS, parts, set_of
from momapos.core.geometry import apply
from momapos.model.scene import Scene
from momapos.model.urdf import opening_of
from objects import objects, room
from scan_parts import AXIS, Way, way_of

FACING = 0.9
"""Minimum cosine to the viewing direction of triangles of the front [-]."""
BEHIND = np.arange(-0.02, 0.1, 0.001)
INSIDE = np.arange(-0.02, 0.1, 0.001)
"""Tried constants: depth of the axis behind the front, and distance inside the edge [m]."""
SHOWN = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03)
"""Printed depths [m]."""
TIGHT = 0.014
"""Axis error that keeps a quarter turn within a margin of 2 cm [m]."""


@dataclass(frozen=True)
class Hinge:
    """A moving part with its true hinge."""

    subset: str
    drawer: bool
    behind: float = 0.0
    """Depth of its axis behind the front of its leaf [m]."""
    inside: float = 0.0
    """Distance of its axis inside the leaf's edge [m]."""


def front_of(truth: Scene, joint: str) -> float:
    """Return the x of a part's front [m]: the area-weighted median of triangles facing -x."""
    item = truth.object("object")
    closed = opening_of(item.model, joint).closed
    poses = item.link_poses({joint: closed})
    x, areas = [], []
    for link in item.model.moved_by(joint):
        for hull in item.model.hulls[link]:
            corners = apply(poses[link], hull.vertices)[hull.faces]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            area = np.linalg.norm(normal, axis=1)
            outward = np.einsum("ij,ij->i", normal, corners.mean(axis=1) - corners.mean((0, 1)))
            toward = np.abs(normal[:, 0]) > FACING * np.maximum(area, 1e-12)
            front = toward & (normal[:, 0] * np.sign(outward) < 0.0)
            x.append(corners[front].mean(axis=1)[:, 0])
            areas.append(area[front])
    depth, weight = np.concatenate(x), np.concatenate(areas)
    order = np.argsort(depth)
    median = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)
    return float(depth[order][median])


def hinge_of(truth: Scene, joint: str, true: Way, subset: str) -> Hinge:
    """Return the position of a part's axis on its leaf."""
    if true.kind == "drawer":
        return Hinge(subset, drawer=True)
    across = 1 if true.kind == "door" else 2
    edges = np.array([true.low[across], true.high[across]])
    inside = np.array([1.0, -1.0]) * (true.point[across] - edges)
    nearest = int(np.abs(inside).argmin())
    behind = float(true.point[0] - front_of(truth, joint))
    return Hinge(subset, drawer=False, behind=behind, inside=float(inside[nearest]))


def right(hinges: list[Hinge], behind: float, inside: float, near: float = AXIS) -> int:
    """Return how many axes are right with these constants."""
    return sum(
        hinge.drawer or float(np.hypot(hinge.behind - behind, hinge.inside - inside)) < near
        for hinge in hinges
    )


def best(hinges: list[Hinge]) -> tuple[int, float, float]:
    """Return the maximum number of axes that two constants place correctly, and these [m]."""
    return max((right(hinges, b, i), float(b), float(i)) for b in BEHIND for i in INSIDE)


def main() -> None:
    """Run the benchmark."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    hinges = []
    for name, file, usual in objects():
        truth = room(name, file, usual)
        if truth is None:
            continue
        item = truth.object("object")
        for joint in parts(item.model):
            true = way_of(item, joint.name, np.eye(4))
            hinges.append(hinge_of(truth, joint.name, true, set_of(name)))
    by_set = {name: [hinge for hinge in hinges if hinge.subset == name] for name in SETS}
    _, _, inside = best(by_set[SETS[0]])
    names = [f"{name}, within {100 * near:.1f} cm" for name in SETS for near in (AXIS, TIGHT)]
    print(f"| axis behind the front | {' | '.join(names)} |", "|---" * 5 + "|", sep="\n")
    for behind in SHOWN:
        counts = [right(by_set[name], behind, inside, n) for name in SETS for n in (AXIS, TIGHT)]
        print(f"| {100 * behind:.1f} cm | {' | '.join(map(str, counts))} |")
    for name, mine in by_set.items():
        most, behind, own = best(mine)
        print(
            f"{name}: {len(mine)} parts, {sum(hinge.drawer for hinge in mine)} of them drawers; at "
            f"most {most} right, {100 * behind:.1f} cm behind and {100 * own:.1f} cm inside"
        )


if __name__ == "__main__":
    main()
