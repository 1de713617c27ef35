"""Test a robot before its file is used: at rest, and on a drawer of a built-in kitchen."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np

from momapos.core import USER_CACHE, Cache, MomaposError, contact_text
from momapos.model.records import PlacementPlan
from momapos.model.robots import (
    MAX_OPENING_ERROR,
    Grip,
    Robot,
    RobotTest,
    drawn_model,
    examine_at_rest,
    examine_drawn,
    widest_stroke,
)
from momapos.model.scene import Scene, load_scene
from momapos.model.urdf import Articulated
from momapos.planning import PipelineConfig, PlacementQuery, plan_base_placement
from momapos.planning.grasps import make_task
from momapos.planning.reachability import by_arm_length
from momapos.verification import Limits, crossing_links, depth_between, self_contacts

SCENE = "kitchen_small"
DRAWERS = (
    ("cabinet_right", "drawer_top_slide", None),
    ("cabinet_left", "drawer_slide", None),
    ("cabinet_right", "drawer_top_slide", 0.2),
)
"""Drawers that are tried, with the value [m], None for 40 cm, which arms with fewer than six joints
may not reach. Their handles are at 0.77 and 0.74 m."""
TIMEOUT, TIMEOUT_OF_ALL = 3.0, 6.0
"""Processor time for the search of one drawer, and of the drawers by all arms [s]. Each arm has the
same share, but at least what one drawer has; a library arm needs 0.3 to 0.6 s for all."""
THIN = 0.004
"""Edges of the box between the fingers along and across the approach [m]."""
NAME = "drawer"


def self_test(arms: Sequence[Robot], *, cache: Cache | None = USER_CACHE) -> tuple[RobotTest, ...]:
    """Test every arm of a robot: in contact with itself, at rest, and on a drawer.

    Contacts at home and between the fingers are those of the exact check. Home, opening, height
    and drive are tested with what is drawn, too, which the robot file is not derived from. Takes a
    few seconds.

    Args:
        arms: The robot, once for each arm.
        cache: Stores expensive geometry; None to always compute it.
    """
    tests: dict[tuple[str, str], RobotTest] = {}
    drawn = drawn_model(arms[0], cache=cache)
    for robot in arms:
        witness = _drawn(robot, drawn)
        for test in (*_at_home(robot), *_opened(robot), *witness, *examine_at_rest(robot)):
            tests.setdefault((test.arm, test.name), test)
    results = list(tests.values())
    failed = {test.arm for test in results if test.passed is False}
    scene = load_scene(SCENE, cache=cache)
    for robot in arms:
        if robot.arm in failed:
            words = "not tried, because of the failed test"
            results.append(RobotTest(NAME, robot.arm, None, words))
        else:
            results.append(_drawer(robot, scene, max(TIMEOUT, TIMEOUT_OF_ALL / len(arms))))
    return tuple(results)


def _at_home(robot: Robot) -> Iterator[RobotTest]:
    """Test home with the shapes of the exact check; nothing if it is free."""
    home = robot.chain.joint_values(robot.home[None])
    check = self_contacts(robot, home, lambda _: "home")
    if not check.ok:
        remedy = (
            f"change home in {robot.path.name}, or disable the pair in its SRDF if it touches by "
            "design"
        )
        yield RobotTest("home", robot.arm, False, check.detail, remedy)


STATES = 4
"""States in which drawn links that cross at home must be apart once, or they are drawn so [-]."""


def _drawn(robot: Robot, drawn: Articulated) -> Iterator[RobotTest]:
    """Test home, opening, height and drive with what the URDF draws."""
    home, chain = robot.home, robot.chain
    lower, upper = np.clip(chain.lower, -np.pi, np.pi), np.clip(chain.upper, -np.pi, np.pi)
    others = np.random.default_rng(0).uniform(lower, upper, (STATES, chain.size))
    pairs = crossing_links(robot, drawn, chain.joint_values(np.vstack([home, others])))
    if pairs:
        more = f" and {len(pairs) - 1} more pairs" if len(pairs) > 1 else ""
        words = f"{pairs[0][0]} and {pairs[0][1]}{more} cross as they are drawn"
        yield RobotTest("home", robot.arm, False, words, f"change home in {robot.path.name}")
    drawn = drawn.changed(held=robot.model.held)
    yield from _opened(robot, drawn)
    yield from examine_drawn(robot, drawn)


def _opened(robot: Robot, drawn: Articulated | None = None) -> Iterator[RobotTest]:
    """Test that a box of the opening fits between the fingers.

    Yields nothing if it does, with 1 cm to spare, and for hands that are not two sides.

    Args:
        robot: The robot.
        drawn: The robot as drawn; None for the shapes of the exact check.
    """
    stroke = widest_stroke(robot) if robot.grips is Grip.FINGERS else None
    width = robot.opening - MAX_OPENING_ERROR
    if stroke is None or width <= THIN:
        return
    T_tool_object = np.eye(4)
    across = np.cross(robot.approach_axis, robot.closing_axis)
    T_tool_object[:3, :3] = np.stack([robot.approach_axis, robot.closing_axis, across], -1)
    depth, link = min(
        depth_between(
            drawn or robot.model, robot.gripper_links, values, T_tool_object, robot.tool_link,
            (THIN, width, THIN), surfaces=drawn is not None,
        )
        for values in ({}, stroke.rest)
    )  # fmt: skip
    if depth > Limits().penetration:
        box = f"a box of {width:.3f} m, 1 cm less than opening,"
        as_drawn = "" if drawn is None else " as drawn"
        words = f"{contact_text(box, link, depth)} between the open fingers{as_drawn}"
        remedy = f"correct opening, closing_axis, tool_link or [rest] of {robot.path.name}"
        yield RobotTest("gripper", robot.arm, False, words, remedy)


def _drawer(robot: Robot, scene: Scene, most: float) -> RobotTest:
    """Return whether the arm opens one of the drawers within a time [s], or why it does not."""
    found: RobotTest | None = None
    begun = time.process_time()
    for name, joint, to in DRAWERS:
        left = most - (time.process_time() - begun)
        if found is not None and left <= 0.0:
            break
        task = make_task(scene, "open", name, joint, to)
        reach = by_arm_length(robot, "a self-test builds none")
        config = PipelineConfig(timeout=min(TIMEOUT, left))
        try:
            query = PlacementQuery.of(
                scene, robot, task, reach, config=config, clock=time.process_time
            )
            plan = plan_base_placement(query).plan
        except MomaposError as error:
            return RobotTest(NAME, robot.arm, False, str(error), f"see {robot.path.name}")
        if plan.feasible:
            return RobotTest(NAME, robot.arm, True, f"opens {SCENE} {name}/{joint}{_until(to)}")
        if found is None or found.passed is None:
            found = _unopened(robot, plan)
    assert found is not None
    return found


def _until(to: float | None) -> str:
    return "" if to is None else f" to {100 * to:.0f} cm"


def _unopened(robot: Robot, plan: PlacementPlan) -> RobotTest:
    what = f"{SCENE} {plan.task.object}/{plan.task.joint}"
    seen, miss = plan.candidates, plan.candidates.nearest
    most = max(seen.rejections, key=lambda why: seen.rejections[why], default="no base pose")
    reason = most if miss is None else miss.reason
    if plan.status == "timeout":
        words = f"{what}: no answer within {TIMEOUT:g} s; nearest: {reason}"
        return RobotTest(NAME, robot.arm, None, words)
    remedy = (
        "if the real robot opens it, check what this reason names: tool_link, approach_axis, "
        f"opening and home in {robot.path.name}; limits, masses and efforts in the URDF"
    )
    return RobotTest(NAME, robot.arm, False, f"does not open {what}: {reason}", remedy)
