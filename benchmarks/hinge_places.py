"""How many axes one constant can put right: an oracle that knows each leaf, but not its hinge.

    python benchmarks/hinge_places.py

Where a hinge lies is not to be seen while its door is shut. Here the leaf of every door and flap of
`objects.py` is known as it is: its kind, its side, its edges and its front. Its axis is put so far
behind that front as one constant says, and so far inside of that edge as is best for the tuned
half; then what lies within 2 cm of the true axis is counted, as `scan_objects.py` does, drawers as
right. No scan that puts all hinges at one depth does better but by luck. Of either half the most
that any constants reach is told, too.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from momapos.core.geometry.transforms import apply
from momapos.model.scene.scene import Scene
from momapos.model.urdf.joint_opening import opening_of
from objects import HALVES, half_of, objects, parts, room
from scan_parts import AXIS, Way, way_of

FACING = 0.9
"""What looks this much toward the viewer is front [-]."""
BEHIND = np.arange(-0.02, 0.1, 0.001)
INSIDE = np.arange(-0.02, 0.1, 0.001)
"""Constants that are tried: of the axis behind the front, and inside of the edge [m]."""
SHOWN = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03)
"""Depths that are counted [m]."""
TIGHT = 0.014
"""So near an axis holds for a quarter turn with a margin of 2 cm [m]."""


@dataclass(frozen=True)
class Hinge:
    """A moving part with its true hinge."""

    half: str
    drawer: bool
    behind: float = 0.0
    """Its axis behind the front of its leaf [m]."""
    inside: float = 0.0
    """And inside of the leaf's edge [m]."""


def front_of(truth: Scene, joint: str) -> float:
    """Where the front of a part lies, toward -x [m]: the median of what looks that way, by area."""
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
    half = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)
    return float(depth[order][half])


def hinge_of(truth: Scene, joint: str, way: Way, half: str) -> Hinge:
    """Where the axis of a part lies on its leaf."""
    if way.kind == "drawer":
        return Hinge(half, drawer=True)
    across = 1 if way.kind == "door" else 2
    edges = np.array([way.low[across], way.high[across]])
    inside = np.array([1.0, -1.0]) * (way.point[across] - edges)
    nearest = int(np.abs(inside).argmin())
    behind = float(way.point[0] - front_of(truth, joint))
    return Hinge(half, drawer=False, behind=behind, inside=float(inside[nearest]))


def right(hinges: list[Hinge], behind: float, inside: float, near: float = AXIS) -> int:
    """How many axes are right with these constants."""
    return sum(
        hinge.drawer or float(np.hypot(hinge.behind - behind, hinge.inside - inside)) < near
        for hinge in hinges
    )


def best(hinges: list[Hinge]) -> tuple[int, float, float]:
    """The most axes that two constants put right, and these constants [m]."""
    return max((right(hinges, b, i), float(b), float(i)) for b in BEHIND for i in INSIDE)


def main() -> None:
    """Run it."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    hinges = []
    for name, file, usual in objects():
        truth = room(name, file, usual)
        if truth is None:
            continue
        item = truth.object("object")
        for joint in parts(item.model):
            way = way_of(item, joint.name, np.eye(4))
            hinges.append(hinge_of(truth, joint.name, way, half_of(name)))
    halves = {half: [hinge for hinge in hinges if hinge.half == half] for half in HALVES}
    _, _, inside = best(halves[HALVES[0]])
    names = [f"{half}, within {100 * near:.1f} cm" for half in HALVES for near in (AXIS, TIGHT)]
    print(f"| axis behind the front | {' | '.join(names)} |", "|---" * 5 + "|", sep="\n")
    for behind in SHOWN:
        counts = [right(halves[half], behind, inside, n) for half in HALVES for n in (AXIS, TIGHT)]
        print(f"| {100 * behind:.1f} cm | {' | '.join(map(str, counts))} |")
    for half, mine in halves.items():
        most, behind, own = best(mine)
        print(
            f"{half}: {len(mine)} parts, {sum(hinge.drawer for hinge in mine)} of them drawers; at "
            f"most {most} right, {100 * behind:.1f} cm behind and {100 * own:.1f} cm inside"
        )


if __name__ == "__main__":
    main()
