"""Robot and furniture in the engine match their files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from tests.simulation.toy import toy
from tests.verification.door_case import make_case

from momapos.core.errors import UrdfError
from momapos.core.geometry.transforms import invert, pose_planar
from momapos.model.records.plans import Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.reader import Geometry
from momapos.simulation.config import ExecutionConfig
from momapos.simulation.geoms import Kind, masks
from momapos.simulation.robot_dynamics import find_hand, read_dynamics, volume
from momapos.simulation.simulated_robot import body_of
from momapos.simulation.simulated_room import PartResistance
from momapos.simulation.simulation import Simulation, build_simulation

BASE = (1.9, -1.6, 1.5)
LIGHT = PartResistance(mass=5.0, friction=0.1, damping=0.1, pull=0.0)


def world_of(
    robot: Robot, efforts: dict[str, float] | None = None, **options: object
) -> Simulation:
    """Build the small kitchen with a robot at the fridge; `efforts` replaces effort limits."""
    scene, task = load_scene("kitchen_small"), Task("open", "fridge", "door_hinge", 1.0)
    dynamics = read_dynamics(robot.model.urdf.path)  # type: ignore[arg-type]
    dynamics = replace(dynamics, efforts={**dynamics.efforts, **(efforts or {})})
    config = ExecutionConfig(**options)  # type: ignore[arg-type]
    hand = find_hand(robot, dynamics.mimics)
    return build_simulation(
        scene, robot, BASE, robot.home[None], task, hand, dynamics, LIGHT, None, config
    )


def test_link_poses_match_the_urdf(robot: Robot) -> None:
    world, rng = world_of(robot), np.random.default_rng(0)
    chain = robot.chain
    low, high = np.maximum(chain.lower, -3.0), np.minimum(chain.upper, 3.0)
    for _ in range(5):
        q = rng.uniform(low, high)
        world.data.qpos[world.arm_q] = q
        mujoco.mj_forward(world.model, world.data)
        poses = robot.model.link_poses(dict(zip(robot.arm_joints, q, strict=True)))
        T_world_root = pose_planar(np.array(BASE)) @ invert(poses[robot.base_link])
        for link, T in poses.items():
            body = world.model.body(body_of(link)).id
            np.testing.assert_allclose(world.data.xpos[body], (T_world_root @ T)[:3, 3], atol=1e-6)
            np.testing.assert_allclose(
                world.data.xmat[body].reshape(3, 3), (T_world_root @ T)[:3, :3], atol=1e-6
            )


def test_door_poses_match_the_scene_at_every_opening(segway: Robot, kitchen: Scene) -> None:
    world, item = world_of(segway), kitchen.object("fridge")
    for value in (0.0, 0.4, 1.2):
        world.data.qpos[world.part_q] = value
        mujoco.mj_forward(world.model, world.data)
        T = item.link_poses({"door_hinge": value})[item.model.joint("door_hinge").child]
        np.testing.assert_allclose(world.T_world_part, T, atol=1e-6)


def test_a_free_robot_at_home_has_no_contacts(robot: Robot) -> None:
    world = world_of(robot)
    assert (world.data.contact.efc_address < 0).all()


def test_a_robot_at_rest_does_not_move(robot: Robot) -> None:
    world = world_of(robot)
    mujoco.mj_step(world.model, world.data, nstep=250)
    np.testing.assert_allclose(world.data.qpos[world.arm_q], robot.home, atol=1e-4)
    np.testing.assert_allclose(world.data.qpos[world.base_q], 0.0, atol=1e-4)


def test_an_arm_heavier_than_its_effort_limits_is_balanced_and_does_not_move(fetch: Robot) -> None:
    assert world_of(fetch).balanced == ()
    world = world_of(fetch, {"torso_lift_joint": 30.0})
    assert world.balanced == ("torso_lift_joint",)
    mujoco.mj_step(world.model, world.data, nstep=250)
    np.testing.assert_allclose(world.data.qpos[world.arm_q], fetch.home, atol=1e-3)


def test_masses_match_the_urdf(robot: Robot) -> None:
    world = world_of(robot)
    for link, inertia in read_dynamics(robot.model.urdf.path).inertias.items():  # type: ignore[arg-type]
        assert world.model.body(body_of(link)).mass[0] == pytest.approx(inertia.mass)


def test_library_grippers_close_toward_their_center(robot: Robot) -> None:
    fingers = find_hand(robot, {}).fingers
    assert len(fingers) == 2
    assert all(f.closed != f.open for f in fingers)
    assert sum(abs(f.closed - f.open) for f in fingers) == pytest.approx(robot.opening, rel=0.05)


def test_collision_masks_are_symmetric() -> None:
    for touched in (False, True):
        for one in Kind:
            for other in Kind:
                (type_a, with_a), (type_b, with_b) = (
                    masks(kind, touched=touched) for kind in (one, other)
                )
                if {one, other} != {Kind.PAD, Kind.PART}:
                    assert bool(type_a & with_b) == bool(type_b & with_a)
                meet = bool(type_a & with_b) or bool(type_b & with_a)
                assert meet or {one, other} != {Kind.ARM, Kind.ROOM}


def test_furniture_that_touches_the_door_in_the_scene_does_not_block_it(tmp_path: Path) -> None:
    case = make_case()
    case.cupboard = case.cupboard.replace('xyz="-0.215', 'xyz="-0.209')
    done = toy(tmp_path, case).run()
    assert any("cupboard/body" in note for note in done.notes)
    assert done.success


def test_what_is_in_the_way_blocks_a_door_whatever_object_it_belongs_to(tmp_path: Path) -> None:
    size, place = "0.06 0.06 0.3", "-0.42 -0.15 -0.2"
    own = make_case()
    lump = (
        f'<collision><origin xyz="{place}"/><geometry><box size="{size}"/></geometry></collision>'
    )
    own.cupboard = own.cupboard.replace('<link name="body">', f'<link name="body">{lump}')
    assert not toy(tmp_path / "own", own).run().success
    other = make_case()
    at = np.array(place.split(), float) + np.array([0.4, 0.0, 0.8])  # where the cupboard stands
    other.obstacle([float(v) for v in size.split()], at.tolist())
    assert not toy(tmp_path / "other", other).run().success
    assert toy(tmp_path / "free").run().success


@pytest.mark.parametrize(
    ("shape", "mesh"),
    [
        (Geometry("box", (0.2, 0.3, 0.5), np.eye(4)), trimesh.creation.box((0.2, 0.3, 0.5))),
        (
            Geometry("cylinder", (0.1, 0.4), np.eye(4)),
            trimesh.creation.cylinder(0.1, 0.4, sections=256),
        ),
        (Geometry("sphere", (0.2,), np.eye(4)), trimesh.creation.icosphere(4, 0.2)),
    ],
)
def test_volumes_match_meshes(shape: Geometry, mesh: trimesh.Trimesh) -> None:
    assert volume(shape) == pytest.approx(mesh.volume, rel=0.01)


def test_the_volume_of_a_mesh_is_that_of_its_hull(tmp_path: Path) -> None:
    trimesh.creation.box((0.2, 0.3, 0.5)).export(tmp_path / "box.stl")
    shape = Geometry("mesh", (1.0, 1.0, 2.0), np.eye(4), mesh=tmp_path / "box.stl")
    assert volume(shape) == pytest.approx(0.2 * 0.3 * 0.5 * 2.0, rel=1e-4)


@pytest.mark.parametrize("value", ["nan", "-3", "1e30", "heavy"])
def test_an_invalid_mass_is_refused(value: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(
        '<robot name="r"><link name="a">'
        f'<inertial><mass value="{value}"/></inertial></link></robot>'
    )
    with pytest.raises(UrdfError, match="mass"):
        read_dynamics(path)


def own_world(folder: Path, element: str, lower: float = 0.0) -> Simulation:
    """Build the toy cupboard with one more element that stands still, for opening its door."""
    case = make_case()
    case.cupboard = case.cupboard.replace("</link>", f"{element}</link>", 1).replace(
        'lower="0"', f'lower="{lower}"'
    )
    t = toy(folder, case)
    dynamics = read_dynamics(folder / "robot.urdf")
    hand = find_hand(t.robot, dynamics.mimics)
    config = ExecutionConfig(hold="weld")
    return build_simulation(
        t.scene, t.robot, (-3.0, 0.0, 0.0), t.robot.home[None], t.task, hand, dynamics, LIGHT, None,
        config,
    )  # fmt: skip


def final_opening(world: Simulation, torque: float) -> float:
    """Turn the door by a constant torque for a second [rad]."""
    for _ in range(int(1.0 / world.model.opt.timestep)):
        world.data.qfrc_applied[world.part_v] = torque
        mujoco.mj_step(world.model, world.data)
    return float(world.data.qpos[world.part_q])


def test_a_part_that_rests_on_what_is_in_its_way_does_not_pass_it(tmp_path: Path) -> None:
    flush = (  # with the door's front, far from its hinge
        '<collision><origin xyz="-0.235 0.2 0"/><geometry><box size="0.02 0.1 0.5"/></geometry>'
        "</collision>"
    )
    free = final_opening(own_world(tmp_path / "free", ""), 8.0)
    blocked = final_opening(own_world(tmp_path / "blocked", flush), 8.0)
    assert free > 0.9
    assert blocked < 0.1


def test_a_part_stops_where_it_is_closed_if_its_file_lets_it_go_on(tmp_path: Path) -> None:
    closed = final_opening(own_world(tmp_path, "", lower=-0.04), -8.0)
    assert closed == pytest.approx(0.0, abs=0.005)
