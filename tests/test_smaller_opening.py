"""Where a part cannot be opened as far as asked, the answer says how far it can."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from momapos.cli.main import main
from momapos.manipulation.tasks import make_task
from momapos.scene.files import load_scene
from momapos.smaller_opening import rounded


def test_an_opening_that_is_too_wide_is_answered_with_one_that_works(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The Fetch stands in the way of the dishwasher's lid before it is all the way down."""
    words = ["place", "open", "kitchen_small", "dishwasher/door_hinge", "--robot", "fetch"]
    assert main([*words, "--json", "--out", str(tmp_path / "plan.json")]) == 3
    shown = json.loads(capsys.readouterr().out)
    asked = make_task(load_scene("kitchen_small"), "open", "dishwasher", "door_hinge").to
    assert asked is not None
    assert 0.2 * asked < shown["feasible_to"] < 0.8 * asked
    assert json.loads((tmp_path / "plan.json").read_text())["feasible_to"] == shown["feasible_to"]
    degrees = f"{np.degrees(shown['feasible_to']):.0f}"
    assert main([*words, "--to", f"{degrees}deg"]) == 0
    assert f"to {degrees} deg: solved" in capsys.readouterr().out


@pytest.mark.parametrize("value", [0.1234, 1.0, -0.7])
def test_a_smaller_value_can_be_written_in_whole_units(value: float) -> None:
    assert rounded(value, slides=True) == pytest.approx(value, abs=0.005)
    assert np.degrees(rounded(value, slides=False)) == pytest.approx(np.degrees(value), abs=0.5)
    assert float(f"{np.degrees(rounded(value, slides=False)):.6f}").is_integer()
