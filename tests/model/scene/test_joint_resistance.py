"""Resistance of parts along their motion: seal, friction, weight, masses and names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import (
    BAR,
    DOOR,
    FOLLOWERS,
    HINGE,
    SLIDE,
    carcass,
    furniture_room,
    joint,
    link,
    tray,
)

from momapos.core.errors import InputError, UrdfError
from momapos.core.units import GRAVITY
from momapos.model.records.plans import JointResistance
from momapos.model.scene.joint_resistance import (
    assumes_springs,
    has_seal,
    known_resistance,
    object_mass,
    part_masses,
    resistance_along,
    stays_in_place,
    weight_at,
)
from momapos.model.scene.resistance_config import ResistanceConfig
from momapos.model.scene.scene_object import SceneObject

CONFIG = ResistanceConfig()
SLOW = ResistanceConfig(hand_speed=0.0)
OPENING = np.linspace(0.0, 1.5, 61)
DROP_DOOR = joint("hinge", "revolute", ("body", "door"), (-0.26, 0, 0.1), (0, -1, 0), (0, 1.57))
LIFT_DOOR = joint("hinge", "revolute", ("body", "door"), (-0.26, 0, 0.8), (0, 1, 0), (0, 1.57))


def door_of(height: float, mass: float = 0.0, z: float = 0.0) -> str:
    """Return a door that reaches from its hinge to a height, with a mass in its middle."""
    inertial = f'<inertial><origin xyz="0 0 {z}"/><mass value="{mass}"/></inertial>'
    return (
        f'<link name="door">{inertial if mass else ""}<collision><origin xyz="0 0 {height / 2}"/>'
        f'<geometry><box size="0.02 0.5 {abs(height)}"/></geometry></collision></link>'
    )


def cupboard(folder: Path, *parts: str, **changes: object) -> SceneObject:
    item = furniture_room(folder, [carcass(), *parts]).object("cupboard")
    return replace(item, **changes)  # type: ignore[arg-type]


def weighed(item: SceneObject) -> SceneObject:
    """Return an object whose hinge has no springs."""
    return replace(item, resistance={"hinge": JointResistance(balanced=False)})


def test_a_seal_resists_only_the_opening_of_the_nearly_closed_door(tmp_path: Path) -> None:
    item, values = cupboard(tmp_path, DOOR, HINGE, category="fridge"), np.linspace(0, 0.1, 101)
    found = resistance_along(item, "hinge", values, 0.5, CONFIG)
    assert found.seal[0] == pytest.approx(30.0 * 0.5)
    travel = 0.5 * values
    assert (found.seal[travel >= CONFIG.seal_travel] == 0.0).all()
    assert (np.diff(found.seal) <= 0.0).all()
    assert found.seal[np.searchsorted(travel, 0.005)] == pytest.approx(0.5 * found.seal[0])
    np.testing.assert_allclose(found.friction, CONFIG.hinge_friction)
    np.testing.assert_allclose(found.weight, 0.0, atol=1e-6)
    assert found.largest == pytest.approx(30.0 * 0.5 + 0.4, abs=1e-6)
    assert found.along.argmax() == 0
    assert (resistance_along(item, "hinge", values[::-1], 0.5, CONFIG).seal == 0.0).all()


def test_the_travel_of_a_seal_is_measured_at_the_handle_wherever_it_moves(tmp_path: Path) -> None:
    """A lever that changes along the motion, as for a handle on a link that follows."""
    item, values = cupboard(tmp_path, DOOR, HINGE), np.linspace(0, 0.1, 11)
    levers = np.linspace(0.3, 0.6, 11)
    one = resistance_along(item, "hinge", values, 0.3, CONFIG).seal / 0.3
    several = resistance_along(item, "hinge", values, levers, CONFIG).seal / levers
    assert several[0] == pytest.approx(one[0]) == pytest.approx(CONFIG.latch_force)
    assert (several[1:] <= one[1:]).all()


@pytest.mark.parametrize(("hinge", "side"), [(DROP_DOOR, 1), (LIFT_DOOR, -1)])
def test_the_weight_of_a_flap_grows_with_its_angle_and_keeps_its_sign(
    tmp_path: Path, hinge: str, side: int
) -> None:
    """A drop-down door drives its own motion, a lift-up door resists it; both back and forth."""
    mass, z = 8.0, side * 0.3
    item = weighed(cupboard(tmp_path, door_of(side * 0.6, mass, z), hinge))
    expected = mass * GRAVITY * 0.3 * np.sin(OPENING)
    found = resistance_along(item, "hinge", OPENING, 0.5, SLOW)
    np.testing.assert_allclose(found.weight, -side * expected, atol=1e-5)
    back = resistance_along(item, "hinge", OPENING[::-1], 0.5, CONFIG)
    np.testing.assert_allclose(back.weight[::-1], side * expected, atol=1e-5)
    worst = expected[-1] + (-CONFIG.hinge_friction if side > 0 else CONFIG.hinge_friction)
    assert found.largest == pytest.approx(worst, abs=1e-5)
    assert found.along[-1] == pytest.approx(-side * worst, abs=1e-5)


def test_seal_and_weight_do_not_add_up_where_they_never_act_together(tmp_path: Path) -> None:
    item = weighed(cupboard(tmp_path, door_of(0.6, 8.0, 0.3), DROP_DOOR, category="dishwasher"))
    found = resistance_along(item, "hinge", OPENING, 0.55, CONFIG)
    seal, weight = 30.0 * 0.55, 8.0 * GRAVITY * 0.3
    assert found.largest < max(seal, weight) + CONFIG.hinge_friction
    assert found.largest < 0.7 * (seal + weight)


@pytest.mark.parametrize("kind", FOLLOWERS)
def test_the_work_of_the_weight_is_the_loss_of_potential_energy(tmp_path: Path, kind: str) -> None:
    parts, _, leader = FOLLOWERS[kind]
    item = furniture_room(tmp_path, parts).object("cupboard")
    tilted = item.T_world_object.copy()
    tilted[:3, :3] = [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]
    item = replace(item, T_world_object=tilted)
    record = item.joint(leader)
    values = np.linspace(record.lower, record.upper, 401)
    masses = part_masses(item.model, item.model.moved_by(leader), CONFIG)

    def energy(value: float) -> float:
        poses = item.link_poses({leader: value})
        return sum(
            mass * GRAVITY * float((poses[link][:3, :3] @ at + poses[link][:3, 3])[2])
            for link, (mass, at) in masses.items()
        )

    weight = weight_at(item, leader, values, CONFIG)
    work = float(np.trapezoid(weight, values))
    assert work == pytest.approx(energy(values[0]) - energy(values[-1]), rel=1e-3, abs=1e-3)


def test_masses_of_the_file_count_and_others_are_assumed(tmp_path: Path) -> None:
    given = cupboard(tmp_path, door_of(0.6, 40.0, 0.25), DROP_DOOR)
    (mass, center), *_ = part_masses(given.model, ("door",), CONFIG).values()
    assert mass == 40.0  # the bounds hold for assumed masses only
    np.testing.assert_allclose(center, [0, 0, 0.25])
    (tmp_path / "b").mkdir()
    assumed = cupboard(tmp_path / "b", door_of(0.6), DROP_DOOR)
    (mass, center), *_ = part_masses(assumed.model, ("door",), CONFIG).values()
    assert mass == pytest.approx(300 * 0.02 * 0.5 * 0.6)
    np.testing.assert_allclose(center, [0, 0, 0.3], atol=1e-9)


def test_a_handle_without_a_mass_adds_its_assumed_one_to_that_of_the_door(tmp_path: Path) -> None:
    handle = (
        '<link name="grip"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
        '</link><joint name="fixed" type="fixed"><parent link="door"/><child link="grip"/>'
        '<origin xyz="-0.06 0 0.5"/></joint>'
    )
    item = cupboard(tmp_path, door_of(0.6, 5.0, 0.3), handle, DROP_DOOR)
    known = known_resistance(item, "hinge", CONFIG)
    assert known.mass == pytest.approx(5.0 + 300 * 0.001)


def test_a_known_mass_of_a_part_is_shared_as_the_masses_of_its_links_are(tmp_path: Path) -> None:
    parts, _, leader = FOLLOWERS["a folding door"]
    item = furniture_room(tmp_path, parts).object("cupboard")
    links = item.model.moved_by(leader)
    some, all_of = (part_masses(item.model, links, CONFIG, total) for total in (None, 30.0))
    assert sum(mass for mass, _ in all_of.values()) == pytest.approx(30.0)
    ratios = [all_of[link][0] / some[link][0] for link in links]
    np.testing.assert_allclose(ratios, ratios[0])


def test_the_mass_of_an_object_is_that_of_its_links(tmp_path: Path) -> None:
    item = cupboard(tmp_path, door_of(0.6, 4.0, 0.3), DROP_DOOR)
    body = part_masses(item.model, ("body",), CONFIG)["body"][0]
    mass, center = object_mass(item, CONFIG)
    assert mass == pytest.approx(body + 4.0, rel=0.01)
    assert center[2] < 0.45


def test_a_balanced_door_weighs_nothing_and_stays_where_it_is(tmp_path: Path) -> None:
    free = cupboard(tmp_path, door_of(0.6, 20.0, 0.3), DROP_DOOR)
    heavy = weighed(free)
    assert stays_in_place(heavy, "hinge", np.array([0.0, 1.0]), CONFIG).tolist() == [True, False]
    assert stays_in_place(free, "hinge", np.array([0.0, 1.0]), CONFIG).all()
    assert known_resistance(free, "hinge", CONFIG).mass == 20.0
    found = resistance_along(free, "hinge", OPENING, 0.5, SLOW)
    np.testing.assert_allclose(found.along[1:], CONFIG.hinge_friction)


LID = joint("hinge", "revolute", ("body", "lid"), (0.25, 0, 0.91), (0, 1, 0), (0, 1.4))
TOP = link("lid", ((0.5, 0.6, 0.02), (-0.25, 0, 0.01)))


@pytest.mark.parametrize(
    ("part", "hinge", "springs"),
    [
        (door_of(0.6), DROP_DOOR, True),  # a dishwasher, an oven
        (door_of(-0.6), LIFT_DOOR, True),  # a lift-up door
        (DOOR, HINGE, False),  # weight does not act on an upright hinge
        (TOP, LID, False),  # a chest's lid
        (tray(BAR), SLIDE, False),
    ],
)
def test_springs_are_assumed_for_doors_on_a_horizontal_hinge(
    tmp_path: Path, part: str, hinge: str, springs: bool
) -> None:
    item = cupboard(tmp_path, part, hinge)
    (name,) = item.model.joints
    assert known_resistance(item, name, CONFIG).balanced is springs
    assert assumes_springs(item, name, CONFIG) is springs
    for given in (True, False):
        known = replace(item, resistance={name: JointResistance(balanced=given)})
        assert known_resistance(known, name, CONFIG).balanced is given
        assert not assumes_springs(known, name, CONFIG)


def test_known_values_replace_assumed_ones_and_the_rest_is_assumed(tmp_path: Path) -> None:
    known = JointResistance(seal_force=20.0, seal_travel=0.02, friction=2.0, lever=0.4, mass=3.0)
    item = cupboard(tmp_path, DOOR, HINGE, resistance={"hinge": known})
    found = resistance_along(item, "hinge", np.linspace(0, 0.1, 101), 0.55, CONFIG)
    assert found.seal[0] == pytest.approx(20.0 * 0.4)
    assert np.flatnonzero(found.seal)[-1] == 49  # 2 cm at 0.4 m from the hinge
    assert found.friction[0] == 2.0
    full = known_resistance(item, "hinge", CONFIG)
    assert (full.mass, full.damping, full.balanced) == (3.0, CONFIG.hinge_damping, False)


def test_a_slide_has_a_catch_and_friction_and_lifts_its_tray_where_it_is_tilted(
    tmp_path: Path,
) -> None:
    item = cupboard(tmp_path, tray(BAR), SLIDE)
    values = np.linspace(0, 0.4, 81)
    found = resistance_along(item, "slide", values, 1.0, CONFIG)
    assert found.largest == pytest.approx(CONFIG.latch_force + CONFIG.slide_friction, abs=1e-6)
    assert found.seal[values >= 0.01].max() == pytest.approx(0.0)
    np.testing.assert_allclose(found.weight, 0.0, atol=1e-6)
    down = item.T_world_object.copy()
    down[:3, :3] = [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]
    mass = known_resistance(item, "slide", CONFIG).mass
    tilted = resistance_along(replace(item, T_world_object=down), "slide", values, 1.0, CONFIG)
    np.testing.assert_allclose(tilted.weight, mass * GRAVITY * 0.6, rtol=1e-4)


def with_dynamics(part: str, words: str) -> str:
    return part.replace("</joint>", f"<dynamics {words}/></joint>")


@pytest.mark.parametrize(
    ("part", "frame", "words", "friction", "damping", "why"),
    [
        (DOOR, HINGE, 'friction="300" damping="1"', 300.0, 1.0, "300 Nm by <dynamics friction>"),
        (tray(BAR), SLIDE, 'friction="200"', 200.0, 8.0, "200 N by <dynamics friction>"),
        (tray(BAR), SLIDE, 'damping="800"', 4.0, 800.0, "800 Ns/m by <dynamics damping>"),
    ],
)
def test_friction_and_damping_of_the_file_resist_the_motion(
    tmp_path: Path, part: str, frame: str, words: str, friction: float, damping: float, why: str
) -> None:
    item = cupboard(tmp_path, part, with_dynamics(frame, words))
    (name,) = item.model.joints
    found = resistance_along(item, name, np.linspace(0.0, 0.3, 31), 0.5, CONFIG)
    np.testing.assert_allclose(found.friction, friction)
    np.testing.assert_allclose(found.damping[1:-1], damping * 0.25 / 0.5)
    assert found.damping[0] == found.damping[-1] == 0.0
    assert found.source(15) == f"{why} of {name}"


def test_damping_does_not_hold_back_a_part_that_falls_open(tmp_path: Path) -> None:
    item = cupboard(tmp_path, door_of(0.6, 8.0, 0.3), with_dynamics(DROP_DOOR, 'damping="900"'))
    item = weighed(item)
    slow = resistance_along(item, "hinge", OPENING, 0.5, SLOW)
    fast = resistance_along(item, "hinge", OPENING, 0.5, CONFIG)
    assert (fast.total >= slow.total).all()
    assert fast.largest == pytest.approx(900.0 * 0.5 + fast.friction[0], abs=4.0)


def test_the_scene_overrides_the_file_and_zero_in_the_file_means_nothing(tmp_path: Path) -> None:
    item = cupboard(tmp_path, DOOR, with_dynamics(HINGE, 'friction="300" damping="0"'))
    assert known_resistance(item, "hinge", CONFIG).damping == CONFIG.hinge_damping
    item = replace(item, resistance={"hinge": JointResistance(friction=2.0)})
    found = resistance_along(item, "hinge", OPENING, 0.5, CONFIG)
    assert found.friction[0] == 2.0
    assert not found.source(30)


def test_friction_of_a_joint_that_follows_acts_along_its_leader(tmp_path: Path) -> None:
    parts, _, leader = FOLLOWERS["a folding door"]
    parts = [with_dynamics(p, 'friction="3" damping="5"') if "<mimic" in p else p for p in parts]
    item = furniture_room(tmp_path, parts).object("cupboard")
    (ratio,) = [one.mimic.ratio for one in item.model.joints.values() if one.mimic is not None]
    known = known_resistance(item, leader, CONFIG)
    assert (known.friction, known.damping) == (abs(ratio) * 3.0, ratio**2 * 5.0)
    slow = resistance_along(item, leader, np.linspace(0.0, 0.3, 31), 0.5, SLOW)
    assert slow.source(30) == "6 Nm by <dynamics friction> of fold"


@pytest.mark.parametrize("words", ['friction="-1"', 'damping="1e9"', 'friction="much"'])
def test_unusable_dynamics_of_furniture_are_refused(tmp_path: Path, words: str) -> None:
    with pytest.raises(UrdfError, match="in <dynamics> must be a number from 0 to 100000"):
        cupboard(tmp_path, DOOR, with_dynamics(HINGE, words))


NAMES = [
    ("fridge", "fridge", "door", "hinge", True),
    ("fridge", "", "link_0", "joint_0", True),
    ("kitchen", "kitchen", "fridge_door", "fridge_door_joint", True),
    ("kitchen", "kitchen", "FreezerDoor", "j3", True),
    ("kitchen", "kitchen", "pantry_door", "hinge", False),
    ("oven_cabinet", "cabinet", "door", "hinge", False),
    ("oven_cabinet", "", "door", "hinge", False),
    ("kitchen", "kitchen", "oven_cabinet_door", "hinge", False),
    ("cabinet_with_oven", "", "door", "hinge", True),
    ("unit", "oven", "link_1", "knob_joint", False),
    ("unit", "oven", "door", "standard_hinge", True),
    ("my_dishwasher_1", "appliance", "door", "hinge", True),
    ("MiniFridge", "", "door", "hinge", True),
    ("refrigerator", "cabinet", "door", "hinge", False),
]


@pytest.mark.parametrize(("name", "category", "link", "hinge", "sealed"), NAMES)
def test_joint_and_link_name_a_seal_first_then_the_category_then_the_object(
    tmp_path: Path, name: str, category: str, link: str, hinge: str, sealed: bool
) -> None:
    parts = [DOOR.replace('"door"', f'"{link}"'), HINGE.replace('"door"', f'"{link}"')]
    parts[1] = parts[1].replace('"hinge"', f'"{hinge}"')
    item = cupboard(tmp_path, *parts, name=name, category=category)
    assert has_seal(item, hinge, CONFIG) == sealed
    force = known_resistance(item, hinge, CONFIG).seal_force
    assert force == (CONFIG.seal_force if sealed else CONFIG.latch_force)


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"friction": -1.0}, "JointResistance.friction must be"),
        ({"mass": 0.0}, "JointResistance.mass must be"),
        ({"seal_force": float("nan")}, "JointResistance.seal_force must be"),
        ({"balanced": 1}, "JointResistance.balanced must be"),
        ({"lever": "long"}, "JointResistance.lever must be"),
    ],
)
def test_unusable_values_are_refused(members: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        JointResistance(**members)  # type: ignore[arg-type]
