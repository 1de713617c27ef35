"""Say what a verification takes from the files without being able to check it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from momapos.model.scene import Scene

from .exact_shapes import of_bodies, prepared
from .robot_collision_model import RobotDescription, robot_collision_model, self_pairs

MAX_NAMED = 6
"""Maximum number of names in a note [-]."""


def trust_notes(scene: Scene, robot: RobotDescription, srdf: Path | None) -> Iterator[str]:
    """Yield notes on disabled pairs, and on robots and objects without shapes.

    Args:
        scene: The scene of the plan.
        robot: The robot of the plan.
        srdf: The file that disables pairs of links, if there is one.
    """
    built = robot_collision_model(robot)
    bodies, shapes = prepared(robot.model)
    moving = set().union(*(bodies.moved_by(joint) for joint in built.joints))
    every = self_pairs(bodies, shapes, of_bodies(shapes, moving))
    names = {frozenset((shapes.names[i], shapes.names[j])) for i, j in every}
    trusted = sorted("-".join(sorted(pair)) for pair in names & robot.disabled)
    if trusted:
        checked = f"{len(trusted)} of {len(names)} pairs of links"
        source = "the robot file" if srdf is None else srdf
        yield (
            f"trusts {source}: it disables the self-collision check of {checked} "
            f"({_listed(trusted)})"
        )
    for what, count in (("arm and hand", len(built.arm)), ("base", len(built.base))):
        if not count:
            yield f"the {what} of the robot has no collision shapes: nothing of it is checked"
    empty = [item.name for item in scene.objects if not len(prepared(item.model)[1])]
    if empty:
        yield f"without collision shapes, so not checked: {_listed(empty)}"


def _listed(names: Sequence[str]) -> str:
    more = len(names) - MAX_NAMED
    shown = ", ".join(names[:MAX_NAMED])
    return f"{shown} and {more} more" if more > 0 else shown
