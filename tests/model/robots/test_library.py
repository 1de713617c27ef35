"""Library robots match their manufacturers' files and the rules of robot files.

Everything is computed here from the files alone: pinocchio and coal for kinematics and contact,
a few lines of numpy for the distance to boxes, cylinders and spheres.
"""

from __future__ import annotations

import importlib.util
import itertools
import re
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from tests import optional
from tests.real import DATA

LIBRARY = Path(__file__).parents[3] / "src" / "momapos" / "model" / "robots" / "library"
SCENE_IO = DATA.parent / "tools" / "scene_io.py"
ROBOTS = (
    "fetch", "hsr", "husky_ur5e", "mobile_panda", "ranger_rm63", "segway_ur5e", "stretch", "tiago",
)  # fmt: skip

COVERED = 0.010
"""Maximum distance of a manufacturer's mesh vertex from the shapes [m]."""
CLEAR = 0.010
"""Minimum distance between links at home [m]."""


# ------------------------------------------------------------------------------------ files


@dataclass(frozen=True)
class Shape:
    """A box, cylinder or sphere of a link."""

    kind: str
    size: np.ndarray
    T_link_shape: np.ndarray

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points in the link frame; negative inside."""
        p = (points - self.T_link_shape[:3, 3]) @ self.T_link_shape[:3, :3]
        if self.kind == "sphere":
            return np.linalg.norm(p, axis=1) - self.size[0]
        if self.kind == "box":
            gap = np.abs(p) - self.size / 2
        else:
            radial = np.hypot(p[:, 0], p[:, 1]) - self.size[0]
            gap = np.stack([radial, np.abs(p[:, 2]) - self.size[1] / 2], axis=1)
        return np.linalg.norm(np.maximum(gap, 0), axis=1) + np.minimum(gap.max(axis=1), 0)

    def support(self, T_frame_link: np.ndarray, direction: np.ndarray) -> float:
        """Return the support of the shape along a unit vector in the same frame [m]."""
        T = T_frame_link @ self.T_link_shape
        d = direction @ T[:3, :3]
        if self.kind == "sphere":
            reach = self.size[0]
        elif self.kind == "box":
            reach = np.abs(d) @ self.size / 2
        else:
            reach = self.size[0] * np.hypot(d[0], d[1]) + abs(d[2]) * self.size[1] / 2
        return float(direction @ T[:3, 3] + reach)


class Urdf:
    """The parts of a URDF that the tests need."""

    def __init__(self, path: Path) -> None:
        self.path = path
        text = re.sub(r"\$\(optenv\s+\S+\s+([^)]*)\)", r"\1", path.read_text())
        self.root = ET.fromstring(text)
        self.links = {link.get("name", ""): link for link in self.root.findall("link")}
        self.joints = {joint.get("name", ""): joint for joint in self.root.findall("joint")}
        self.above = {joint.find("child").get("link"): joint for joint in self.joints.values()}

    @cached_property
    def model(self) -> pin.Model:
        return pin.buildModelFromXML(ET.tostring(self.root, encoding="unicode"))

    def leader(self, joint: str) -> str:
        """Return the joint that a joint follows one to one; "" for none."""
        mimic = self.joints[joint].find("mimic")
        if mimic is None:
            return ""
        return mimic.get("joint", "")

    def ratio(self, joint: str) -> float:
        """Return how far a joint moves with the one that it follows."""
        mimic = self.joints[joint].find("mimic")
        if mimic is None:
            return 1.0
        assert mimic.get("offset", "0") == "0"
        return float(mimic.get("multiplier", "1"))

    def parent(self, link: str) -> str:
        return self.above[link].find("parent").get("link")

    def rest_pose(self, link: str, anchor: str | None = None) -> np.ndarray:
        """Return the pose of a link in an ancestor (None for the root), all joints at zero."""
        T = np.eye(4)
        while link != anchor and link in self.above:
            T, link = pose_of(self.above[link]) @ T, self.parent(link)
        assert anchor in (None, link)
        return T

    def shapes(self, link: str, tag: str = "collision") -> list[Shape]:
        found = []
        for item in self.links[link].findall(tag):
            geometry = item.find("geometry")[0]
            keys = {"box": ["size"], "sphere": ["radius"], "cylinder": ["radius", "length"]}
            size = [float(v) for k in keys[geometry.tag] for v in geometry.get(k).split()]
            found.append(Shape(geometry.tag, np.array(size), pose_of(item)))
        return found

    def vertices(self, link: str, tag: str) -> np.ndarray:
        """Return the mesh vertices of a link, in its frame."""
        clouds = [np.empty((0, 3))]
        for item in self.links[link].findall(tag):
            geometry = item.find("geometry")[0]
            if geometry.tag == "mesh":
                points = mesh_vertices(self.mesh(geometry.get("filename")))
                points = points * np.array(geometry.get("scale", "1 1 1").split(), float)
                clouds.append(transform(pose_of(item), points))
        return np.concatenate(clouds)

    def mesh(self, name: str) -> Path:
        """Return the file of a mesh; packages are siblings of the URDF's own package."""
        inside = name.removeprefix("package://example-robot-data/robots/")
        return self.path.parents[2] / inside if inside != name else self.path.parent / name

    def pose(self, link: str, base: str, q: Mapping[str, float]) -> np.ndarray:
        """Return the pose of a link in the frame of another, by pinocchio."""
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, configuration(self.model, q))
        frames = [data.oMf[self.model.getFrameId(n, pin.FrameType.BODY)] for n in (base, link)]
        return frames[0].actInv(frames[1]).homogeneous


def configuration(model: pin.Model, q: Mapping[str, float]) -> np.ndarray:
    """Return pinocchio's configuration for some joint values, the others at zero."""
    full = pin.neutral(model)
    for name, value in q.items():
        joint = model.joints[model.getJointId(name)]
        turn = [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
        full[joint.idx_q : joint.idx_q + joint.nq] = turn
    return full


def pose_of(element: ET.Element) -> np.ndarray:
    origin, T = element.find("origin"), np.eye(4)
    if origin is not None:
        xyz, rpy = (np.array(origin.get(k, "0 0 0").split(), float) for k in ("xyz", "rpy"))
        T[:3, :3], T[:3, 3] = pin.rpy.rpyToMatrix(rpy), xyz
    return T


def transform(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ T[:3, :3].T + T[:3, 3]


def mesh_vertices(path: Path) -> np.ndarray:
    if path.suffix.lower() == ".obj":
        lines = path.read_text(errors="replace").splitlines()
        return np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)
    return np.asarray(trimesh.load(path, force="mesh", process=False).vertices)


class Robot:
    """A robot of the library."""

    def __init__(self, name: str) -> None:
        self.folder = LIBRARY / name
        self.table: dict[str, Any] = tomllib.loads((self.folder / f"{name}.toml").read_text())
        self.urdf = Urdf(self.folder / self.table["urdf"])
        srdf = ET.parse(self.urdf.path.with_suffix(".srdf")).getroot()
        self.disabled = {
            frozenset((e.get("link1", ""), e.get("link2", ""))): e.get("reason", "")
            for e in srdf.iter("disable_collisions")
        }
        self.leaders: list[str] = self.table["arm_joints"]
        self.arm = [
            name
            for name in self.urdf.joints
            if name in self.leaders or self.urdf.leader(name) in self.leaders
        ]
        self.home = self.state(dict(zip(self.leaders, self.table["home"], strict=True)))

    def state(self, q: Mapping[str, float]) -> dict[str, float]:
        """Return the values of all arm joints, including followers."""
        return {
            name: q.get(name, self.urdf.ratio(name) * q.get(self.urdf.leader(name), 0.0))
            for name in self.arm
        }

    def body(self, link: str) -> str:
        """Return the link that a link is fixed to, with wheels, casters and fingers at zero."""
        while link in self.urdf.above:
            joint = self.urdf.above[link]
            held = joint.get("type") in ("fixed", "continuous", "prismatic")
            if joint.get("name") in self.arm or not held:
                break
            link = self.urdf.parent(link)
        return link

    def on_base(self, link: str) -> bool:
        while link in self.urdf.above:
            if self.urdf.above[link].get("name") in self.arm:
                return False
            link = self.urdf.parent(link)
        return True

    def body_shapes(self, body: str) -> list[Shape]:
        """Return the shapes of everything fixed to a body, in its frame."""
        return [
            Shape(s.kind, s.size, self.urdf.rest_pose(link, body) @ s.T_link_shape)
            for link in self.urdf.links
            if self.body(link) == body
            for s in self.urdf.shapes(link)
        ]

    def base_shapes(self) -> list[tuple[np.ndarray, Shape]]:
        root = self.table["base_link"]
        return [
            (self.urdf.rest_pose(link, root), shape)
            for link in self.urdf.links
            if self.on_base(link)
            for shape in self.urdf.shapes(link)
        ]


@lru_cache
def robot_named(name: str) -> Robot:
    return Robot(name)


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> Robot:
    return robot_named(request.param)


# ---------------------------------------------------------------------------- manufacturers

BESTMAN = DATA / "bestman" / "Asset" / "Robot" / "mobile_manipulator"
FETCH = DATA / "robots" / "fetch" / "fetch.urdf"
HUSKY = DATA / "robots" / "husky" / "husky.urdf"
UR5E = BESTMAN / "arm/universal/urdf/ur5e_vacuum_long.urdf"
RM63 = BESTMAN / "arm/realman/urdf/rm63_6f_ag95.urdf"
ROBOTIQ = BESTMAN / "end_effector/gripper/robotiq_2f85/urdf/robotiq_2f85.urdf"
RANGER = BESTMAN / "base/ranger_mini_v3/urdf/ranger_mini_v3.urdf"
PILLAR = BESTMAN / "base/ranger_mini_v3_with_pillar/urdf/ranger_mini_v3_with_pillar.urdf"
SEGBOT = BESTMAN / "base/segbot/urdf/segbot.urdf"


def installed(distribution: str, path: str) -> Path:
    """Return a file of a robot description package; a missing file if it is not installed."""
    try:
        return Path(str(metadata.distribution(distribution).locate_file(path)))
    except metadata.PackageNotFoundError:
        return Path(distribution) / "missing"


EXAMPLES = installed("example-robot-data", "cmeel.prefix/share/example-robot-data/robots")
PANDA = EXAMPLES / "panda_description" / "urdf" / "panda.urdf"
TIAGO = EXAMPLES / "tiago_description" / "robots" / "tiago_no_hand.urdf"
STRETCH = installed(
    "hello-robot-stretch-urdf",
    "stretch_urdf/SE3/stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf",
)


def moved(x: float = 0, y: float = 0, z: float = 0, yaw: float = 0) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = pin.rpy.rpyToMatrix(0, 0, yaw), (x, y, z)
    return T


@dataclass(frozen=True)
class Part:
    """Links of a manufacturer's file at rest, and their place in our robot."""

    urdf: Path
    links: Sequence[str]
    """Links of the manufacturer."""
    anchor: str = ""
    """Manufacturer's link that coincides with ours; "" for each link itself."""
    ours: str = ""
    """Our link; "" for the same name."""
    T_ours_anchor: np.ndarray = field(default_factory=lambda: np.eye(4))
    tag: str = "collision"


def both_sides(links: Sequence[str]) -> list[str]:
    return [f"{side}_{link}" for side in ("left", "right") for link in links]


_2F85 = ["outer_knuckle", "outer_finger", "inner_knuckle", "inner_finger"]
_UR5E = [
    Part(UR5E, ["base_link"], ours="ur5e_base_link"),
    Part(UR5E, ["shoulder_link", "upper_arm_link", "forearm_link"]),
    Part(UR5E, ["wrist_1_link", "wrist_2_link", "wrist_3_link"]),
    Part(
        ROBOTIQ,
        ["robotiq_85_base_link", *both_sides(_2F85)],
        "robotiq_85_base_link",
        "gripper_base_link",
        moved(yaw=np.pi / 2),
    ),
]
_BASE = ["base_link", "r_wheel_link", "l_wheel_link", "torso_fixed_link", "torso_lift_link"]
_BASE += ["bellows_link2", "head_pan_link", "head_tilt_link"]
_ARM = ["shoulder_pan", "shoulder_lift", "upperarm_roll", "elbow_flex", "forearm_roll"]
_ARM += ["wrist_flex", "wrist_roll", "gripper"]
_AG95 = ["crank", "rod", "proximal_phalanx", "distal_phalanx"]
_HUSKY = ["base_link", "top_plate_link", "user_rail_link", "front_bumper_link", "rear_bumper_link"]
_HUSKY += [f"{end}_{side}_wheel_link" for end in ("front", "rear") for side in ("left", "right")]
_SEGBOT = ["base_link", "plate_link", "base_caster_support_link", "caster_wheel_link"]
_SEGBOT += ["left_wheel_link", "right_wheel_link"]
_SG3 = ("link_gripper_s3_body", "link_gripper_s3_body")


def both_tips(side: str) -> list[str]:
    return [f"link_gripper_finger_{side}", f"link_gripper_fingertip_{side}"]


_HAND = ("panda_hand", "panda_hand")
PARTS = {
    "fetch": [
        Part(FETCH, [*_BASE, *(f"{name}_link" for name in _ARM)]),
        Part(FETCH, ["laser_link", "estop_link"], "base_link", "base_link"),
        # At zero their fingers are closed: each opens by 0.05 m.
        Part(FETCH, ["r_gripper_finger_link"], "gripper_link", "gripper_link", moved(y=0.05)),
        Part(FETCH, ["l_gripper_finger_link"], "gripper_link", "gripper_link", moved(y=-0.05)),
    ],
    "segway_ur5e": [Part(SEGBOT, _SEGBOT, "base_link", "chassis_link"), *_UR5E],
    # The Husky's own collision shapes are a box and cylinders; its meshes are the visual ones.
    "husky_ur5e": [Part(HUSKY, _HUSKY, "base_link", "chassis_link", tag="visual"), *_UR5E],
    "mobile_panda": [
        Part(SEGBOT, _SEGBOT, "base_link", "chassis_link"),
        Part(PANDA, [*(f"panda_link{i}" for i in range(8)), "panda_hand"]),
        # At zero their fingers are closed: each opens by 0.04 m.
        Part(PANDA, ["panda_leftfinger"], *_HAND, moved(y=0.04), "visual"),
        Part(PANDA, ["panda_rightfinger"], *_HAND, moved(y=-0.04), "visual"),
    ],
    "stretch": [
        Part(STRETCH, ["base_link", "link_right_wheel", "link_left_wheel", "laser", "link_mast"]),
        Part(STRETCH, ["link_head", "link_head_pan", "link_head_tilt", "link_head_nav_cam"]),
        Part(STRETCH, ["link_lift", *(f"link_arm_l{i}" for i in range(5)), "link_wrist_yaw"]),
        Part(STRETCH, ["link_wrist_yaw_bottom", "link_wrist_pitch", "link_wrist_roll"]),
        Part(STRETCH, ["link_gripper_s3_body"]),
        # At zero their fingers are closed: each opens by 0.06 m.
        Part(STRETCH, both_tips("left"), *_SG3, moved(x=0.06)),
        Part(STRETCH, both_tips("right"), *_SG3, moved(x=-0.06)),
    ],
    "tiago": [
        Part(TIAGO, ["base_link", "torso_lift_link", "head_1_link", "head_2_link"]),
        Part(TIAGO, [f"arm_{i}_link" for i in range(1, 7)]),
    ],
    "ranger_rm63": [
        Part(RANGER, ["base_link"], ours="chassis_link", T_ours_anchor=moved(z=0.14)),
        Part(PILLAR, ["arm_base", "front_lidar", "head_Link", "head_camera", "Link7"]),
        Part(RM63, [f"Link{i}" for i in range(1, 7)]),
        Part(
            RM63,
            ["dh_robotics_ag95_base_link", *both_sides(_AG95)],
            "dh_robotics_ag95_base_link",
            "gripper_base_link",
        ),
    ],
}


@lru_cache
def manufacturer(path: Path) -> Urdf:
    return Urdf(optional.there(path, "real data" if DATA in path.parents else "robot descriptions"))


def random_states(robot: Robot, count: int) -> list[dict[str, float]]:
    rng = np.random.default_rng(0)
    limits = {name: limits_of(robot.urdf.joints[name]) for name in robot.leaders}
    return [
        robot.state({name: rng.uniform(*limit) for name, limit in limits.items()})
        for _ in range(count)
    ]


def limits_of(joint: ET.Element) -> tuple[float, float]:
    if joint.get("type") == "continuous":
        return -np.pi, np.pi
    limit = joint.find("limit")
    return float(limit.get("lower")), float(limit.get("upper"))


def assert_same_pose(a: np.ndarray, b: np.ndarray) -> None:
    assert np.linalg.norm(a[:3, 3] - b[:3, 3]) < 1e-6
    assert np.linalg.norm(pin.log3(a[:3, :3].T @ b[:3, :3])) < 1e-6


def test_fetch_gripper_poses_match_the_manufacturer() -> None:
    ours, theirs = robot_named("fetch"), manufacturer(FETCH)
    for q in random_states(ours, 200):
        pair = [u.pose("gripper_link", "base_link", q) for u in (ours.urdf, theirs)]
        assert_same_pose(*pair)


@pytest.mark.parametrize(
    ("name", "file", "base", "flange"),
    [
        ("mobile_panda", PANDA, "panda_link0", "panda_hand_tcp"),
        ("stretch", STRETCH, "base_link", "link_gripper_s3_body"),
        ("tiago", TIAGO, "base_footprint", "wrist_ft_tool_link"),
    ],
)
def test_arms_match_the_installed_descriptions(
    name: str, file: Path, base: str, flange: str
) -> None:
    ours, theirs = robot_named(name), manufacturer(file)
    for q in random_states(ours, 200):
        assert_same_pose(ours.urdf.pose(flange, base, q), theirs.pose(flange, base, q))
    for joint in ours.arm:
        assert limits_of(ours.urdf.joints[joint]) == limits_of(theirs.joints[joint])


@pytest.mark.parametrize(
    ("q", "position"),
    [
        ({}, (0.158, 0.078, 0.8255)),
        ({"arm_lift_joint": 0.5}, (0.158, 0.078, 1.3255)),
        ({"arm_flex_joint": -np.pi / 2}, (0.141 + 0.345 + 0.1405, 0.078, 0.34 - 0.017)),
        ({"wrist_flex_joint": -np.pi / 2}, (0.146 + 0.1405, 0.078, 0.685 - 0.012)),
        ({"arm_roll_joint": -np.pi / 2, "wrist_flex_joint": -np.pi / 2},
         (0.146, 0.078 - 0.1405, 0.685 - 0.012)),
    ],
)  # fmt: skip
def test_hsr_palm_positions_follow_from_the_published_link_lengths(
    q: Mapping[str, float], position: tuple[float, float, float]
) -> None:
    """Link lengths as in Toyota's hsr_description, which no package index serves."""
    robot = robot_named("hsr")
    T = robot.urdf.pose("hand_palm_link", "base_link", robot.state(q))
    assert np.abs(T[:3, 3] - position).max() < 1e-9


def test_the_head_of_hsr_rises_half_as_far_as_its_shoulder() -> None:
    robot = robot_named("hsr")
    raised = robot.state({"arm_lift_joint": 0.6})
    rise = [
        (robot.urdf.pose(link, "base_link", raised) - robot.urdf.rest_pose(link))[2, 3]
        for link in ("head_pan_link", "arm_flex_link")
    ]
    assert rise == pytest.approx([0.3, 0.6])


@pytest.mark.parametrize("name", ["segway_ur5e", "husky_ur5e"])
def test_ur5e_flange_poses_match_the_manufacturer(name: str) -> None:
    ours, theirs = robot_named(name), manufacturer(UR5E)
    for q in random_states(ours, 200):
        T = ours.urdf.pose("ee_link", "ur5e_base_link", q)
        assert_same_pose(T, theirs.pose("ee_link", "base_link", q))


def test_rm63_hand_poses_match_the_manufacturers() -> None:
    """Combine two files with the joint between them, whose origin is in neither.

    `rm63_6f_ag95.urdf` starts at Link1 and counts from there, so that its joint1 is our joint2.
    The origin of joint1 is that of the authors' `cobot_description_rm_63.urdf`.
    """
    ours, base, arm = robot_named("ranger_rm63"), manufacturer(PILLAR), manufacturer(RM63)
    T_link7_joint1 = np.eye(4)
    T_link7_joint1[:3, :3] = pin.rpy.rpyToMatrix(1.5708, 0, -1.5708)
    T_link7_joint1[:3, 3] = -0.18, 0, -0.059
    for q in random_states(ours, 200):
        rotary = {"joint_arm_rotary": q["joint_arm_rotary"]}
        rest = {f"joint{i}": q[f"joint{i + 1}"] for i in range(1, 6)}
        T = base.pose("Link7", "base_link", rotary) @ T_link7_joint1 @ moved(yaw=q["joint1"])
        T = T @ arm.pose("dh_robotics_ag95_base_link", "Link1", rest)
        assert_same_pose(ours.urdf.pose("gripper_base_link", "chassis_link", q), T)


@pytest.mark.parametrize("name", sorted(PARTS))
def test_manufacturers_mesh_vertices_are_inside_or_within_1_cm_of_the_shapes(name: str) -> None:
    robot = robot_named(name)
    for part in PARTS[name]:
        theirs = manufacturer(part.urdf)
        for link in part.links:
            ours = part.ours or link
            T = part.T_ours_anchor @ theirs.rest_pose(link, part.anchor or link)
            points = transform(T, theirs.vertices(link, part.tag))
            body = robot.body(ours)
            points = transform(robot.urdf.rest_pose(ours, body), points)
            assert len(points), f"{link} has no mesh"
            outside = np.min([s.distance(points) for s in robot.body_shapes(body)], axis=0).max()
            assert outside < COVERED, f"{link} protrudes by {1000 * outside:.1f} mm"


# ------------------------------------------------------------------------- the robot files


def test_the_library_contains_shapes_and_no_meshes(robot: Robot) -> None:
    # Arms of fewer than six joints have no reachability map.
    files = {".urdf", ".toml", ".srdf"} | ({".reach"} if len(robot.leaders) >= 6 else set())
    assert {path.suffix for path in robot.folder.iterdir()} == files
    tags = {geometry[0].tag for geometry in robot.urdf.root.iter("geometry")}
    assert tags <= {"box", "cylinder", "sphere"}
    for link in robot.urdf.links:
        seen, checked = robot.urdf.shapes(link, "visual"), robot.urdf.shapes(link)
        assert [s.size.tolist() for s in seen] == [s.size.tolist() for s in checked]


def test_lower_limits_are_below_upper_limits(robot: Robot) -> None:
    for name, joint in robot.urdf.joints.items():
        if joint.get("type") in ("revolute", "prismatic"):
            lower, upper = limits_of(joint)
            assert lower < upper, name


def test_every_mass_has_a_physical_inertia(robot: Robot) -> None:
    for name, link in robot.urdf.links.items():
        if link.find("inertial") is None:
            assert not robot.urdf.shapes(name)
            continue
        values = {k: float(v) for k, v in link.find("inertial/inertia").items()}
        a, b, c = (values[k] for k in ("ixy", "ixz", "iyz"))
        x, y, z = np.linalg.eigvalsh(
            [[values["ixx"], a, b], [a, values["iyy"], c], [b, c, values["izz"]]]
        )
        assert x > 0, name
        assert x + y > z, name
        assert float(link.find("inertial/mass").get("value")) > 0


def test_the_base_stands_on_the_floor(robot: Robot) -> None:
    lowest = min(-s.support(T, np.array([0, 0, -1.0])) for T, s in robot.base_shapes())
    assert abs(lowest) < 0.002


def test_the_footprint_is_convex_counterclockwise_and_covers_the_base_tightly(robot: Robot) -> None:
    polygon = np.array(robot.table["base"]["footprint"])
    assert 6 <= len(polygon) <= 16
    edges = np.roll(polygon, -1, axis=0) - polygon
    after = np.roll(edges, -1, axis=0)
    assert (edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0] > 0).all()
    shapes = robot.base_shapes()
    for corner, edge in zip(polygon, edges, strict=True):
        normal = np.array([edge[1], -edge[0], 0]) / np.linalg.norm(edge)
        reach = max(shape.support(T, normal) for T, shape in shapes) - normal[:2] @ corner
        assert -0.005 < reach < 0.001


def test_the_pads_are_the_opening_apart_with_the_tool_frame_between_them(robot: Robot) -> None:
    tool, urdf = robot.table["tool"], robot.urdf
    approach, closing = (np.array(tool[k]) for k in ("approach_axis", "closing_axis"))
    assert abs(approach @ closing) < 1e-12
    fingers = [link for link in robot.table["gripper_links"] if "finger" in link]
    sides = []
    for finger in fingers:
        T_tool_finger = np.linalg.inv(urdf.rest_pose(robot.table["tool_link"]))
        T_tool_finger = T_tool_finger @ urdf.rest_pose(finger)
        point = np.linalg.inv(T_tool_finger)[:3, 3][None]
        gap = min(shape.distance(point)[0] for shape in urdf.shapes(finger))
        assert abs(gap - tool["opening"] / 2) < 0.001
        middle = np.mean([(T_tool_finger @ s.T_link_shape)[:3, 3] for s in urdf.shapes(finger)], 0)
        axis = np.array(urdf.above[finger].find("axis").get("xyz").split(), float)
        axis = np.linalg.inv(urdf.rest_pose(robot.table["tool_link"]))[:3, :3] @ (
            urdf.rest_pose(finger)[:3, :3] @ axis
        )
        assert np.sign(axis @ closing) == -np.sign(middle @ closing), "positive must close"
        sides.append(np.sign(middle @ closing))
    assert sorted(sides) == [-1, 1]


# ------------------------------------------------------------------------------- contact


class Contact:
    """Distances between links of a robot, computed by coal."""

    def __init__(self, robot: Robot) -> None:
        self.model = robot.urdf.model
        self.geometry = pin.buildGeomFromUrdf(
            self.model, str(robot.urdf.path), pin.GeometryType.COLLISION
        )
        objects = self.geometry.geometryObjects
        self.links = [self.model.frames[o.parentFrame].name for o in objects]

    def watch(self, pairs: Sequence[frozenset[str]]) -> None:
        self.geometry.removeAllCollisionPairs()
        wanted = set(pairs)
        for i, j in itertools.combinations(range(len(self.links)), 2):
            if frozenset((self.links[i], self.links[j])) in wanted:
                self.geometry.addCollisionPair(pin.CollisionPair(i, j))
        self.data, self.state = pin.GeometryData(self.geometry), self.model.createData()

    def nearest(self, q: Mapping[str, float]) -> tuple[float, str]:
        full = configuration(self.model, q)
        pin.computeDistances(self.model, self.state, self.geometry, self.data, full)
        distances = [r.min_distance for r in self.data.distanceResults]
        i = int(np.argmin(distances))
        pair = self.geometry.collisionPairs[i]
        return distances[i], f"{self.links[pair.first]} and {self.links[pair.second]}"


def all_pairs(robot: Robot) -> list[frozenset[str]]:
    links = [link for link in robot.urdf.links if robot.urdf.shapes(link)]
    return [frozenset(pair) for pair in itertools.combinations(links, 2)]


def test_home_is_within_the_limits_and_free_of_self_contact(robot: Robot) -> None:
    for name, value in robot.home.items():
        lower, upper = limits_of(robot.urdf.joints[name])
        assert lower <= value <= upper
    contact = Contact(robot)
    contact.watch([pair for pair in all_pairs(robot) if pair not in robot.disabled])
    distance, pair = contact.nearest(robot.home)
    assert distance > CLEAR, pair


def test_at_home_the_arm_stays_within_10_cm_of_the_footprint(robot: Robot) -> None:
    polygon = np.array(robot.table["base"]["footprint"])
    edges = np.roll(polygon, -1, axis=0) - polygon
    for link in robot.urdf.links:
        if robot.on_base(link):
            continue
        T = robot.urdf.pose(link, robot.table["base_link"], robot.home)
        for shape, (corner, edge) in itertools.product(
            robot.urdf.shapes(link), zip(polygon, edges, strict=True)
        ):
            normal = np.array([edge[1], -edge[0], 0]) / np.linalg.norm(edge)
            assert shape.support(T, normal) - normal[:2] @ corner < 0.1, link


def test_pairs_with_reason_never_have_no_contact_in_random_states(robot: Robot) -> None:
    known = set(all_pairs(robot))
    assert set(robot.disabled) <= known
    assert set(robot.disabled.values()) <= {"Adjacent", "Default", "Never"}
    contact = Contact(robot)
    contact.watch([pair for pair, reason in robot.disabled.items() if reason == "Never"])
    for q in random_states(robot, 200):
        distance, pair = contact.nearest(q)
        assert distance > 0, pair


@lru_cache
def shared_reader() -> ModuleType:
    path = optional.there(SCENE_IO, "independent checker")
    spec = importlib.util.spec_from_file_location("shared_scene_io", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_independent_checker_agrees_about_the_robot(robot: Robot) -> None:
    reader, table = shared_reader(), robot.table
    theirs = reader.Robot(robot.urdf.path, table["base_link"], table["tool_link"], robot.arm)
    for q in random_states(robot, 20):
        T, _ = theirs.place(list(q.values()), np.eye(4))
        assert_same_pose(T, robot.urdf.pose(table["tool_link"], table["base_link"], q))
    names = [geom.link for geom in theirs.art.geoms]
    assert {names[i] for i in theirs.base_geoms} == {n for n in names if robot.on_base(n)}
    last = {names[i] for i in theirs.gripper}
    assert {n for n in table["gripper_links"] if robot.urdf.shapes(n)} <= last
    _, poses = theirs.place(list(robot.home.values()), np.eye(4))
    geoms = theirs.art.geoms
    for i, j in theirs.self_pairs:
        gap = reader.signed_distance(geoms[i].shape, *poses[i], geoms[j].shape, *poses[j])
        assert gap > CLEAR, f"{names[i]} and {names[j]}"
