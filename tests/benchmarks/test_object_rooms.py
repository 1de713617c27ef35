"""Laws of object lists: models are placed in rooms."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).parents[2]
URDF = """
<robot name="item">
  <link name="body"><collision><geometry><box size="0.6 0.4 0.7"/></geometry></collision></link>
  <link name="door"><collision><origin xyz="0.3 0 0"/>
    <geometry><box size="0.6 0.02 0.7"/></geometry></collision></link>
  <joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>
    <origin xyz="-0.3 -0.21 0"/><axis xyz="{axis}"/>
    <limit lower="0" upper="1.5" effort="1" velocity="1"/></joint>
</robot>
"""
DOOR, LID = "0 0 -1", "1 0 0"
ROOMS = """
import json, sys
from pathlib import Path
from scan_objects import listed, places
objects = listed(Path(sys.argv[1]))
found = {}
for place in places(objects, None, 1):
    bounds = {item.name: [b.tolist() for b in item.bounds] for item in place.scene.objects}
    found[place.name] = bounds, place.scene.object("object").T_world_object[:3, :3].tolist()
print(json.dumps(found))
"""


def run(text: str, *options: str | Path, folder: Path) -> Any:
    path = os.pathsep.join(map(str, (REPOSITORY / "benchmarks", REPOSITORY, REPOSITORY / "src")))
    done = subprocess.run(
        [sys.executable, "-c", text, *map(str, options)],
        capture_output=True, text=True, cwd=folder, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def row(**others: Any) -> dict[str, Any]:
    return {"name": "Set/item/1", "urdf": "a.urdf", "above": 0.0, "counter": False, **others}


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("models")
    (folder / "a.urdf").write_text(URDF.format(axis=DOOR))
    (folder / "lid.urdf").write_text(URDF.format(axis=LID))
    rows = [
        row(),
        row(name="Set/item/hung", above=1.4),
        row(name="Set/item/small", above=0.9, counter=True),
        row(name="Set/item/lid", urdf="lid.urdf"),
    ]
    (folder / "models.json").write_text(json.dumps(rows))
    return run(ROOMS, folder, folder=folder)


@pytest.mark.parametrize("name", ["1", "hung", "small", "lid"])
def test_a_model_faces_away_from_the_wall(name: str, rooms: Any) -> None:
    bounds, rotation = rooms[f"Set_item_{name}"]
    assert [row[1] for row in rotation] == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)
    assert bounds["wall"][0][0] > bounds["object"][1][0] == pytest.approx(0.0)


@pytest.mark.parametrize(("name", "above"), [("1", 0.0), ("hung", 1.4), ("small", 0.9)])
def test_a_model_stands_hangs_or_has_a_counter_below(name: str, above: float, rooms: Any) -> None:
    bounds, _ = rooms[f"Set_item_{name}"]
    assert bounds["object"][0][2] == pytest.approx(above)
    assert ("counter" in bounds) == (name == "small")
    if name == "small":
        (low, _, _), (high, _, top) = bounds["counter"]
        assert 0.0 < above - top < 0.01
        assert low < bounds["object"][0][0]
        assert high == pytest.approx(0.0)
