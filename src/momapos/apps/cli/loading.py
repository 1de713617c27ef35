"""What commands that answer begin with: the room with its joints set, the arms with their maps."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from momapos.core import Cache
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.planning.reachability import ArmLength, ReachMap


def tell(warnings: Iterable[str]) -> None:
    """Print warnings, a line each, where they do not disturb the answer."""
    for warning in warnings:
        print(f"momapos: {warning}", file=sys.stderr)


def load_room(name: str, joints: Sequence[str], cache: Cache) -> Scene:
    """Load a scene, set its joints as --joint says, and tell its warnings.

    Args:
        name: A scene file or the name of a built-in kitchen.
        joints: As OBJECT/JOINT=VALUE.
        cache: Where its models are kept.

    Raises:
        MomaposError: The scene cannot be used, or has no such joint.
    """
    from momapos.model.scene import load_scene, set_joints

    scene = set_joints(load_scene(name, cache=cache), joints)
    tell(scene.warnings)
    return scene


def load_arms_with_maps(
    robot: str, arm: str, cache: Cache
) -> tuple[tuple[Robot, ...], list[ReachMap | ArmLength]]:
    """Load the arms of a robot that are asked for, and their maps, built where there are none.

    Args:
        robot: A library robot or a robot file.
        arm: The name of an arm, or any.
        cache: Where models and maps are kept.

    Raises:
        RobotError: The robot cannot be used.
    """
    from momapos.model.robots import load_arms
    from momapos.planning.reachability import load_reach

    from .console import progress

    arms = load_arms(robot, arm, cache=cache)
    maps = []
    for one in arms:
        with progress(f"reachability map of {one.title}") as report:
            maps.append(load_reach(one, cache.folder, report))
    return arms, maps
