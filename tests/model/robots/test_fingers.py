"""Derived openings, rest values and closing forces of fingers."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.urdf_parts import box, joint, link, mobile_manipulator, telescope

from momapos.core.geometry.transforms import apply, invert
from momapos.model.robots.derive import write_robot
from momapos.model.robots.fingers import MAX_PAD_ANGLE
from momapos.model.robots.hand_openings import opened_to
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.urdf.hulls import hull_around, slab
from momapos.planning.grasps.hand_boxes import empty_handed, hand_of

STRONG = '<limit lower="{}" upper="{}" effort="{}" velocity="1"/>'
FINGER = 0.15
"""Length of the rotating fingers [m]."""


def with_fingers(*parts: str) -> str:
    """Return the mobile manipulator with other fingers."""
    text = mobile_manipulator(fingers=False, tool=False)
    more = [*parts, link("tcp"), joint("tcp_joint", "fixed", "palm", "tcp", "0.2 0 0")]
    return text.replace("</robot>", "".join(more) + "</robot>")


def turning(lower: float, upper: float, effort: float = 20.0) -> str:
    """Return fingers that rotate about adjacent axes, parallel and 3 cm apart at zero."""
    parts = []
    for side, sign in (("left", 1), ("right", -1)):
        limit = STRONG.format(lower, upper, effort)
        name = f"{side}_finger"
        parts += [
            link(name, box(FINGER, 0.01, 0.02), f"{FINGER / 2} 0 0"),
            joint(
                f"{name}_joint", "revolute", "palm", name, f"0.06 {0.02 * sign} 0",
                f"0 0 {sign}", limit,
            ),
        ]  # fmt: skip
    return with_fingers(*parts)


def sliding(tip: str, effort: float = 50.0) -> str:
    """Return sliding fingers with separate tip links, rotated by `tip` [rad]."""
    parts = []
    for side, sign in (("left", 1), ("right", -1)):
        parts += [
            link(f"{side}_finger", box(0.04, 0.01, 0.02), f"0.02 {0.02 * sign} 0"),
            joint(
                f"{side}_finger_joint", "prismatic", "palm", f"{side}_finger", "0.06 0 0",
                f"0 {sign} 0", STRONG.format(0, 0.04, effort),
            ),
            link(f"{side}_tip", box(0.05, 0.01, 0.02), rpy=f"0 0 {tip}"),
            joint(
                f"{side}_tip_joint", "fixed", f"{side}_finger", f"{side}_tip",
                f"0.06 {0.02 * sign} 0",
            ),
        ]  # fmt: skip
    return with_fingers(*parts)


def derived(folder: Path, text: str) -> Robot:
    (folder / "robot.urdf").write_text(text)
    return load_robot(write_robot(folder / "robot.urdf")[0])


def tips(robot: Robot) -> list[np.ndarray]:
    """Return the vertices of the left and right finger at rest, in the tool frame."""
    T = invert(robot.model.rest_poses[robot.tool_link])
    return [
        np.concatenate(
            [
                apply(T @ robot.model.rest_poses[name], hull.vertices)
                for hull in robot.model.hulls[name]
            ]
        )
        for name in ("left_finger", "right_finger")
    ]


def test_rotating_fingers_rest_open_with_facing_pads(tmp_path: Path) -> None:
    robot = derived(tmp_path, turning(-0.6, 0.6))
    rest = tomllib.loads(robot.path.read_text())["rest"]
    assert rest["left_finger_joint"] == rest["right_finger_joint"] > 0.0
    assert rest["left_finger_joint"] == pytest.approx(MAX_PAD_ANGLE, abs=0.02), "parallel at zero"
    left, right = tips(robot)
    ends = (
        left[left[:, 0] > left[:, 0].max() - 0.015, 1],
        right[right[:, 0] > right[:, 0].max() - 0.015, 1],
    )
    assert robot.opening > 0.04, "they are 3 cm apart at zero"
    assert robot.opening <= ends[0].min() - ends[1].max() + 1e-3


@pytest.mark.parametrize("ends", [(-0.3, 0.1), (0.0, 0.5), (-0.6, 0.6)])
def test_the_pads_of_rotating_fingers_are_the_opening_apart(
    tmp_path: Path, ends: tuple[float, float]
) -> None:
    robot = derived(tmp_path, turning(*ends))
    hand = hand_of(robot)
    assert hand.closes
    assert hand.inner(1)[0] - hand.inner(-1)[0] == pytest.approx(robot.opening, abs=2e-3)
    assert hand.rest == pytest.approx(0.0, abs=2e-3), "it rests open"


@pytest.mark.parametrize("ends", [(-0.3, 0.1), (0.0, 0.5), (-0.6, 0.6)])
def test_rotating_fingers_open_to_less_than_they_can(
    tmp_path: Path, ends: tuple[float, float]
) -> None:
    robot = derived(tmp_path, turning(*ends))
    narrow = opened_to(robot, round(0.8 * robot.opening, 3))
    hand, ends = hand_of(narrow), [side[side[:, 0].argmax(), 1] for side in tips(narrow)]
    assert hand.inner(1)[0] - hand.inner(-1)[0] == pytest.approx(0.8 * robot.opening, abs=2e-3)
    assert hand.rest == pytest.approx(0.0, abs=2e-3)
    before = [side[side[:, 0].argmax(), 1] for side in tips(robot)]
    assert before[0] > ends[0] > 0.0 > ends[1] > before[1]


def test_jaws_open_as_far_as_their_pads_are_parallel_within_the_limit(tmp_path: Path) -> None:
    """The jaws are parallel 3 cm apart, and meet at -0.1 rad: from there, 0.2 rad are 6 cm less."""
    robot = derived(tmp_path, turning(-0.6, 0.6))
    widest = 0.03 + 2 * FINGER * np.sin(MAX_PAD_ANGLE)
    assert robot.opening == pytest.approx(widest - 0.01, abs=0.01)


def test_jaws_with_wedges_open_from_where_the_wedges_are_parallel(tmp_path: Path) -> None:
    """Pads that lean by 0.3 rad on their jaws are parallel when the jaws are 0.3 rad open."""
    text = turning(-0.1, 0.6)
    for side, sign in (("left", 1), ("right", -1)):
        bar = box(FINGER, 0.01, 0.02)
        turned = f"{FINGER - 0.02} {sign * -0.006} 0"
        wedge = f'<collision><origin xyz="{turned}" rpy="0 0 {-sign * 0.3}"/>'
        wedge += f"<geometry>{box(0.05, 0.012, 0.02)}</geometry></collision>"
        at = text.index(f'<link name="{side}_finger">')
        end = text.index("</link>", at)
        assert bar in text[at:end]
        text = text[:end] + wedge + text[end:]
    robot = derived(tmp_path, text)
    rest = robot.model.rest["left_finger_joint"]
    assert rest == pytest.approx(0.3 + MAX_PAD_ANGLE, abs=0.02)


def test_soft_tips_on_turning_fingers_hold_over_the_whole_stroke(tmp_path: Path) -> None:
    parts = []
    for side, sign in (("left", 1), ("right", -1)):
        parts += [
            link(f"{side}_finger", box(0.1, 0.01, 0.02), "0.05 0 0"),
            joint(
                f"{side}_finger_joint", "revolute", "palm", f"{side}_finger",
                f"0.06 {0.02 * sign} 0", f"0 0 {sign}", STRONG.format(-0.1, 0.6, 20),
            ),
            link(f"{side}_cup", box(0.03, 0.01, 0.02), "0.015 0 0"),
            joint(f"{side}_mount", "fixed", f"{side}_finger", f"{side}_cup", "0.1 0 0"),
        ]  # fmt: skip
    robot = derived(tmp_path, with_fingers(*parts))
    assert robot.model.rest["left_finger_joint"] == pytest.approx(0.6, abs=0.02)
    assert robot.opening > 0.03 + 2 * 0.1 * np.sin(0.6) - 0.01


@pytest.mark.parametrize("sign", [1, -1])
def test_tips_that_curl_with_their_fingers_are_reported(tmp_path: Path, sign: int) -> None:
    parts = []
    for side, way in (("left", 1), ("right", -1)):
        parts += [
            link(f"{side}_finger", box(0.08, 0.01, 0.02), "0.04 0 0"),
            joint(
                f"{side}_finger_joint", "revolute", "palm", f"{side}_finger",
                f"0.06 {0.02 * way} 0", f"0 0 {way}", STRONG.format(-0.1, 0.6, 20),
            ),
            link(f"{side}_tip", box(0.04, 0.01, 0.02), "0.02 0 0"),
            joint(
                f"{side}_tip_joint", "revolute", f"{side}_finger", f"{side}_tip", "0.08 0 0",
                f"0 0 {way}", STRONG.format(-0.6, 0.6, 20)
                + f'<mimic joint="{side}_finger_joint" multiplier="{0.9 * sign}"/>',
            ),
        ]  # fmt: skip
    path = tmp_path / "robot.urdf"
    path.write_text(with_fingers(*parts))
    made, found = write_robot(path)
    said = "\n".join(found.assumptions)
    assert ("left_tip_joint turns the tip in the direction of left_finger_joint" in said) == (
        sign > 0
    )
    opening = load_robot(made).opening
    assert opening < 0.08 if sign > 0 else opening > 0.1


def test_limits_that_move_fingers_through_each_other_are_reported(tmp_path: Path) -> None:
    text = sliding("0.0").replace('lower="0" upper="0.04"', 'lower="-0.04" upper="0"')
    text = text.replace(' 0.02 0"', ' 0.005 0"').replace(' -0.02 0"', ' -0.005 0"')
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    said = "\n".join(write_robot(path)[1].assumptions)
    names = "left_finger_joint and right_finger_joint"
    assert f"IMPORTANT: {names} move the fingers through each other" in said


@pytest.mark.parametrize("side", [1, -1])
def test_a_turning_jaw_opens_from_the_fixed_side_of_the_hand(tmp_path: Path, side: int) -> None:
    """The jaw is as wide as its pad and the fixed one lean, together twice the limit."""
    text = with_fingers(
        link("jaw", box(0.08, 0.01, 0.02), "0.04 0 0"),
        joint(
            "jaw_joint", "revolute", "palm", "jaw", f"0.06 {0.01 * side} 0", f"0 0 {side}",
            STRONG.format(-0.1, 1.5, 10),
        ),
    )  # fmt: skip
    fixed = f'<collision><origin xyz="0.1 {-0.02 * side} 0"/>'
    fixed += f"<geometry>{box(0.08, 0.01, 0.02)}</geometry></collision>"
    at = text.index("</link>", text.index('<link name="palm">'))
    robot = derived(tmp_path, text[:at] + fixed + text[at:])
    widest = 0.02 + (0.08 - 0.03) * np.sin(2 * MAX_PAD_ANGLE)
    assert robot.opening == pytest.approx(widest, abs=0.006)
    assert robot.model.rest["jaw_joint"] == pytest.approx(2 * MAX_PAD_ANGLE, abs=0.03)


def test_a_finger_that_follows_the_other_opens_with_it(tmp_path: Path) -> None:
    text = sliding("0.0")
    begin = text.index('<joint name="right_finger_joint"')
    at = text.index("</joint>", begin)
    text = text[:at] + '<mimic joint="left_finger_joint" multiplier="1"/>' + text[at:]
    robot = derived(tmp_path, text)
    narrow = opened_to(robot, 0.05)
    changed = {n for n, v in narrow.model.held.items() if v != robot.model.held.get(n, 0.0)}
    assert changed == {"left_finger_joint"}
    assert hand_of(narrow).inner(1)[0] == pytest.approx(0.025, abs=1e-4)
    assert hand_of(narrow).inner(-1)[0] == pytest.approx(-0.025, abs=1e-4)


def test_a_hand_without_two_moving_sides_stays_as_it_is(tmp_path: Path) -> None:
    assert opened_to(derived(tmp_path, one_jaw(1)), 0.03) is None
    (tmp_path / "bare").mkdir()
    bare = mobile_manipulator(fingers=False)
    assert opened_to(derived(tmp_path / "bare", bare), 0.03) is None


def test_the_force_of_rotating_fingers_is_effort_over_length(tmp_path: Path) -> None:
    robot = derived(tmp_path, turning(-0.6, 0.6, effort=15.0))
    assert robot.grip_force == pytest.approx(15.0 / FINGER, rel=0.1)


def test_the_effort_of_a_spread_joint_is_no_closing_force(tmp_path: Path) -> None:
    parts = []
    for side, sign in (("left", 1), ("right", -1)):
        parts += [
            link(f"{side}_knuckle", box(0.01, 0.01, 0.01)),
            joint(
                f"{side}_spread", "revolute", "palm", f"{side}_knuckle", "0.06 0 0", "0 1 0",
                STRONG.format(-0.2, 0.2, 1),
            ),
            link(f"{side}_finger", box(0.06, 0.01, 0.02), f"0.03 {sign * 0.005} 0"),
            joint(
                f"{side}_finger_joint", "prismatic", f"{side}_knuckle", f"{side}_finger", "0 0 0",
                f"0 {sign} 0", STRONG.format(0, 0.045, 55),
            ),
        ]  # fmt: skip
    assert derived(tmp_path, with_fingers(*parts)).grip_force == pytest.approx(55.0)


def one_jaw(side: int, effort: float = 50.0) -> str:
    """Return a jaw that slides toward a fixed one on a given side, closed at zero."""
    return with_fingers(
        link("fixed_jaw", box(0.06, 0.01, 0.02), "0.03 0 0"),
        joint("jaw_mount", "fixed", "palm", "fixed_jaw", f"0.06 {0.05 * side} 0"),
        link("moving_jaw", box(0.06, 0.01, 0.02), "0.03 0 0"),
        joint(
            "jaw_joint", "prismatic", "palm", "moving_jaw", f"0.06 {0.04 * side} 0",
            f"0 {-side} 0", STRONG.format(0, 0.08, effort),
        ),
    )  # fmt: skip


@pytest.mark.parametrize("side", [1, -1])
def test_a_jaw_that_closes_on_a_fixed_one_is_a_gripper(tmp_path: Path, side: int) -> None:
    robot = derived(tmp_path, one_jaw(side))
    assert robot.opening == pytest.approx(0.08, abs=2e-3)
    assert robot.grip_force == pytest.approx(50.0)
    assert robot.model.rest["jaw_joint"] == pytest.approx(0.08), "it rests open"
    assert not empty_handed(robot)
    hand = hand_of(robot)
    assert hand.closes
    assert hand.fixed == side * np.sign(robot.closing_axis[1])
    assert hand.inner(1)[0] - hand.inner(-1)[0] == pytest.approx(robot.opening, abs=2e-3)
    assert hand.rest == pytest.approx(0.0, abs=2e-3)
    assert hand.closed_to(np.array([0.03]))[0] == pytest.approx(0.05, abs=4e-3)


def test_a_jaw_closes_on_a_fixed_jaw_in_the_last_link_of_the_arm(tmp_path: Path) -> None:
    text = one_jaw(1)
    for name in ("palm", "fixed_jaw"):
        text = re.sub(f'<link name="{name}">.*?</link>', "", text)
    for name in ("mount", "jaw_mount"):
        text = re.sub(f'<joint name="{name}".*?</joint>', "", text)
    text = text.replace('<parent link="palm"/>', '<parent link="arm_5"/>')
    jaw = link("arm_5", box(0.06, 0.01, 0.02), "0.09 0.05 0").removesuffix("</link>")
    text = text.replace('<link name="arm_5">', jaw)
    robot = derived(tmp_path, text)
    assert "arm_5" in robot.gripper_links
    assert robot.model.rest["jaw_joint"] == pytest.approx(0.08), "it rests open"
    hand = hand_of(robot)
    assert hand.closes
    assert hand.fixed != 0
    assert hand.inner(1)[0] - hand.inner(-1)[0] == pytest.approx(robot.opening, abs=2e-3)


def test_a_hand_closes_until_both_sides_touch_the_object(tmp_path: Path) -> None:
    way = np.array([[0.03, 0.01], [0.002, 0.001], [0.0, 0.05]])
    for side in (1, -1, 0):
        text = one_jaw(side) if side else sliding("0")
        folder = tmp_path / f"{side}"
        folder.mkdir()
        hand = hand_of(derived(folder, text))
        shift, travel = hand.meeting(way, 0.004)
        assert_allclose(travel[:, 0] + shift, way[:, 0], atol=1e-12)
        assert_allclose(travel[:, 1] - shift, way[:, 1], atol=1e-12)
        if side:
            assert (travel[:, 0 if hand.fixed > 0 else 1] <= 0.004 + 1e-12).all()
        else:
            assert_allclose(travel[:, 0], travel[:, 1])


@pytest.mark.parametrize("turn", ["0.5", "-0.4", "0.1"])
def test_leaning_tips_become_pads_that_face_the_object(tmp_path: Path, turn: str) -> None:
    hand = hand_of(derived(tmp_path, sliding(turn)))
    assert hand.closes
    along = np.einsum("bij,i->bj", hand.boxes.rotation[hand.pad], hand.closing)
    assert_allclose(np.abs(along).max(1), 1.0)


def test_hand_links_that_touch_at_rest_are_not_checked(tmp_path: Path) -> None:
    text = sliding("0").replace('size="0.04 0.01 0.02"', 'size="0.04 0.06 0.02"')
    text = text.replace('upper="0.04"', 'upper="1e-6"')
    disabled = derived(tmp_path, text).disabled
    assert frozenset(("left_finger", "right_finger")) in disabled
    assert frozenset(("left_tip", "right_tip")) not in disabled


def test_stages_of_a_telescope_are_not_checked(tmp_path: Path) -> None:
    robot = derived(tmp_path, telescope(4))
    stages = ["torso", *(f"stage_{k}" for k in range(4))]
    checked = {
        frozenset((robot.spheres.links[i], robot.spheres.links[j])) for i, j in robot.spheres.pairs
    }
    assert not {pair for pair in checked if pair <= set(stages)}
    assert frozenset(("stage_0", "arm_4")) in checked


def test_neighbors_that_touch_in_most_states_are_not_checked(tmp_path: Path) -> None:
    fat = link("arm_5", '<sphere radius="0.1"/>')  # touches arm_3 once the wrist is bent by 50 deg
    coarse = re.sub('<link name="arm_5">.*?</link>', fat, mobile_manipulator())
    robot = derived(tmp_path, coarse)
    assert frozenset(("arm_3", "arm_5")) in robot.disabled
    assert frozenset(("torso", "arm_5")) not in robot.disabled


def test_a_flange_without_fingers_is_reported_to_hold_nothing(tmp_path: Path) -> None:
    text = mobile_manipulator(fingers=False)
    (tmp_path / "robot.urdf").write_text(text)
    made, found = write_robot(tmp_path / "robot.urdf")
    assert any(note.startswith("IMPORTANT: grips") for note in found.assumptions)
    assert "nothing to hold with" in empty_handed(load_robot(made))
    made.write_text(made.read_text().replace('grips = "fingers"', 'grips = "hook"'))
    assert empty_handed(load_robot(made)) == ""


def test_a_slab_of_a_body_is_its_part_between_two_planes() -> None:
    rng = np.random.default_rng(3)
    hull = hull_around(rng.normal(size=(40, 3)), "body")
    axis = np.array([0.6, 0.0, 0.8])
    part = slab(hull.vertices, hull.faces, axis, -0.3, 0.4)
    assert -0.3 - 1e-9 <= (part @ axis).min() <= (part @ axis).max() <= 0.4 + 1e-9
    weights = rng.dirichlet(np.full(len(hull.vertices), 0.2), 20_000)
    inside = weights @ hull.vertices
    inside = inside[(inside @ axis >= -0.3) & (inside @ axis <= 0.4)]
    for way in rng.normal(size=(20, 3)):
        assert (inside @ way).max() <= (part @ way).max() + 1e-9
    assert len(slab(hull.vertices, hull.faces, axis, 50.0)) == 0
