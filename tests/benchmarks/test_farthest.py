"""Whatever is solved when it is requested is never more than the stated maximum."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests import optional
from tests.real import DATA

REPOSITORY = Path(__file__).parents[2]
FOLDER = REPOSITORY / "benchmarks"


@pytest.mark.slow
def test_no_shared_object_opens_beyond_its_stated_maximum(tmp_path: Path) -> None:
    """Four robots and all doors and drawers of the development set; it takes about 10 minutes."""
    optional.there(DATA / "bestman")
    path = os.pathsep.join(map(str, (FOLDER, REPOSITORY, REPOSITORY / "src")))
    environment = {**os.environ, "PYTHONPATH": path, "MOMAPOS_SHARED": str(DATA)}
    command = [str(FOLDER / "openings.py"), "farthest", "--set", "development", "--values", "6"]
    done = subprocess.run(
        [sys.executable, *command, "--out", "rows"],
        capture_output=True, text=True, cwd=tmp_path, env=environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "rows" / "farthest.json").read_text())
    assert {row["robot"] for row in rows} == {"fetch", "segway_ur5e", "husky_ur5e", "ranger_rm63"}
    stated = [row for row in rows if row.get("stated") is not None]
    assert len(stated) > 4
    assert all(len(row["queried"]) > 3 for row in stated)
    assert [row for row in rows if row.get("solved")] == []
