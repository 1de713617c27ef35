"""The path of the moved part is free, relative to its overlap in the given scene."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from door_case import BASE, JOINTS, OPEN, Case, arm_path, make_case, tool_poses

from momapos.core.geometry.transforms import invert
from momapos.model.records.plans import Motion, Task
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.verification.convex import overlap
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.plan_check import UrdfArm
from momapos.verification.report import DEFAULT, Check, Limits

DOOR = Task("open", "cupboard", "hinge", OPEN)
CHECK = "moved part collision with the scene"
FLUSH = [0.02, 0.3, 0.78]
"""Size of a panel next to the door, flush with its edge on the side away from the hinge [m]."""


def world_of(folder: Path, case: Case, task: Task = DOOR, limits: Limits = DEFAULT) -> PlanVerifier:
    case.write(folder)
    arm = UrdfArm(
        Articulated(read_urdf(folder / "robot.urdf")), "base", "tool", JOINTS, frozenset()
    )
    return PlanVerifier(load_scene(folder / "scene.json"), arm, task, limits)


def opening() -> Motion:
    approach, q, values = arm_path()
    return Motion(approach, q, values, tool_poses(values))


def verdict(world: PlanVerifier, motion: Motion) -> Check:
    return next(c for c in world.check(BASE, motion).checks if c.name == CHECK)


@pytest.mark.parametrize("seed", range(8))
def test_the_first_hit_equals_that_of_checking_every_value(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    case = make_case()
    case.obstacle(
        rng.uniform(0.02, 0.2, 3).tolist(), rng.uniform([-0.5, -0.2, 0.5], [0.1, 0.5, 1.1]).tolist()
    )
    world = world_of(tmp_path, case)
    part, post = world.part, world.fixed.names.index("post/box")
    values = world.part_sweep.path(OPEN)
    T_post_world = invert(world.fixed.Ts_body_shape[post])
    depth = np.array([
        max(
            overlap(part.shapes.core(i), world.fixed.core(post), T_post_world @ T)
            for i, T in enumerate(Ts)
        )
        for Ts in part.placed(values)
    ])  # fmt: skip
    deep = depth > max(0.003, depth[0] + 0.003)
    words = world.blocked(0.05)
    assert (words is None) == (not deep.any())
    if words is not None:
        first = round(np.degrees(values[int(np.argmax(deep))]))
        assert re.search(r"mm in post/box at worst, first", words)
        assert f"at {first} deg, moving from 0 to 57 deg" in words


@pytest.mark.parametrize("overlap_mm", [0.0, 2.0, 8.0])
def test_a_door_may_leave_a_neighbor_that_it_overlaps(overlap_mm: float, tmp_path: Path) -> None:
    case = make_case()
    case.obstacle(FLUSH, [0.185, 0.44 - overlap_mm / 1000, 0.8])
    world = world_of(tmp_path, case)
    assert world.blocked(0.05) is None
    assert verdict(world, opening()).ok


def test_a_door_may_not_turn_deeper_into_a_neighbor_that_it_touches(tmp_path: Path) -> None:
    case = make_case()
    case.obstacle([0.1, 0.1, 0.78], [0.125, -0.2, 0.8])  # flush before the door, near its hinge
    world = world_of(tmp_path, case)
    words = world.blocked(0.05)
    assert words is not None
    assert re.match(r"cupboard/door \d+ mm in post/box at worst, first at ", words)
    check = verdict(world, opening())
    assert not check.ok
    assert check.culprit == "cupboard/door and post/box"


def test_a_door_may_turn_in_its_own_frame(tmp_path: Path) -> None:
    case = make_case()
    case.cupboard = case.cupboard.replace('xyz="0 0.29 0"', 'xyz="0.025 0.29 0"')
    world = world_of(tmp_path, case)  # the door overlaps the body by 2 cm and sweeps through it
    assert world.blocked(0.05) is None
    assert verdict(world, opening()).ok


def test_a_clearance_does_not_apply_to_neighbors_that_are_nearer_already(tmp_path: Path) -> None:
    far, near = make_case(), make_case()
    far.obstacle([0.04, 0.04, 0.04], [-0.4, 0.0, 0.45])  # at least 2 cm from the door's path
    near.obstacle(FLUSH, [0.185, 0.445, 0.8])
    assert world_of(tmp_path / "far", far).blocked(0.05) is None
    limits = Limits(penetration=-0.1)
    words = world_of(tmp_path / "far", far, limits=limits).blocked(0.05)
    assert words is not None
    assert re.search(r"mm from post/box at worst, first", words)
    assert world_of(tmp_path / "near", near, limits=limits).blocked(0.05) is None


def stick_room(*obstacles: tuple[list[float], list[float]]) -> Case:
    """Replace the cupboard by a stick at the handle's position, hanging below the hand."""
    case = make_case()
    case.scene["objects"] = case.scene["objects"][1:]
    xyz = tool_poses(np.zeros(1))[0, :3, 3] - [0.0, 0.0, 0.13]
    stick = {
        "name": "stick", "category": "stick", "box": [0.02, 0.02, 0.3],
        "pose": {"xyz": xyz.tolist(), "wxyz": [1.0, 0.0, 0.0, 0.0]},
    }  # fmt: skip
    case.scene["objects"].append(stick)
    for size, where in obstacles:
        case.obstacle(size, where)
    return case


def carried() -> tuple[Motion, Motion]:
    """Return motions along the door's arc that pick a stick at its start, or place it there."""
    approach, q, values = arm_path()
    zeros, Ts = np.zeros(len(q)), tool_poses(values)
    back = tool_poses(np.zeros(1))[0]
    retreat = np.array([back] * len(approach))
    retreat[:, :3, 3] += np.linspace(0.0, -0.1, len(approach))[:, None] * back[:3, 2]
    pick = Motion(approach, q, zeros, Ts)
    place = Motion(q[::-1], np.vstack([q[:1], approach[-2::-1]]), zeros[: len(approach)], retreat)
    return pick, place


@pytest.mark.parametrize("verb", ["pick", "place"])
@pytest.mark.parametrize(
    ("drop", "free"), [(0.2, False), (0.4, True)], ids=["at its height", "below it"]
)
def test_a_carried_object_is_checked_along_the_whole_path(
    verb: str, drop: float, free: bool, tmp_path: Path
) -> None:
    middle = tool_poses(np.array([0.5]))[0, :3, 3] - [0.0, 0.0, drop]
    case = stick_room(([0.03, 0.03, 0.03], middle.tolist()))
    motion = dict(zip(("pick", "place"), carried(), strict=True))[verb]
    world = world_of(tmp_path, case, Task(verb, "stick"))  # type: ignore[arg-type]
    checks = {check.name: check for check in world.check(BASE, motion).checks}
    assert checks["arm collision with the scene"].ok
    assert checks[CHECK].ok == free
    if not free:
        assert checks[CHECK].culprit == "stick/box and post/box"


@pytest.mark.parametrize(
    ("gap", "expected"),
    [
        (0.06, None),
        (0.02, "30 mm in post/box at worst, first when lifted by 0.03 of 0.05 m"),
    ],
)
def test_a_lift_is_blocked_by_a_board_above(
    gap: float, expected: str | None, tmp_path: Path
) -> None:
    top = tool_poses(np.zeros(1))[0, :3, 3] + [0.0, 0.0, 0.02]
    board = [top[0], top[1], top[2] + gap + 0.01]
    case = stick_room(([0.3, 0.3, 0.02], board))
    words = world_of(tmp_path, case, Task("pick", "stick")).blocked(0.05)
    assert words == (expected and f"stick/box {expected}")


def test_the_support_of_an_object_does_not_block_its_lift(tmp_path: Path) -> None:
    foot = tool_poses(np.zeros(1))[0, :3, 3] - [0.0, 0.0, 0.28]
    board = [foot[0], foot[1], foot[2] - 0.01 + 0.004]  # 4 mm deep in it
    case = stick_room(([0.3, 0.3, 0.02], board))
    world = world_of(tmp_path, case, Task("pick", "stick"))
    assert world.blocked(0.05) is None


def test_the_value_of_a_task_that_moves_no_joint_does_not_count(tmp_path: Path) -> None:
    world = world_of(tmp_path, stick_room(), Task("pick", "stick", to=0.4))
    assert world.part.joint is None
    assert world.part.goal == world.part.start == 0.0
    assert world.check(BASE, carried()[0]).valid
