"""Physics uses the resistances that planning assumes."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from tests.cupboards import FOLLOWERS, carcass, furniture_room, joint

from momapos.model.records.plans import JointResistance, Task
from momapos.model.robots.robot import load_robot
from momapos.model.scene.joint_resistance import known_resistance, resistance_along, weight_at
from momapos.model.scene.resistance_config import ResistanceConfig
from momapos.model.scene.scene import Scene
from momapos.simulation.config import ExecutionConfig, FurnitureConfig
from momapos.simulation.robot_dynamics import find_hand, read_dynamics
from momapos.simulation.simulated_room import draw_resistance, seal_of
from momapos.simulation.simulation import Simulation, build_simulation, set_followers

CONFIG = ResistanceConfig()
HINGE = joint("hinge", "revolute", ("body", "door"), (-0.26, 0, 0.1), (0, -1, 0), (0, 1.57))
DROP_DOOR = [
    carcass(),
    '<link name="door"><inertial><origin xyz="-0.02 0.05 0.4"/><mass value="9"/></inertial>'
    '<collision><origin xyz="0 0 0.3"/><geometry><box size="0.02 0.5 0.6"/></geometry></collision>'
    "</link>",
    HINGE,
]


def world_of(scene: Scene, name: str, to: float) -> Simulation:
    """Build the world of opening a part, drawn without a spread."""
    robot, item = load_robot("fetch"), scene.object("cupboard")
    drawn = draw_resistance(item, item.joint(name), FurnitureConfig(), np.random.default_rng(0))
    dynamics = read_dynamics(robot.model.urdf.path)
    return build_simulation(
        scene, robot, (-1.5, 0.0, 0.0), robot.home[None], Task("open", "cupboard", name, to),
        find_hand(robot, dynamics.mimics), dynamics, drawn, None, ExecutionConfig(),
    )  # fmt: skip


def weights(world: Simulation, values: np.ndarray) -> np.ndarray:
    found = []
    for value in values:
        world.data.qpos[world.part_q] = value
        set_followers(world.model, world.data.qpos)
        mujoco.mj_forward(world.model, world.data)
        found.append(world.weight_on_part)
    return np.array(found)


def test_a_part_weighs_in_physics_what_planning_assumes(tmp_path: Path) -> None:
    """Also with a center of mass that is not the middle of its shapes."""
    weighed = {"cupboard": {"hinge": JointResistance(balanced=False)}}
    scene = furniture_room(tmp_path, DROP_DOOR).with_resistance(weighed)
    values = np.linspace(0.0, 1.5, 7)
    expected = weight_at(scene.object("cupboard"), "hinge", values, CONFIG)
    assert expected[-1] > 9.0 * 9.81 * 0.35
    np.testing.assert_allclose(weights(world_of(scene, "hinge", 1.5), values), expected, atol=1e-3)


@pytest.mark.parametrize("kind", ["a folding door", "a lid that turns as its drawer slides"])
def test_links_that_follow_weigh_in_physics_what_planning_assumes(
    tmp_path: Path, kind: str
) -> None:
    parts, _, leader = FOLLOWERS[kind]
    scene = furniture_room(tmp_path, parts)
    upper = scene.object("cupboard").joint(leader).upper
    values = np.linspace(0.0, 0.9 * upper, 5)
    expected = weight_at(scene.object("cupboard"), leader, values, CONFIG)
    found = weights(world_of(scene, leader, upper), values)
    np.testing.assert_allclose(found, expected, atol=1e-2)


def test_friction_and_damping_of_the_file_act_in_physics(tmp_path: Path) -> None:
    hinge = HINGE.replace("</joint>", '<dynamics friction="30" damping="4"/></joint>')
    scene = furniture_room(tmp_path, [*DROP_DOOR[:2], hinge])
    world = world_of(scene, "hinge", 1.5)
    dof = world.model.joint("part").dofadr[0]
    assert world.model.dof_frictionloss[dof] == 30.0
    assert world.model.dof_damping[dof].item() == 4.0


def test_springs_bear_the_weight_of_a_drop_down_door(tmp_path: Path) -> None:
    balanced = furniture_room(tmp_path, DROP_DOOR)
    found = weights(world_of(balanced, "hinge", 1.5), np.linspace(0.0, 1.5, 4))
    np.testing.assert_allclose(found, 0.0, atol=1e-9)


def test_the_resistance_of_a_plan_is_that_of_its_run(tmp_path: Path) -> None:
    """A plan holds every value that the simulation draws from, and the lever of its seal."""
    assumed = ResistanceConfig(seal_force=21.0, latch_force=11.0, density=500.0, hinge_friction=1.5)
    scene = furniture_room(tmp_path, [carcass(), *DROP_DOOR[1:]])
    item = scene.object("cupboard")
    known = JointResistance(**{**known_resistance(item, "hinge", assumed).members(), "lever": 0.5})  # type: ignore[arg-type]
    item = scene.with_resistance({"cupboard": {"hinge": known}}).object("cupboard")
    drawn = draw_resistance(item, item.joint("hinge"), FurnitureConfig(), np.random.default_rng(0))
    assert (drawn.pull, drawn.friction, drawn.mass) == (11.0, 1.5, 9.0)
    seal, values = seal_of(item, item.joint("hinge"), drawn.pull, FurnitureConfig()), (0.0, 0.01)
    planned = resistance_along(item, "hinge", np.array([*values, 1.0]), 0.3, CONFIG).seal
    np.testing.assert_allclose([-seal.force(value) for value in values], planned[:2])


def test_the_catch_of_a_swing_door_pulls_it_back_from_both_sides(tmp_path: Path) -> None:
    swing = HINGE.replace('lower="0" upper="1.57"', 'lower="-1.57" upper="1.57"')
    item = furniture_room(tmp_path, [*DROP_DOOR[:2], swing]).object("cupboard")
    seal = seal_of(item, item.joint("hinge"), 6.0, FurnitureConfig())
    there = np.array([0.3, 0.6]) * seal.reach
    forces = np.array([seal.force(value) for value in there])
    assert (forces < 0.0).all()
    np.testing.assert_allclose([seal.force(-value) for value in there], -forces)
    assert seal.force(0.0) == 0.0
