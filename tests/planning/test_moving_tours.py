"""Laws of tours whose base moves while the hand holds a part."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from momapos.model.plan_files.tour_format import write_tour
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.keyword_forms import plan_tour
from momapos.planning.tour import Request
from momapos.verification.plan_check import verify_tour


@pytest.mark.slow
def test_a_tour_goes_on_from_where_a_moving_base_has_stopped(
    tmp_path: Path, kitchen: Scene, stretch: Robot
) -> None:
    """Stretch opens the microwave from no single base pose, and closes it from none."""
    part = ("microwave", "door_hinge")
    config = PipelineConfig(base="moving", timeout=300.0)
    tour = plan_tour(
        kitchen, stretch,
        [Request("open", *part), Request("close", *part)], config=config,
    )  # fmt: skip
    assert tour.status == "solved"
    assert tour.stops == (1, 2)
    first, second = (step.plan for step in tour.steps)
    assert first.moves_base
    assert second.moves_base
    assert second.start == first.final_base_pose
    assert np.abs(np.subtract(second.start or (), first.base_pose)).max() > 0.05
    file = tmp_path / "tour.json"
    write_tour(file, [first, second], tour.stops, tour.assumed)
    assert all(report.valid for report in verify_tour(file).values())
