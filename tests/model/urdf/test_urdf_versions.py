"""URDF 1.0 to 1.2: quaternions, capsules, limits of robots, several trees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from tests import optional
from tests.real import CASES

from momapos.core.errors import UrdfError
from momapos.model.robots.amended_urdf import Amendments
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.furniture import read_furniture
from momapos.model.urdf.reader import read_urdf
from momapos.model.urdf.urdf_records import Urdf
from momapos.simulation.robot_dynamics import read_dynamics

BOX = '<geometry><box size="0.1 0.2 0.3"/></geometry>'
LIMIT = '<limit lower="-1" upper="2" effort="5" velocity="1"/>'


def read(folder: Path, body: str, *, version: str = "", actuated: bool = True) -> Urdf:
    path = folder / "r.urdf"
    path.write_text(f'<robot name="r"{version and f" version={version!r}"}>{body}</robot>')
    return read_urdf(path, actuated=actuated)


def two(joint: str, kind: str = "revolute", link: str = "", name: str = "j") -> str:
    """Return two links and a joint with some content."""
    return (
        f'<link name="a"/><link name="b">{link}</link><joint name="{name}" type="{kind}">'
        f'<parent link="a"/><child link="b"/><axis xyz="0 0 1"/>{joint}</joint>'
    )


def three(first: str, second: str) -> str:
    """Return a joint i from a to b, and a joint j from b to c."""
    more = '<link name="c"/><joint name="j" type="revolute"><parent link="b"/><child link="c"/>'
    return two(first, name="i") + f'{more}<axis xyz="0 1 0"/>{second}</joint>'


@pytest.mark.parametrize("seed", range(4))
def test_a_quaternion_is_the_rotation_of_its_roll_pitch_and_yaw(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles, length = rng.uniform(-3, 3, 3), rng.uniform(0.5, 2.0)
    quat = Rotation.from_euler("xyz", angles).as_quat() * length
    found = []
    for turn in (
        f'rpy="{" ".join(map(repr, angles.tolist()))}"',
        f'quat_xyzw="{" ".join(map(repr, quat.tolist()))}"',
    ):
        origin = f'<origin xyz="1 2 3" {turn}/>'
        mass = '<mass value="2"/><inertia ixx="1" iyy="2" izz="3" ixy="0" ixz="0" iyz="0"/>'
        shape = f"<collision>{origin}{BOX}</collision><inertial>{origin}{mass}</inertial>"
        urdf = read(tmp_path, two(origin + LIMIT, link=shape), version="1.1")
        assert urdf.notes == ()
        inertia = read_dynamics(tmp_path / "r.urdf").inertias["b"].T_link_inertia
        shape_pose = urdf.links["b"].collisions[0].T_link_geometry
        found.append(np.stack([urdf.joints[0].T_parent_joint, shape_pose, inertia]))
    assert_allclose(found[0], found[1], atol=1e-12)
    assert_allclose(found[0][:, :3, :3], found[0][:1, :3, :3].repeat(3, 0), atol=1e-12)


def test_a_capsule_is_a_cylinder_and_two_balls(tmp_path: Path) -> None:
    capsule = '<collision><origin rpy="0.3 0 0.2"/><geometry><capsule radius="0.05" length="{}"/>'
    urdf = read(tmp_path, two(LIMIT, link=capsule.format(0.4) + "</geometry></collision>"))
    assert [shape.kind for shape in urdf.links["b"].collisions] == ["cylinder", "sphere", "sphere"]
    hulls = Articulated(urdf).hulls["b"]
    points = np.concatenate([hull.vertices for hull in hulls])
    axis = urdf.links["b"].collisions[0].T_link_geometry[:3, 2]
    assert (points @ axis).max() == pytest.approx(0.25, abs=2e-3)
    ball = read(tmp_path, two(LIMIT, link=capsule.format(0) + "</geometry></collision>"))
    assert [shape.kind for shape in ball.links["b"].collisions] == ["sphere"]
    assert read_furniture(tmp_path / "r.urdf").links["b"].collisions[0].size == (0.05,)


def test_features_of_a_later_version_are_read_and_reported_once(tmp_path: Path) -> None:
    turned = '<origin quat_xyzw="0 0 1 0"/>'
    urdf = read(tmp_path, three(turned + LIMIT, turned + LIMIT))
    assert len(urdf.notes) == 1
    assert "quat_xyzw" in urdf.notes[0]
    assert_allclose(urdf.joints[0].T_parent_joint[:3, :3], np.diag([-1, -1, 1]), atol=1e-12)
    (note,) = read(tmp_path, two(LIMIT), version="3.7").notes
    assert "'3.7'" in note
    assert "read as 1.2" in note


@pytest.mark.parametrize(
    ("limits", "acceleration"),
    [
        ("", np.inf),
        ('acceleration="3"', 3.0),
        ('acceleration="3" deceleration="2"', 2.0),
        ('acceleration="inf" deceleration="2"', 2.0),
        ('acceleration="0"', np.inf),
    ],
)
def test_the_smaller_limit_of_acceleration_and_deceleration_holds(
    tmp_path: Path, limits: str, acceleration: float
) -> None:
    urdf = read(tmp_path, two(LIMIT.replace("/>", f" {limits}/>")), version="1.2")
    assert urdf.joints[0].acceleration == acceleration
    assert bool(urdf.notes) == ('"0"' in limits)


def test_a_leader_keeps_the_acceleration_and_the_jerk_of_its_followers(tmp_path: Path) -> None:
    follower = '<mimic joint="i" multiplier="-2"/>' + LIMIT.replace("/>", ' acceleration="3"/>')
    wide = follower.replace('lower="-1" upper="2"', 'lower="-9" upper="9"')
    assert read(tmp_path, three(LIMIT, wide)).joints[0].acceleration == 1.5
    jerk = wide.replace('acceleration="3"', 'jerk="8"')
    assert read(tmp_path, three(LIMIT, jerk)).joints[0].jerk == 4.0


def test_a_jerk_limit_is_read_and_a_jerk_of_zero_is_reported(tmp_path: Path) -> None:
    jerk = LIMIT.replace("/>", ' jerk="9"/>')
    urdf = read(tmp_path, three(jerk, LIMIT), version="1.2")
    assert [joint.jerk for joint in urdf.joints] == [9.0, np.inf]
    assert not urdf.notes
    (note,) = read(tmp_path, three(jerk.replace("9", "0"), jerk), version="1.2").notes
    assert "'i'" in note
    assert "jerk" in note


def soft(lower: float, upper: float, more: str = "") -> str:
    ends = f'soft_lower_limit="{lower}" soft_upper_limit="{upper}"'
    return f"{LIMIT}<safety_controller {ends} {more}/>"


@pytest.mark.parametrize(
    ("lower", "upper", "limits"),
    [
        (-0.5, 0.5, (-0.5, 0.5)), (-9, 0.5, (-1, 0.5)), (0, 0, (-1, 2)), (0, 1, (0, 1)),
        (3, 4, (-1, 2)), (0.7, 0.7, (-1, 2)),
    ],
)  # fmt: skip
def test_soft_limits_narrow_the_range_of_a_motor(
    tmp_path: Path, lower: float, upper: float, limits: tuple[float, float]
) -> None:
    urdf = read(tmp_path, two(soft(lower, upper)))
    assert (urdf.joints[0].lower, urdf.joints[0].upper) == limits
    assert bool(urdf.notes) == (lower >= 0.7), "limits that leave no range are reported"
    passive = read(tmp_path, two(soft(lower, upper)), actuated=False)
    assert (passive.joints[0].lower, passive.joints[0].upper) == (-1, 2)


def test_soft_limits_end_the_turns_of_a_continuous_joint(tmp_path: Path) -> None:
    urdf = read(tmp_path, two(soft(-2.5, 2.5), "continuous"))
    assert (urdf.joints[0].kind, urdf.joints[0].lower) == ("revolute", -2.5)
    gains = read(tmp_path, two(soft(0, 0, 'k_velocity="3"'), "continuous"))
    assert gains.joints[0].kind == "continuous"
    assert "k_velocity" in gains.notes[0]


@pytest.mark.parametrize("value", [0.0, 0.4])
def test_a_joint_with_equal_limits_is_fixed_at_them(tmp_path: Path, value: float) -> None:
    still = f'<limit lower="{value}" upper="{value}" effort="5" velocity="1"/>'
    follower = f'<mimic joint="i" multiplier="2" offset="0.1"/>{LIMIT}'
    body = three(still, follower)
    model, free = (Articulated(read(tmp_path, body, actuated=on)) for on in (True, False))
    assert not model.joints
    assert_allclose(model.rest_poses["c"], free.link_poses({"i": value})["c"], atol=1e-12)
    assert "'i'" in model.urdf.notes[0]


def test_equal_limits_of_a_follower_mean_nothing(tmp_path: Path) -> None:
    still = '<mimic joint="i"/><limit lower="0" upper="0" effort="5" velocity="1"/>'
    assert len(Articulated(read(tmp_path, three(LIMIT, still))).joints) == 2


@pytest.mark.parametrize("first", [True, False])
def test_of_several_trees_the_one_that_moves_is_read(tmp_path: Path, first: bool) -> None:
    lone = f'<link name="world"/><link name="ground"><collision>{BOX}</collision></link>'
    urdf = read(tmp_path, lone + two(LIMIT) if first else two(LIMIT) + lone)
    assert (urdf.root, list(urdf.links)) == ("a", ["a", "b"])
    (note,) = urdf.notes
    assert "'world', 'ground'" in note
    assert note in read_furniture(tmp_path / "r.urdf").notes


def test_meshes_of_a_tree_that_is_left_out_need_not_exist(tmp_path: Path) -> None:
    mesh = '<collision><geometry><mesh filename="{}.stl"/></geometry></collision>'
    lone = f'<link name="world">{mesh.format("lost")}</link>'
    (tmp_path / "good.stl").write_text("")
    urdf = read(tmp_path, lone + two(LIMIT, link=mesh.format("good")))
    assert urdf.links["b"].collisions[0].mesh == tmp_path / "good.stl"


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (two('<origin quat_xyzw="0 0 0 0"/>' + LIMIT), "has length 0"),
        (two('<origin quat_xyzw="0 0 1"/>' + LIMIT), "4 finite numbers"),
        (two('<origin rpy="0 0 0" quat_xyzw="0 0 0 1"/>' + LIMIT), "both rpy and quat_xyzw"),
        (two(LIMIT.replace('"5"', '"-5"')), "effort='-5' in <limit> must not be negative"),
        (two(LIMIT.replace("/>", ' acceleration="-1"/>')), "acceleration='-1'"),
        (two(LIMIT.replace("/>", ' jerk="much"/>')), "jerk='much'"),
        (two(LIMIT.replace('"-1"', '"nan"')), "lower='nan'"),
        (two(soft(0, 1).replace('"1"', '"x"')), "<limit>|soft_upper_limit"),
        (two('<mimic joint="j"/>' + LIMIT), "follows itself"),
        (
            two(LIMIT, link='<collision><geometry><capsule radius="0" length="1"/></geometry>'
            "</collision>"), "radius='0'",
        ),
        (
            two(LIMIT, link='<visual><geometry><capsule radius="1"/></geometry></visual>'),
            "no length",
        ),
    ],
)  # fmt: skip
def test_bad_numbers_are_refused_in_one_line(tmp_path: Path, body: str, words: str) -> None:
    with pytest.raises(UrdfError, match=words) as caught:
        read(tmp_path, body)
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "r.urdf") in str(caught.value)


def test_limits_of_a_robot_file_replace_those_of_the_urdf(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    read(tmp_path, three(soft(-0.5, 0.5), LIMIT.replace("/>", ' deceleration="1"/>')))
    limits = {"i": {"lower": -0.8, "velocity": 0.3}, "j": {"acceleration": 4.0}}
    first, second = Amendments(limits=limits).read(path)[0].joints
    assert (first.lower, first.upper, first.velocity) == (-0.8, 2.0, 0.3)
    assert (second.lower, second.acceleration, second.velocity) == (-1.0, 4.0, 1.0)


@optional.needs("real data", CASES.is_dir())
@pytest.mark.parametrize("name", ["quat", "capsule", "acceleration", "mast_follows", "locked"])
def test_public_variants_have_the_kinematics_of_their_plain_twin(name: str) -> None:
    folder = CASES / "robots"
    models = [Articulated(read_urdf(folder / f"{n}.urdf", actuated=True)) for n in ("plain", name)]
    rng = np.random.default_rng(0)
    for _ in range(5):
        values = {f"joint{k}": float(v) for k, v in enumerate(rng.uniform(-2.9, 2.9, 6))}
        one, other = (model.link_poses(values) for model in models)
        for link in ("link5", "palm") if name != "locked" else ("link5",):
            assert_allclose(one[link], other[link], atol=5e-6)  # their files have 6 digits
    assert len(models[1].joints) - len(models[0].joints) == (name == "mast_follows")


def test_calls_of_macros_that_xacro_left_are_left_out_and_named(tmp_path: Path) -> None:
    """Old versions of xacro leave properties, and calls of macros that they do not know."""
    path = tmp_path / "r.urdf"
    left = '<xacro:property name="PI" value="3"/><xacro:kinect parent="a"><origin/></xacro:kinect>'
    path.write_text(
        f'<robot name="r">{left}<!-- <xacro:macro name="m"/> --><link name="a"/></robot>'
    )
    (note,) = read_urdf(path).notes
    assert "<xacro:kinect> of <robot>" in note
    assert "left out" in note
    path.write_text(path.read_text().replace("xacro:kinect", "xacro:property"))
    assert read_urdf(path).notes == ()


@pytest.mark.parametrize("element", ['include filename="a"', 'macro name="m"', 'if value="1"'])
def test_a_file_that_needs_xacro_is_refused_with_what_to_do(tmp_path: Path, element: str) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(f'<robot name="r"><xacro:{element}/><link name="a"/></robot>')
    with pytest.raises(UrdfError, match=r"contains xacro macros; .*NAME\.urdf\.xacro"):
        read_urdf(path)
