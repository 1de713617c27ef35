"""Laws of the lattice that bounds what a moving base does."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

REPOSITORY = Path(__file__).parents[2]
SIDE, YAWS, LAYERS = 5, 8, 4


@pytest.fixture(autouse=True)
def on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let benchmarks import their neighbors as a script does."""
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))


def reached(
    cells: list[tuple[int, int, int]], *, drive: str = "differential", stays: bool = True,
    grasps: tuple[tuple[int, ...], ...] = ((0,),) * 4, following: tuple[int, ...] = (-1, -1),
    level: int = 4, walls: bool = False,
) -> dict[str, int]:  # fmt: skip
    """Return the farthest layer of each use, if one yaw and cell is free at each layer.

    Args:
        cells: Yaw, and cell along and across the heading, at each layer.
        drive: The drive.
        stays: Whether friction holds the part.
        grasps: The grasps with which the cell is free at each layer.
        following: The grasp after each as the hand turns.
        level: The level of the nodes.
        walls: Whether the robot gets only to the first cell.
    """
    paths = importlib.import_module("lattice")
    drivable = np.full((YAWS, SIDE, SIDE), not walls)
    drivable[cells[0]] = True
    lattice = SimpleNamespace(
        sets=[SimpleNamespace(free=np.ones((2, LAYERS)), following=np.array(following))],
        robot=SimpleNamespace(drive=drive, min_turning_radius=0.0), half=SIDE // 2,
        shape=(2, YAWS, SIDE, SIDE), yaws=np.arange(YAWS) * 2 * np.pi / YAWS, drivable=drivable,
        values=np.arange(LAYERS), stays=np.full(LAYERS, stays),
    )  # fmt: skip
    reach = paths.Reach(lattice, paths.Neighbors(lattice))
    for layer, (cell, free) in enumerate(zip(cells, grasps, strict=True)):
        levels = np.zeros(lattice.shape, np.int8)
        levels[(list(free), *cell)] = level
        if not reach.add(layer, levels):
            break
    return dict(reach.farthest)


LAST = LAYERS - 1
STILL = [(0, 2, 2)] * LAYERS
AHEAD = [(0, k, 2) for k in range(LAYERS)]
ASIDE = [(0, 2, k) for k in range(LAYERS)]
ROUND = [(k, 2, 2) for k in range(LAYERS)]


def test_a_base_that_stands_needs_one_base_pose_and_any_grasps_where_the_part_stays() -> None:
    assert set(reached(STILL).values()) == {LAST}
    assert reached(AHEAD)["fixed"] == 0
    change = ((0,), (0, 1), (1,), (1,))
    changed = reached(STILL, grasps=change)
    assert (changed["fixed"], changed["moving"], changed["stops"]) == (LAST, 1, LAST)
    assert reached(STILL, grasps=change, stays=False)["any"] == 1
    turned = reached(STILL, grasps=change, following=(1, -1), stays=False)
    assert (turned["moving"], turned["moving rigid"]) == (LAST, 1)


def test_only_an_omnidirectional_base_moves_sideways_without_turning() -> None:
    assert reached(AHEAD)["moving"] == LAST
    assert reached(ASIDE)["moving"] == 0
    assert reached(ASIDE, drive="omni")["moving"] == LAST


def test_only_a_base_that_turns_reaches_the_next_yaw_while_the_hand_holds() -> None:
    found = reached(ROUND, stays=False)
    assert (found["fixed"], found["moving"], found["stops"]) == (0, 0, 0)
    assert found["turning"] == found["any"] == LAST


def test_stops_lead_anywhere_that_the_robot_gets_to_while_the_part_stays() -> None:
    far = [(0, 0, 0), (0, 0, 0), (4, 4, 4), (4, 4, 4)]
    # The part moves on only from a pose that serves both values.
    assert reached(far)["stops"] == 1
    assert reached(ASIDE)["stops"] == 0
    assert reached(STILL, walls=True)["stops"] == LAST


def test_a_moving_base_bears_more() -> None:
    borne = reached(AHEAD, level=3)
    assert (borne["moving"], borne["moving without its pull"]) == (-1, LAST)
    assert reached(AHEAD, level=2)["any without forces"] == LAST
    assert reached(AHEAD, level=2)["any"] == -1
