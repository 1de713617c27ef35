"""A hand holds a part only where its fingers close on it, or where it pushes or pulls it along."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
from door_case import (
    BASE,
    HANDLE,
    HINGE,
    JOINTS,
    MIDDLE,
    OPEN,
    Case,
    Grip,
    cupboard_urdf,
    make_case,
    tool_poses,
)
from tests import optional
from tests.real import CASES

from momapos.core.geometry.transforms import pose
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.scene.resistance_config import ResistanceConfig
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.motion_loads import CarriedLoad
from momapos.verification.path_checks import dense_path
from momapos.verification.plan_check import UrdfArm, verify_files
from momapos.verification.report import DEFAULT

PULL = "pull on the grasp"
OFF, INSIDE = "hand off the part that it holds", "open hand in the part"
Make: TypeAlias = Callable[[Grip], Case]
PALM = '<box size="0.08 0.06 0.06"/>'
LONG_PALM = '<box size="0.08 0.06 0.12"/>'
"""With its face 1 mm before the bar."""
HOOK = """<collision><origin xyz="0 0.03 0.15"/><geometry><box size="0.02 0.01 0.08"/></geometry>
</collision><collision><origin xyz="0 0.01 {z}"/><geometry><box size="0.02 0.05 0.008"/></geometry>
</collision>"""
BEHIND, BEFORE = 0.178, 0.142
"""Where the hook's tip is behind the bar, and before it, in the palm's frame [m]."""


def failed(case: Case, folder: Path) -> set[str]:
    return {check.name for check in verify_files(case.write(folder)).violations}


def hold(case: Case, family: str) -> Case:
    case.plan["manipulation"] |= {"holds": [[0, 40]], "families": [family]}
    return case


def without_fingers(case: Case) -> Case:
    """Fix the fingers where they touch nothing."""
    case.robot = case.robot.replace('type="prismatic"', 'type="fixed"')
    case.robot = case.robot.replace('size="0.02 0.01 0.06"', 'size="0.001 0.001 0.001"')
    return case


def palm_case(family: str, grip: Grip = MIDDLE) -> Case:
    """Return a case with a palm that touches the bar."""
    case = hold(without_fingers(make_case(grip=grip)), family)
    case.robot = case.robot.replace(PALM, LONG_PALM)
    return case


def hook_case(z: float = BEHIND, grip: Grip = MIDDLE) -> Case:
    """Return a case with a hook around the bar."""
    case = hold(without_fingers(make_case(grip=grip)), "hook")
    palm = f"<geometry>{PALM}</geometry></collision>"
    case.robot = case.robot.replace(palm, palm + HOOK.format(z=z))
    case.plan["approach"] = case.plan["approach"][-1:]  # it does not come straight to the bar
    return case


def closing(case: Case) -> Case:
    """Let the same motion backwards close the door."""
    held = case.plan["manipulation"]
    for key in ("q", "object_q", "T_world_tool"):
        held[key] = held[key][::-1]
    case.plan["approach"] = held["q"][:1]
    case.plan["task"] |= {"verb": "close", "to": 0.0}
    case.scene["objects"][0]["joints"]["hinge"] = OPEN
    return case


def pick_case(grip: Grip = MIDDLE) -> Case:
    """Return a case in which the hand picks a post that stands where the bar was."""
    case = make_case(grip=grip)
    case.cupboard = cupboard_urdf(handle=False)
    case.obstacle([0.02, 0.02, 0.12], (np.add(HINGE, HANDLE)).tolist())
    back = np.array([pose((0.0, 0.0, z)) for z in np.linspace(0.0, -0.1, 11)])
    q = case.plan["approach"][::-1]
    case.plan["task"] = {"verb": "pick", "object": "post"}
    case.plan["manipulation"] = {
        "q": q,
        "object_q": [0.0] * len(q),
        "T_world_tool": (tool_poses(np.zeros(1)) @ grip.T @ back).tolist(),
    }
    return case


HELD = [Grip((0.03, 0.0, 0.0)), Grip((0.0, 0.006, 0.0)), Grip((0.0, 0.0, -0.015)), Grip(roll=25.0)]
MISSED = [
    Grip((0.0, 0.0, -0.03)),
    Grip((0.0, 0.0, -0.05)),
    Grip((0.0, 0.0, -0.08)),
    Grip((0.08, 0.0, 0.0)),
    Grip((-0.08, 0.0, 0.0)),
    Grip((0.0, 0.014, 0.0)),
    Grip((0.0, -0.014, 0.0)),
    Grip((0.0, 0.05, 0.0)),
    Grip(roll=38.0),
    Grip(roll=-60.0),
]
"""Rolled beyond the friction cone, pads slip off the bar, also where they touch it while open."""
ACROSS = [Grip(roll=90.0), Grip(roll=-90.0)]


@pytest.mark.parametrize("make", [lambda g: make_case(grip=g), pick_case], ids=["door", "pick"])
@pytest.mark.parametrize("grip", HELD)
def test_fingers_hold_a_bar_between_them(make: Make, grip: Grip, tmp_path: Path) -> None:
    assert not failed(make(grip), tmp_path)


@pytest.mark.parametrize("make", [lambda g: make_case(grip=g), pick_case], ids=["door", "pick"])
@pytest.mark.parametrize("grip", MISSED)
def test_fingers_next_to_a_bar_do_not_hold_it(make: Make, grip: Grip, tmp_path: Path) -> None:
    assert OFF in failed(make(grip), tmp_path)


@pytest.mark.parametrize("make", [lambda g: make_case(grip=g), pick_case], ids=["door", "pick"])
@pytest.mark.parametrize("grip", ACROSS)
def test_fingers_across_a_bar_are_inside_it(make: Make, grip: Grip, tmp_path: Path) -> None:
    assert INSIDE in failed(make(grip), tmp_path)


@pytest.mark.parametrize("family", ["push", "suction"])
def test_fingers_around_a_bar_are_no_other_grasp(family: str, tmp_path: Path) -> None:
    assert failed(hold(make_case(), family), tmp_path) == {OFF}


def test_a_finger_that_cannot_close_holds_nothing(tmp_path: Path) -> None:
    case = make_case()
    case.robot = case.robot.replace('upper="0.03"', 'upper="0.015"')
    assert failed(case, tmp_path) == {OFF}


def test_a_finger_closes_on_a_fixed_jaw(tmp_path: Path) -> None:
    """The open jaw is 2 cm from the bar, the fixed one is moved next to it."""
    for y, fails in ((-0.02, set()), (-0.035, {OFF})):
        case = make_case()
        fixed = case.robot.index('<joint name="right_slide"')
        before, after = case.robot[:fixed], case.robot[fixed:]
        after = after.replace('type="prismatic"', 'type="fixed"', 1)
        before = before.replace("0 -0.035 0.025", f"0 {y} 0.025")
        case.robot = before + after
        assert failed(case, tmp_path / str(y)) == fails


def test_a_hook_pulls_from_behind(tmp_path: Path) -> None:
    assert not failed(hook_case(), tmp_path / "behind")
    assert failed(closing(hook_case()), tmp_path / "closes") == {OFF}
    assert failed(hook_case(BEFORE), tmp_path / "before") == {OFF}
    for k, grip in enumerate((Grip((0.08, 0.0, 0.0)), Grip((0.0, 0.05, 0.0)))):
        assert failed(hook_case(grip=grip), tmp_path / str(k)) == {OFF}


def test_a_hand_whose_fingers_miss_the_part_pushes_it_and_does_not_hook_it(tmp_path: Path) -> None:
    for family, fails in (("push", set()), ("hook", {OFF})):
        case = hold(make_case(), family)
        case.robot = case.robot.replace('size="0.02 0.01 0.06"', 'size="0.001 0.001 0.001"')
        case.robot = case.robot.replace(PALM, LONG_PALM)
        assert failed(closing(case), tmp_path / family) == fails


def test_a_palm_pushes_forward_only(tmp_path: Path) -> None:
    assert not failed(closing(palm_case("push")), tmp_path / "pushes")
    assert failed(palm_case("push"), tmp_path / "would pull") == {OFF}
    for k, grip in enumerate((Grip((0.0, 0.0, -0.03)), Grip((0.0, 0.05, 0.0)))):
        assert failed(closing(palm_case("push", grip)), tmp_path / str(k)) == {OFF}


def test_suction_faces_the_part(tmp_path: Path) -> None:
    assert not failed(palm_case("suction"), tmp_path / "faces")
    for k, grip in enumerate((Grip((0.0, 0.0, -0.03)), Grip((0.11, 0.0, 0.0)))):
        assert failed(palm_case("suction", grip), tmp_path / str(k)) == {OFF}


def test_the_open_hand_does_not_come_through_the_part(tmp_path: Path) -> None:
    """It comes from the side, and a finger sweeps over the bar."""
    case = make_case()
    aside = make_case(grip=Grip((0.0, 0.1, 0.0)))
    case.plan["approach"] = [aside.plan["approach"][-1], case.plan["approach"][-1]]
    assert failed(case, tmp_path) == {INSIDE}


@pytest.mark.parametrize(
    ("name", "checks"),
    [
        ("tour_1_away2cm", []),
        ("tour_1_away5cm", [OFF]),
        ("pick_back55mm", [OFF]),
        ("oven_fetch_roll90", [INSIDE, OFF]),
        ("open_segway_roll-90", [INSIDE, OFF]),
    ],
)
def test_published_plans_are_judged_by_the_hand(name: str, checks: list[str]) -> None:
    """In the first one, half of the pads still reach over the whole bar."""
    plan = optional.there(CASES / "plans" / f"{name}.json")
    found = [one.name for one in verify_files(plan).violations]
    assert found == checks


@pytest.mark.parametrize("family", ["pinch", "suction", "push"])
def test_a_grasp_transmits_what_pulls_at_it(family: str, tmp_path: Path) -> None:
    """Friction at both pads carries the pull, which leans between the fingers; a push is firm."""
    case = hold(make_case(), family)
    case.write(tmp_path)
    scene, plan = load_scene(tmp_path / "scene.json"), read_plan(tmp_path / "plan.json")
    model = Articulated(read_urdf(tmp_path / "robot.urdf", actuated=True))
    assert plan.motion is not None
    shares = {}
    for force in (60.0, 1.0):
        robot = UrdfArm(model, "base", "tool", JOINTS, frozenset(), grip_force=force)
        verifier = PlanVerifier(scene, robot, plan.task)
        (check,) = (c for c in verifier.load_checks(BASE, plan.motion) if c.name == PULL)
        shares[force] = check.value / 100.0
        assert check.ok == (check.value <= 100.0)
    need = CarriedLoad(scene.object("cupboard"), plan.task, ResistanceConfig())
    path = dense_path(plan.motion, 0.02)
    pull, _ = need.along(plan.motion, path, np.repeat(np.eye(4)[None], len(path.q), 0))
    most = float(np.linalg.norm(pull, axis=1).max())
    lean, friction = np.arctan2(-HANDLE[0], HANDLE[1]), DEFAULT.friction
    pinched = 2.0 * friction / (np.cos(lean) + friction * np.sin(lean))
    transmitted = {"pinch": pinched, "suction": 1.0, "push": np.inf}[family]
    for force, share in shares.items():
        assert share == pytest.approx(most / (transmitted * force), rel=0.01)
    assert (shares[1.0] > 1.0) == (family != "push")


ARC = """<link name="{name}_crank"/><joint name="{name}_turn" type="revolute"><parent link="palm"/>
<child link="{name}_crank"/><origin xyz="0 {side}0.05 0.1"/><axis xyz="{other}1 0 0"/>
<limit lower="0" upper="0.9" effort="60" velocity="1"/></joint>
<joint name="{name}_tip" type="revolute"><parent link="{name}_crank"/><child link="{name}"/>
<origin xyz="0 {other}0.05 0.02"/><axis xyz="{other}1 0 0"/>
<limit lower="-0.9" upper="0" effort="60" velocity="1"/>
<mimic joint="{name}_turn" multiplier="-1"/></joint>"""
"""A linkage that carries a finger inward and forward, without turning it."""


@pytest.mark.parametrize(("shift", "off"), [(0.0, set()), (0.05, {OFF})])
def test_fingers_on_arcs_hold_what_is_between_them(
    shift: float, off: set[str], tmp_path: Path
) -> None:
    case = make_case(grip=Grip((0.0, 0.0, -shift)))
    begin = case.robot.index('<joint name="left_slide"')
    end = case.robot.index('<joint name="mount"')
    arcs = ARC.format(name="left", side="-", other="") + ARC.format(
        name="right", side="", other="-"
    )
    case.robot = case.robot[:begin] + arcs + case.robot[end:]
    assert failed(case, tmp_path) == off
