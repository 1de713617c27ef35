"""The moved part meets the floor at the value that plane geometry gives, and goes no deeper."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import Box, carcass, furniture_room, joint, link

from momapos.model.records.plans import Task
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.verification.moved_part import moved_part, split
from momapos.verification.part_sweep import (
    TOUCH,
    depths_below_floor,
    floor_contact,
    meets_floor_at,
    part_sweep_check,
)
from momapos.verification.report import DEFAULT

FRONT = -0.262
"""x of the hinge's axis in the carcass [m]."""
PANEL: Box = ((0.02, 0.59, 0.5), (-0.01, 0.0, 0.27))
FEET: tuple[Box, ...] = (
    ((0.12, 0.03, 0.03), (-0.08, 0.2, 0.45)), ((0.12, 0.03, 0.03), (-0.08, -0.2, 0.45)),
)  # fmt: skip
FLAPS = {
    "a thick dishwasher door near the floor": (0.03, ((0.05, 0.58, 0.56), (-0.025, 0, 0.27))),
    "an oven flap with feet": (0.1, PANEL, *FEET),
    "a flap longer than its hinge is high": (0.2, PANEL, ((0.3, 0.1, 0.02), (-0.17, 0, 0.02))),
    "a flap with a deep plinth": (0.06, PANEL, ((0.1, 0.59, 0.04), (-0.05, 0, -0.02))),
}
"""Height of the hinge above the floor [m], and the boxes of the flap."""


def flap_room(folder: Path, height: float, *boxes: Box, z: float = 0.0) -> Scene:
    hinge = joint(
        "hinge", "revolute", ("body", "flap"), (FRONT, 0, height), (0, -1, 0), (0, math.pi / 2)
    )
    scene = furniture_room(folder, [carcass(), link("flap", *boxes), hinge])
    scene.object("cupboard").T_world_object[2, 3] = z
    return scene


def corners(boxes: tuple[Box, ...]) -> np.ndarray:
    signs = np.stack(np.meshgrid(*3 * [[-0.5, 0.5]]), -1).reshape(-1, 3)
    return np.concatenate([np.array(c) + signs * np.array(s) for s, c in boxes])


def lowest(height: float, boxes: tuple[Box, ...], angle: np.ndarray) -> np.ndarray:
    """Return the height of a flap's lowest corner, turned by angles about -y."""
    x, _, z = corners(boxes).T
    return (height + np.outer(np.cos(angle), z) + np.outer(np.sin(angle), x)).min(1)


def blocked(scene: Scene, name: str, joint_name: str, to: float) -> str | None:
    part, fixed, own = split(scene, Task("open", name, joint_name, to))
    return part_sweep_check(part, fixed, own, DEFAULT).first_hit(to)


@pytest.mark.parametrize("kind", FLAPS)
def test_a_flap_meets_the_floor_where_its_lowest_corner_does(tmp_path: Path, kind: str) -> None:
    height, *boxes = FLAPS[kind]
    scene = flap_room(tmp_path, height, *boxes)
    angles = np.linspace(0.0, math.pi / 2, 20_001)
    touching = angles[np.argmax(lowest(height, tuple(boxes), angles) < -TOUCH)]
    contact = meets_floor_at(scene.object("cupboard"), "hinge", math.pi / 2)
    assert contact == pytest.approx(touching, abs=1e-3)
    words = blocked(scene, "cupboard", "hinge", math.pi / 2)
    degrees = round(math.degrees(contact))
    assert words == f"cupboard/flap meets the floor at {degrees} deg, moving from 0 to 90 deg"
    assert blocked(scene, "cupboard", "hinge", contact - 0.01) is None


def test_a_part_is_found_on_the_floor_between_values_that_are_a_step_apart(tmp_path: Path) -> None:
    """A lever that turns over dips to the floor halfway, and ends as high as it began."""
    lever = link("lever", ((0.3, 0.5, 0.02), (-0.15, 0, 0)))
    turn = joint("turn", "revolute", ("body", "lever"), (FRONT, 0, 0.2), (0, -1, 0), (0, math.pi))
    scene = furniture_room(tmp_path, [carcass(), lever, turn])
    part = moved_part(scene.object("cupboard"), Task("open", "cupboard", "turn", math.pi))
    contact = floor_contact(part, math.pi, math.pi / 2)
    assert contact is not None
    below = lowest(0.2, (((0.3, 0.5, 0.02), (-0.15, 0, 0)),), np.linspace(0.0, 2.0, 20_001)) < 0.0
    assert contact[0] == pytest.approx(np.linspace(0.0, 2.0, 20_001)[np.argmax(below)], abs=0.05)


def test_a_flap_high_above_the_floor_opens_wholly(tmp_path: Path) -> None:
    scene = flap_room(tmp_path, 0.7, PANEL)
    assert meets_floor_at(scene.object("cupboard"), "hinge", math.pi / 2) is None
    assert blocked(scene, "cupboard", "hinge", math.pi / 2) is None


@pytest.mark.parametrize("sunk", [0.002, 0.05])
def test_a_part_that_lies_below_the_floor_in_the_scene_may_move_there(
    tmp_path: Path, sunk: float
) -> None:
    door = link("door", ((0.02, 0.59, 0.88), (0, 0.295, 0)))
    hinge = joint("hinge", "revolute", ("body", "door"), (FRONT, -0.295, 0.45), (0, 0, 1), (0, 1.6))
    scene = furniture_room(tmp_path, [carcass(), door, hinge])
    scene.object("cupboard").T_world_object[2, 3] = -0.01 - sunk
    assert meets_floor_at(scene.object("cupboard"), "hinge", 1.6) is None
    assert blocked(scene, "cupboard", "hinge", 1.6) is None


def test_a_part_that_lies_below_the_floor_in_the_scene_gets_no_deeper(tmp_path: Path) -> None:
    height, *boxes = FLAPS["a flap with a deep plinth"]
    scene = flap_room(tmp_path, height, *boxes, z=-0.05)  # the plinth is 3 cm deep
    angles = np.linspace(0.0, math.pi / 2, 20_001)
    deeper = lowest(height - 0.05, tuple(boxes), angles) < -0.03 - TOUCH
    contact = meets_floor_at(scene.object("cupboard"), "hinge", math.pi / 2)
    assert contact == pytest.approx(angles[np.argmax(deeper)], abs=2e-3)


def test_a_lift_table_sinks_to_the_floor(tmp_path: Path) -> None:
    table = link("table", ((0.5, 0.5, 0.04), (-0.6, 0, 0)))
    lift = joint("lift", "prismatic", ("body", "table"), (0, 0, 0.3), (0, 0, -1), (0, 0.4))
    scene = furniture_room(tmp_path, [carcass(), table, lift])
    contact = meets_floor_at(scene.object("cupboard"), "lift", 0.4)
    assert contact == pytest.approx(0.28, abs=1e-3)
    words = blocked(scene, "cupboard", "lift", 0.4)
    assert words == "cupboard/table meets the floor at 0.28 m, moving from 0.00 to 0.40 m"


def test_a_follower_meets_the_floor_for_its_leader(tmp_path: Path) -> None:
    drawer = link("drawer", ((0.3, 0.5, 0.2), (0, 0, 0)))
    step = link("step", ((0.3, 0.5, 0.02), (-0.3, 0, 0)))
    slide = joint("slide", "prismatic", ("body", "drawer"), (0, 0, 0.3), (-1, 0, 0), (0, 0.4))
    drops = joint(
        "drops", "prismatic", ("drawer", "step"), (0, 0, 0), (0, 0, -1), (0, 0.8),
        'joint="slide" multiplier="2"',
    )  # fmt: skip
    scene = furniture_room(tmp_path, [carcass(), drawer, step, slide, drops])
    contact = meets_floor_at(scene.object("cupboard"), "slide", 0.4)
    assert contact == pytest.approx(0.29 / 2, abs=1e-3)


def test_the_first_of_an_obstacle_and_the_floor_is_named(tmp_path: Path) -> None:
    kind = "a flap longer than its hinge is high"
    scene = flap_room(tmp_path, *FLAPS[kind])
    post = SceneObject.box("post", (0.05, 0.05, 1.0), (0.8 + FRONT - 0.2, 0.0, 0.5))
    words = blocked(replace(scene, objects=(*scene.objects, post)), "cupboard", "hinge", 1.5)
    assert words is not None
    assert re.search(r"mm in post/box at worst, first", words)
    far = SceneObject.box("post", (0.05, 0.05, 1.0), (0.8 + FRONT - 0.5, 0.0, 0.5))
    words = blocked(replace(scene, objects=(*scene.objects, far)), "cupboard", "hinge", 1.5)
    assert words is not None
    assert "meets the floor" in words


@pytest.mark.parametrize("seed", range(4))
def test_depths_below_the_floor_are_those_of_the_outlines(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = flap_room(tmp_path, *FLAPS["an oven flap with feet"], z=-0.1)
    part = moved_part(scene.object("cupboard"), Task("open", "cupboard", "hinge", 1.5))
    Ts = part.placed(rng.uniform(0.0, 1.5, 5))
    bottom = [
        [min(0.0, (part.shapes.outline(k) @ T[2, :3] + T[2, 3]).min()) for k, T in enumerate(row)]
        for row in Ts
    ]
    assert depths_below_floor(part.shapes, Ts) == pytest.approx(-np.array(bottom))
