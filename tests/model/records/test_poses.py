"""Laws of tool poses: what their tolerance allows, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from momapos.core.errors import InputError
from momapos.core.geometry.transforms import pose, rotation_about, rotation_of
from momapos.model.records.plans import Task
from momapos.model.records.poses import ToolPose

X = np.array([1.0, 0.0, 0.0])


def off_by(R: np.ndarray, p: tuple[float, ...] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return a tool that deviates from a pose at (1, 2, 3)."""
    return pose((1.0 + p[0], 2.0 + p[1], 3.0 + p[2]), R)[None]


def test_a_pose_allows_its_turn_and_its_lean_together_and_nothing_more() -> None:
    one = ToolPose((1, 2, 3), axis=(1, 0, 0), spin=math.radians(30), cone=math.radians(10))
    rng = np.random.default_rng(0)
    for _ in range(50):
        spin, lean, around = rng.uniform([-60, 0, 0], [60, 20, 360])
        side = np.array([0.0, math.cos(math.radians(around)), math.sin(math.radians(around))])
        R = rotation_about(side, math.radians(lean)) @ rotation_about(X, math.radians(spin))
        allowed = abs(spin) <= 30 and lean <= 10
        assert (one.excess(off_by(R))[0, 1] <= 0.0) == allowed


def test_a_free_turn_allows_every_turn_about_the_axis() -> None:
    one = ToolPose((1, 2, 3), axis=(1, 0, 0), spin=math.pi)
    turns = rotation_about(X, np.linspace(-math.pi, math.pi, 13))
    assert (one.excess(np.concatenate([off_by(R) for R in turns]))[:, 1] <= 0.0).all()
    half = ToolPose((1, 2, 3), axis=(1, 0, 0), spin=math.pi / 2)
    assert half.excess(off_by(rotation_about(X, math.pi)))[0, 1] == pytest.approx(math.pi / 2)


def test_without_an_axis_the_whole_rotation_counts() -> None:
    one = ToolPose((1, 2, 3), rotation=0.1)
    for angle, allowed in ((0.09, True), (0.11, False)):
        R = rotation_of(angle * np.array([0.6, 0.0, 0.8]))
        assert (one.excess(off_by(R))[0, 1] <= 0.0) == allowed


def test_the_position_is_measured_in_the_frame_of_the_pose() -> None:
    w = math.sqrt(0.5)
    one = ToolPose((1, 2, 3), (w, 0, 0, w), position=(0.1, 0.01, 0.01))  # turned by 90 deg
    R = rotation_about(np.array([0.0, 0.0, 1.0]), math.pi / 2)
    assert one.excess(off_by(R, (0.0, 0.09, 0.0)))[0, 0] <= 0.0
    assert one.excess(off_by(R, (0.09, 0.0, 0.0)))[0, 0] > 0.0


def test_a_quaternion_is_scaled_within_a_thousandth_and_refused_beyond() -> None:
    one = ToolPose((0, 0, 0), (1.0005, 0, 0, 0))
    assert one.wxyz == (1.0, 0.0, 0.0, 0.0)
    with pytest.raises(InputError, match=r"quaternion has length 1\.01; it must be 1"):
        ToolPose((0, 0, 0), (1.01, 0, 0, 0))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"position": (0, 0, 0), "rotation": 0}, "all tolerances are zero"),
        ({"spin": 1.0}, "need an axis"),
        ({"position": (-1, 0, 0)}, "at least 0"),
        ({"axis": (0, 0, 2), "spin": 1.0}, "axis has length 2"),
        ({"rotation": float("nan")}, "rotation must be"),
    ],
)
def test_an_impossible_tolerance_is_refused(wrong: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        ToolPose((0, 0, 0), **wrong)  # type: ignore[arg-type]


def test_only_reach_has_poses_and_no_object() -> None:
    one = ToolPose((0, 0, 0))
    assert Task("reach", "", poses=(one,)).target == "1 pose"
    for wrong in (Task, lambda *a: Task(*a, poses=(one,))):
        with pytest.raises(InputError, match="reach and follow need poses and no object"):
            wrong("reach", "table" if wrong is not Task else "")
