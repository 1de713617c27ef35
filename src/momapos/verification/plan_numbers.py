"""Check the numbers of a plan before it is used, without collision geometry."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np

from momapos.core import FileFormatError
from momapos.model.records import Motion, PlacementPlan
from momapos.model.robots import Robot
from momapos.model.scene import Scene, with_assumptions, with_overrides

from . import path_checks as paths
from .base_path_checks import base_path_checks, known_base_checks
from .exact_check import PlanVerifier
from .latch_checks import known_latch_checks, latch_checks
from .report import Check, at_most
from .robot_claims import rest_checks, stated_checks
from .scene_claims import scene_checks
from .time_checks import time_checks


def check_plan_numbers(plan: PlacementPlan, scene: Scene, robot: Robot, name: str) -> None:
    """Refuse a plan whose numbers `verify` rejects: what would use it cannot rely on them.

    What the plan states about robot and scene is compared with their files. Joint values and their
    limits, tool poses, base path and times are checked; bodies and loads are not, because a plan
    that collides can be shown and simulated.

    Args:
        plan: A plan with a motion.
        scene: The scene as it was planned in.
        robot: The robot.
        name: The plan's file, for the message.

    Raises:
        FileFormatError: It names the first failed check, its value and its limit.
    """
    verifier = PlanVerifier(with_assumptions(scene, plan), robot, plan.task)
    stated = (
        *rest_checks(plan.robot_rest, robot.model, plan.joints, verifier.limits),
        *stated_checks(plan, robot),
        *scene_checks(plan, with_overrides(scene, plan)),
    )
    failed = next((c for c in chain(stated, _checks(verifier, plan)) if not c.ok), None)
    if failed is None:
        return
    number = f": {failed.value:.4g} {failed.unit}, limit {failed.limit:g}" if failed.unit else ""
    detail = f" ({failed.detail})" if failed.detail else ""
    raise FileFormatError(f"{name}: not a usable plan: {failed.name}{number}{detail}")


def _checks(verifier: PlanVerifier, plan: PlacementPlan) -> Iterator[Check]:
    """Yield the checks; each relies on those before it."""
    motion, base, limits = plan.motion, plan.base_pose, verifier.limits
    assert motion is not None
    assert base is not None
    yield from paths.number_checks(verifier.part, motion, base)
    yield from known_latch_checks(verifier.part, motion)
    yield from known_base_checks(base, motion, plan.robot_drive)
    yield from paths.hold_checks(verifier.part, motion)
    yield from paths.verb_checks(verifier.part, plan.task.verb)
    yield from joint_number_checks(verifier, motion)
    states = paths.count_states(motion, limits.step)
    yield at_most("states to check", states, limits.states)
    bases = base if motion.base is None else motion.base
    Ts_tool, _, _ = verifier.robot_model.poses(verifier.robot_model.body_poses(bases, motion.q))
    yield from paths.tool_checks(Ts_tool, motion, limits)
    if plan.start is not None and plan.base_path is not None:
        yield from base_path_checks(plan.base_path, np.array([plan.start, base]), limits)


def joint_number_checks(verifier: PlanVerifier, motion: Motion) -> Iterator[Check]:
    """Check the values of all joints, and the times at which they are reached."""
    robot, part, limits = verifier.robot_model, verifier.part, verifier.limits
    yield from paths.object_checks(part, motion, limits)
    yield from latch_checks(part, motion, limits)
    yield from paths.joint_checks(robot, motion, limits)
    yield from paths.home_checks(motion, limits)
    yield from time_checks(robot, motion, limits)
