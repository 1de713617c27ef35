"""Links outside the chain of the arm that follow its joints, such as a head that follows the torso.

They move with no segment of the chain. For planning, their shapes are those of all their positions;
the exact check and the simulation move them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError
from momapos.core.geometry import apply, invert
from momapos.model.kinematics import Segments
from momapos.model.urdf import Articulated, Geometry, Hull, Joint, Mesh, hull_around

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_TURN = np.radians(5.0)
"""Turn between two positions whose common hull is taken; an arc leaves it by 0.1 % of its radius
[rad]."""
MAX_POSITIONS = 1_000
"""Largest number of positions of one link [-]."""


def with_swept_followers(model: Articulated, followers: Sequence[str]) -> Articulated:
    """Return a robot whose side followers have the shapes of all their positions.

    Args:
        model: The robot.
        followers: Mimic joints outside the chain, as in `Segments.side_followers`.

    Raises:
        RobotError: A leader has no limits, or a link has too many positions.
    """
    if not followers:
        return model
    joints = [model.joint(name) for name in followers]
    below = {joint.name: set(model.links_below(joint.child)) for joint in joints}
    links = dict(model.urdf.links)
    for joint in joints:
        if any(joint.parent in inside for inside in below.values()):
            continue  # the follower that carries it includes it
        runs = _runs(model, [one for one in joints if one.child in below[joint.name]])
        for link in below[joint.name]:
            shapes = [
                shape
                for hull in model.hulls[link]
                for shape in _swept(model, joint.parent, link, hull, runs)
            ]
            links[link] = replace(links[link], collisions=tuple(shapes))
    return Articulated(replace(model.urdf, links=links), model.held, model.cache, model.closed)


def never_touching(model: Articulated, segments: Segments) -> set[frozenset[str]]:
    """Return pairs of a side follower and a link that its leader moves, which never touch.

    Only the leader moves the two relative to each other, so that the shapes of all positions of
    the follower are too large for this pair: a head that rises half as far as a shoulder below it
    gives way to it.

    Args:
        model: The robot, not swept.
        segments: The segment with which each link moves, and the side followers.
    """
    found = set()
    for name in segments.side_followers:
        joint = model.joint(name)
        assert joint.mimic is not None
        leader = model.joint(joint.mimic.joint)
        if segments.of_link[joint.parent] != segments.of_link[leader.parent]:
            continue  # another joint of the arm lies between the two
        runs = _runs(model, [joint])
        first = segments.of_link[leader.child]
        partners = [link for link in model.links if segments.of_link[link] == first]
        # Links below a further follower move differently.
        others = [model.joint(other).child for other in segments.side_followers if other != name]
        below = set(model.links_below(joint.child)).difference(*map(model.links_below, others))
        found |= {
            frozenset((link, partner))
            for link, partner in product(sorted(below), partners)
            if _apart(model, link, partner, runs)
        }
    return found


def _apart(model: Articulated, link: str, partner: str, runs: list[list[dict[str, float]]]) -> bool:
    """Return whether a plane separates all hulls of two links over each group of values."""
    for states in runs:
        poses = [model.link_poses(values) for values in states]
        Ts = [invert(at[partner]) @ at[link] for at in poses]
        for hull, other in product(model.hulls[link], model.hulls[partner]):
            swept = np.concatenate([apply(T, hull.vertices) for T in Ts])
            if not _separable(swept, other.vertices):
                return False
    return True


def _separable(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "m 3"]) -> bool:
    """Return whether a plane lies between two sets of points (a linear program)."""
    from scipy.optimize import linprog

    rows = np.vstack([np.column_stack([a, -np.ones(len(a))]),
                      np.column_stack([-b, np.ones(len(b))])])  # fmt: skip
    found = linprog(np.zeros(4), rows, -np.ones(len(rows)), bounds=(None, None))
    return bool(found.status == 0)


def _runs(model: Articulated, followers: Sequence[Joint]) -> list[list[dict[str, float]]]:
    """Return groups of leaders' values; the hull of a body over a group holds it in between."""
    counts: dict[str, int] = {}
    for joint in followers:
        assert joint.mimic is not None
        leader = model.joint(joint.mimic.joint)
        travel = abs(joint.mimic.ratio) * (leader.upper - leader.lower)
        if not np.isfinite(travel):
            raise RobotError(
                f"{model.urdf.name}: joint {joint.name!r} follows {leader.name!r}, which has no "
                "limits, and does not carry the tool; give the leader limits"
            )
        count = 2 if joint.kind == "prismatic" else 2 + int(travel / MAX_TURN)
        counts[leader.name] = max(count, counts.get(leader.name, 0))
    if np.prod([float(count) for count in counts.values()]) > MAX_POSITIONS:
        raise RobotError(
            f"{model.urdf.name}: joint {followers[0].name!r} follows the arm over more than "
            f"{MAX_POSITIONS} positions, and does not carry the tool; give its leader limits"
        )
    ends = {name: (model.joint(name).lower, model.joint(name).upper) for name in counts}
    grid = product(*(np.linspace(*ends[name], count).tolist() for name, count in counts.items()))
    states = [dict(zip(counts, row, strict=True)) for row in grid]
    return [list(pair) for pair in pairwise(states)] if len(counts) == 1 else [states]


def _swept(
    model: Articulated, carrier: str, link: str, hull: Hull, runs: list[list[dict[str, float]]]
) -> list[Geometry]:
    """Return the hulls of a link's hull over each group of values, in the link's frame at rest."""
    T_link_carrier = invert(model.rest_poses[link]) @ model.rest_poses[carrier]
    shapes = []
    for states in runs:
        points = []
        for values in states:
            poses = model.link_poses(values)
            T = T_link_carrier @ invert(poses[carrier]) @ poses[link]
            points.append(apply(T, hull.vertices))
        around = hull_around(np.concatenate(points), hull.name)
        mesh = Mesh(around.vertices, around.faces)
        shapes.append(Geometry("mesh", (1.0, 1.0, 1.0), np.eye(4), hull.name, mesh))
    return shapes
