"""Load what planning commands need: the scene with its joints set, the arms with their maps."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

from momapos.core import say

if TYPE_CHECKING:
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.planning.reachability import ArmLength, ReachMap


def print_warnings(warnings: Iterable[str]) -> None:
    """Print warnings on stderr, one per line."""
    for warning in warnings:
        say(f"momapos: {warning}", file=sys.stderr)


def load_scene_with_joints(name: str, joints: Sequence[str]) -> Scene:
    """Load a scene, set its joints and print its warnings.

    Args:
        name: A scene file or a built-in kitchen.
        joints: As OBJECT/JOINT=VALUE.

    Raises:
        MomaposError: The scene is unusable, or has no such joint.
    """
    from momapos.model.scene import load_scene, set_joints

    scene = set_joints(load_scene(name), joints)
    print_warnings(scene.warnings)
    return scene


def load_arms_with_maps(
    robot: str, arm: str
) -> tuple[tuple[Robot, ...], list[ReachMap | ArmLength]]:
    """Load arms of a robot and their reachability maps; build missing maps.

    Args:
        robot: A library robot or a robot file.
        arm: The name of an arm, or any.

    Raises:
        RobotError: The robot is unusable.
    """
    from momapos.model.robots import load_arms
    from momapos.planning.reachability import load_reach

    from .console import progress

    arms = load_arms(robot, arm)
    maps = []
    for one in arms:
        with progress(f"reachability map of {one.title}") as report:
            maps.append(load_reach(one, None, report))
    return arms, maps


def other_robots(
    robot: str,
) -> Iterator[tuple[str, Callable[[], tuple[Robot, ReachMap | ArmLength]]]]:
    """Yield the other robots of the library, with functions that load each and its map."""
    from momapos.model.robots import library_names, load_arms
    from momapos.planning.reachability import load_reach

    def load(name: str) -> tuple[Robot, ReachMap | ArmLength]:
        one = load_arms(name)[0]
        return one, load_reach(one)

    for name in library_names():
        if name != robot:
            yield name, partial(load, name)
