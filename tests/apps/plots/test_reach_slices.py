"""Slices of a reachability map show the share of directions from which a place is reached."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.commands import json_of

from momapos.apps.cli.main import main
from momapos.apps.plots.robot_figures import reach_slice, tool_axes
from momapos.model.robots.robot import Robot
from momapos.planning.reachability.map_store import load_reach
from momapos.planning.reachability.reach_map import ReachMap


def test_the_reachability_is_a_share_that_falls_to_zero(segway: Robot) -> None:
    axes = tool_axes(segway.approach_axis, segway.closing_axis)
    share, half = reach_slice(load_reach(segway), axes, segway.reach + 0.4, 0.9, cell=0.2)
    assert 0 < share.max() <= 1
    assert share[0].max() == 0
    assert half >= segway.reach


def test_a_share_is_the_share_of_reachable_tool_poses(segway: Robot) -> None:
    reach = load_reach(segway)
    axes = tool_axes(segway.approach_axis, segway.closing_axis)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-9)
    queries: list[np.ndarray] = []

    class Recorder:
        def min_score(self, bases: np.ndarray, Ts_world_tool: np.ndarray) -> np.ndarray:
            queries.append(Ts_world_tool)
            return reach.min_score(bases, Ts_world_tool)

    share, half = reach_slice(Recorder(), axes, 1.0, 0.9, cell=0.25, directions=20)
    (Ts,) = queries
    along = Ts[:20, 0, :3, :3] @ segway.approach_axis
    assert np.abs(along.mean(0)).max() < 0.05  # spread over the sphere
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), 1.0)
    row, column = np.unravel_index(int(share.argmax()), share.shape)
    at = -half + 0.25 * (np.array([column, row]) + 0.5)
    mine = np.abs(Ts[:, 0, :2, 3] - at).max(1) < 1e-9
    assert mine.sum() == 20
    reached = reach.min_score(np.zeros((1, 3)), np.ascontiguousarray(Ts[mine]))
    assert share[row, column] == pytest.approx((reached > 0).mean())


def test_a_map_displays_itself_and_a_command_draws_it(tmp_path: Path, segway: Robot) -> None:
    reach = load_reach(segway)
    assert isinstance(reach, ReachMap)
    assert reach._repr_png_().startswith(b"\x89PNG")
    path = tmp_path / "reach.png"
    assert (
        json_of("reach", "build", "segway_ur5e", "--plot", str(path), "--json")["robot"]
        == "segway_ur5e"
    )
    with Image.open(path) as image:
        assert len(image.convert("RGB").getcolors(1_000_000) or ()) > 50
    assert main(["reach", "build", "segway_ur5e", "--plot", str(tmp_path / "reach.txt")]) == 2
