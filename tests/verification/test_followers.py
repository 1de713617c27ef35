"""Mimic joints move with their leaders in the check, and must do so in plans."""

from __future__ import annotations

from pathlib import Path

import pytest
from door_case import make_case

from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.verification.link_bodies import bodies_of
from momapos.verification.plan_check import verify_files

FOLLOWS = "mimic joints follow their leaders"
TWO_DRAWERS = """<robot name="chest"><link name="body"/><link name="upper"/><link name="lower"/>
<link name="knob"/>
<joint name="slide" type="prismatic"><parent link="body"/><child link="upper"/>
  <axis xyz="1 0 0"/><limit lower="0" upper="0.4"/></joint>
<joint name="follower" type="prismatic"><parent link="body"/><child link="lower"/>
  <axis xyz="1 0 0"/><limit lower="0" upper="0.4"/><mimic joint="slide"/></joint>
<joint name="mount" type="fixed"><parent link="lower"/><child link="knob"/></joint></robot>"""


def with_mimic(text: str, joint: str, mimic: str) -> str:
    begin = text.index(f'<joint name="{joint}"')
    end = text.index("</joint>", begin)
    return text[:end] + mimic + text[end:]


def test_a_plan_whose_mimic_joint_does_not_follow_is_rejected(tmp_path: Path) -> None:
    case = make_case()
    case.robot = with_mimic(case.robot, "twist", '<mimic joint="roll"/>')
    assert FOLLOWS in [check.name for check in verify_files(case.write(tmp_path)).violations]


def test_the_error_of_a_mimic_joint_is_reported(tmp_path: Path) -> None:
    case = make_case()
    mimic = '<mimic joint="roll" multiplier="-0.5" offset="0.2"/>'
    case.robot = with_mimic(case.robot, "twist", mimic)
    twist, roll = (case.plan["joints"].index(name) for name in ("twist", "roll"))
    states = [*case.q(), *case.plan["approach"]]
    (check,) = [c for c in verify_files(case.write(tmp_path)).checks if c.name == FOLLOWS]
    assert check.value == pytest.approx(max(abs(q[twist] + 0.5 * q[roll] - 0.2) for q in states))


def test_mimic_joints_move_with_their_leader(tmp_path: Path) -> None:
    path = tmp_path / "chest.urdf"
    path.write_text(TWO_DRAWERS)
    model = Articulated(read_urdf(path))
    bodies = bodies_of(model)
    moved = {link for link, body in bodies.of_link.items() if body in bodies.moved_by("slide")}
    assert moved == set(model.moved_by("slide")) == {"upper", "lower", "knob"}
