"""In a notebook kernel, scenes, plans and maps are images, and a plan plays."""

from __future__ import annotations

from typing import Any

import nbformat
from nbclient import NotebookClient

CELLS = (
    "import momapos\n"
    "from momapos.planning.grasps.task_requests import make_task\n"
    "from momapos.planning.opening_maps import opening_map\n"
    "from momapos.planning.reachability.map_store import load_reach_map\n"
    "scene, robot = momapos.load_scene('kitchen_small'), momapos.load_robot('segway_ur5e')\n"
    "task = make_task(scene, 'open', 'cabinet_left', 'drawer_slide', '5cm')\n"
    "reach = load_reach_map(robot)\n"
    "result = momapos.plan_base_placement(scene, robot, task, reach)",
    "scene",
    "result",
    "reach",
    "opening_map(scene, robot, task, reach, cell=0.4)",
    "result.show()",
)


def test_records_display_themselves_in_a_kernel() -> None:
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(one) for one in CELLS])
    NotebookClient(book, timeout=300).execute()
    first, *images, played = (cell.outputs for cell in book.cells)
    assert first == []
    for (shown,) in images:
        assert shown.output_type == "execute_result"
        assert len(shown.data["image/png"]) > 10_000
    data: dict[str, Any] = played[0].data
    assert "<iframe srcdoc=" in data["text/html"]
    assert "__VISER_EMBED_DATA__" in data["text/html"]
