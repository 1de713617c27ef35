"""Scene checks and listings name the latch of a part, and what it holds."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.commands import output_of
from tests.cupboards import latched_room

from momapos.apps.cli.main import main
from momapos.workflows.scene_check.checks import joint_reports
from momapos.workflows.scene_check.report import joint_lines


def test_a_scene_check_names_the_latch_at_both_joints(tmp_path: Path) -> None:
    joints = joint_reports(latched_room(tmp_path, "a lever"))
    latches = {one.joint: (one.latch, one.latch_to, one.holds) for one in joints}
    assert latches == {"hinge": ("turn", "-40.1 deg", ""), "turn": ("", "", "hinge")}
    text = "\n".join(joint_lines(joints))
    assert "once turn is turned to -40.1 deg" in text
    assert "the latch of hinge" in text


def test_a_listing_of_a_scene_names_its_latches(tmp_path: Path) -> None:
    path = latched_room(tmp_path, "a sliding bolt").path
    assert "hinge opens once turn is at 0.06 m" in output_of("scene", "show", str(path))


def test_an_unusable_latch_ends_with_exit_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = latched_room(tmp_path, "a lever").path
    path.write_text(path.read_text().replace('"to": -0.7', '"to": 0.7'))
    assert main(["place", "open", str(path), "cupboard"]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert "outside the limits of 'turn'" in said[0]
