"""Test a robot before its file is used: at rest, and on a drawer of a built-in kitchen."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

from momapos.core import USER_CACHE, Cache, MomaposError
from momapos.model.records import PlacementPlan
from momapos.model.robots import (
    Robot,
    RobotTest,
    examine_at_rest,
)
from momapos.model.scene import Scene, load_scene
from momapos.planning import PipelineConfig, PlacementQuery, plan_base_placement
from momapos.planning.grasps import make_task
from momapos.planning.reachability import by_arm_length
from momapos.verification import self_contacts

SCENE = "kitchen_small"
DRAWERS = (
    ("cabinet_right", "drawer_top_slide", None),
    ("cabinet_left", "drawer_slide", None),
    ("cabinet_right", "drawer_top_slide", 0.2),
)
"""Drawers that are tried, with the value [m], None for 40 cm, which arms with fewer than six joints
may not reach. Their handles are at 0.77 and 0.74 m."""
TIMEOUT = 3.0
"""Processor time for the search of one drawer [s]; a library arm needs 0.3 to 0.6 s for all."""
NAME = "drawer"


def self_test(arms: Sequence[Robot], *, cache: Cache | None = USER_CACHE) -> tuple[RobotTest, ...]:
    """Test every arm of a robot: in contact with itself, at rest, and on a drawer.

    Contacts at home are those of the exact check, whose shapes the robot file is not derived from.
    Takes a few seconds.

    Args:
        arms: The robot, once for each arm.
        cache: Stores expensive geometry; None to always compute it.
    """
    tests: dict[tuple[str, str], RobotTest] = {}
    for robot in arms:
        for test in (*_at_home(robot), *examine_at_rest(robot)):
            tests.setdefault((test.arm, test.name), test)
    results = list(tests.values())
    failed = {test.arm for test in results if test.passed is False}
    scene = load_scene(SCENE, cache=cache)
    for robot in arms:
        if robot.arm in failed:
            words = "not tried, because of the failed test"
            results.append(RobotTest(NAME, robot.arm, None, words))
        else:
            results.append(_drawer(robot, scene))
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


def _drawer(robot: Robot, scene: Scene) -> RobotTest:
    """Return whether the arm opens one of the drawers, or why it does not."""
    found: RobotTest | None = None
    for name, joint, to in DRAWERS:
        task = make_task(scene, "open", name, joint, to)
        reach = by_arm_length(robot, "a self-test builds none")
        config = PipelineConfig(timeout=TIMEOUT)
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
