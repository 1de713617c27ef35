"""Hands that do not come fully open, for handles with little room around them.

A hand that is open to a width is the same robot with other rest values of its finger joints. Arm,
inverse kinematics and reachability map stay, and everything that reads a robot needs nothing new.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError, owner_cache
from momapos.model.collision import reposed
from momapos.model.kinematics import build_chain

from .fingers import narrower
from .fingertips import finger_links, opposed
from .robot import Grip, Robot

if TYPE_CHECKING:
    from jaxtyping import Float

_DIGITS = 6
"""Decimals of the values of finger joints in plans [-]."""
SAME_VALUE = 1e-4
"""Difference below which finger joints count as at the same value [rad] or [m]."""


@owner_cache()
def opened_to(robot: Robot, width: float) -> Robot | None:
    """Return a robot whose hand is open to a width; None if it cannot be.

    The fingers close from their widest gap, all joints together, until the gap of the tips is the
    width. Joints that follow others do so.

    Args:
        robot: The robot.
        width: Distance between the pads [m], less than the opening of the robot.
    """
    whole = robot.fully_open or robot
    names, states, gaps = _closing(whole)
    if not len(gaps) or not gaps[-1] <= width < min(float(gaps[0]), whole.opening):
        return None
    values = [np.interp(width, gaps[::-1], column[::-1]) for column in states.T]
    at = dict(zip(names, np.round(values, _DIGITS).tolist(), strict=True))
    return _resting(whole, at, width)


def opened_as(robot: Robot, rest: Mapping[str, float]) -> Robot:
    """Return a robot with its hand as open as a plan says.

    Args:
        robot: The robot as its file describes it.
        rest: Rest values of joints in the plan [rad] or [m]; joints that it does not name rest at
            zero.

    Raises:
        RobotError: The plan rests a joint beyond its limits.
    """
    _check_within(robot, rest)
    joints = {name: robot.model.joint(name) for name in _finger_joints(robot)}
    at = {n: float(np.clip(rest.get(n, 0.0), j.lower, j.upper)) for n, j in joints.items()}
    if not rest.keys() & at.keys() or all(
        abs(at[name] - robot.model.rest[name]) < SAME_VALUE for name in at
    ):
        return robot
    names, states, gaps = _closing(robot)
    if not len(gaps) or not at.keys() >= set(names):
        return robot
    # All joints close together, so the one with the largest travel tells where they are.
    k = int(np.ptp(states, axis=0).argmax())
    order = np.argsort(states[:, k])
    width = float(np.interp(at[names[k]], states[order, k], gaps[order]))
    width = round(width, 4)
    return _resting(robot, at, width) if width < robot.opening else robot


def _check_within(robot: Robot, rest: Mapping[str, float]) -> None:
    for name, value in rest.items():
        joint = robot.model.joints.get(name)
        if joint is not None and not joint.lower - SAME_VALUE <= value <= joint.upper + SAME_VALUE:
            raise RobotError(
                f"{robot.name}: {name} rests at {value:g} in the plan; its limits are "
                f"{joint.lower:g} to {joint.upper:g}"
            )


def _finger_joints(robot: Robot) -> tuple[str, ...]:
    """Return the joints that move fingers, but not the tool, and follow no other."""
    fingers, model = finger_links(robot), robot.model
    moved = {j.name: set(model.moved_by(j.name)) for j in model.joints.values() if not j.mimic}
    return tuple(
        n for n, links in moved.items() if links & fingers and robot.tool_link not in links
    )


@owner_cache()
def _closing(
    robot: Robot,
) -> tuple[tuple[str, ...], Float[np.ndarray, "m n"], Float[np.ndarray, " m"]]:
    """Return how the fingers close, see `narrower`; no states if the fingers are unknown."""
    unknown: tuple[tuple[str, ...], np.ndarray, np.ndarray] = ((), np.zeros((0, 0)), np.zeros(0))
    sides = opposed(robot, finger_links(robot)) if robot.grips is Grip.FINGERS else None
    if sides is None:
        return unknown
    axes = np.stack([robot.closing_axis, robot.approach_axis])
    return narrower(robot.model, robot.tool_link, sides, axes)


def _resting(whole: Robot, values: Mapping[str, float], width: float) -> Robot:
    """Return a robot with other rest values of its finger joints; it shares what stays the same."""
    model = whole.model.changed(held={**whole.model.held, **values})
    robot = replace(whole, model=model, opening=width, fully_open=whole)
    _, segments = build_chain(model, whole.base_link, whole.tool_link, whole.arm_joints)
    spheres = reposed(whole.spheres, model, whole.segments, segments)
    vars(robot).update(_parts=(whole.chain, segments), ik=whole.ik, spheres=spheres)
    return robot
