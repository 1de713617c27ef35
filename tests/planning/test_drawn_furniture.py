"""Plans in rooms whose furniture is drawn only, hollow, or round."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tests.meshes as given
from tests import optional
from tests.cupboards import HINGE, SLIDE, carcass, furniture_room, link
from tests.real import CASES

from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.result import PlacementResult
from momapos.planning.task_setup import prepare
from momapos.verification.plan_check import verify_files

CONFIG = PipelineConfig(timeout=60.0)
HANDLE = ((0.02, 0.02, 0.16), (-0.05, 0.53, 0.1))
SOLVED = {
    "vtable.json": ("open", "cupboard", "hinge"),
    "visual_only.json": ("open", "cupboard", "hinge"),
    "vdoor.json": ("open", "cupboard", "hinge"),
    "lost_visual.json": ("open", "cupboard", "hinge"),
    "bar_inch.json": ("open", "cupboard", "hinge"),
    "dae_mm.json": ("open", "cupboard", "hinge"),
    "dae_inch.json": ("open", "cupboard", "hinge"),
    "dae_y.json": ("open", "cupboard", "hinge"),
    "round_mesh.json": ("open", "cupboard", "hinge"),
    "overhang_mesh.json": ("open", "island", "slide"),
    "tray_mesh.json": ("pick", "can"),
}
"""Tasks that must be solved in public cases."""


def plan(
    scene: Scene, robot: Robot, *request: str, folder: Path, start: np.ndarray | None = None
) -> PlacementResult:
    task = make_task(scene, *request)
    answer = plan_base_placement(scene, robot, task, config=CONFIG, start=start)
    assert answer.plan.status == "solved", answer.plan.candidates
    path = folder / "plan.json"
    write_plan(answer.plan, path)
    report = verify_files(path)
    assert report.valid, report.violations
    return answer


@pytest.mark.parametrize("name", SOLVED)
def test_a_public_case_is_solved(tmp_path: Path, name: str, fetch: Robot) -> None:
    scene = load_scene(optional.there(CASES / "furniture" / name))
    answer = plan(scene, fetch, *SOLVED[name], folder=tmp_path)
    if name == "vtable.json":
        low, high = scene.object("table").bounds[:, :2]
        at = answer.plan.base_path[:, :2]
        assert not ((at > low) & (at < high)).all(1).any(), "the base drives around the table"


def test_a_start_next_to_a_round_table_is_free(tmp_path: Path, fetch: Robot) -> None:
    scene = load_scene(optional.there(CASES / "furniture/round_mesh.json"))
    start = np.array([0.0, -0.42, 0.0])
    plan(scene, fetch, "open", "cupboard", "hinge", folder=tmp_path, start=start)


@pytest.mark.parametrize("drawn", ["body", "door", "both"])
def test_a_cupboard_that_is_only_drawn_opens_as_a_solid_one(
    tmp_path: Path, drawn: str, fetch: Robot
) -> None:
    body, door = carcass(), link("door", ((0.02, 0.59, 0.88), (0, 0.295, 0)), handle=HANDLE)
    poses = []
    for hollow in ("", drawn):
        parts = [
            part.replace("collision", "visual") if hollow in (name, "both") else part
            for name, part in (("body", body), ("door", door))
        ]
        room = furniture_room(tmp_path, [*parts, HINGE])
        scene = save_scene(room, tmp_path / "scene.json")
        answer = plan(scene, fetch, "open", "cupboard", "hinge", folder=tmp_path)
        poses.append(answer.plan.base_pose)
    assert poses[0] == poses[1]


def mesh_object(folder: Path, name: str, boxes: tuple[given.Box, ...], x: float) -> SceneObject:
    given.write_obj(folder / f"{name}.obj", given.triangles_of(boxes))
    shape = f'<collision><geometry><mesh filename="{name}.obj"/></geometry></collision>'
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="{name}"><link name="body">{shape}</link></robot>')
    return SceneObject.from_urdf(name, path, (x, 0.0, 0.0), category="cabinet")


@pytest.mark.parametrize(
    ("name", "boxes", "z"), [("bookcase", given.SHELVES, 0.655), ("table", given.table(), 0.755)]
)
def test_an_object_is_picked_from_furniture_of_one_mesh(
    tmp_path: Path, name: str, boxes: tuple[given.Box, ...], z: float, fetch: Robot
) -> None:
    stand = mesh_object(tmp_path, name, boxes, 0.8)
    can = SceneObject.box("can", (0.05, 0.05, 0.1), (0.75 if name == "bookcase" else 0.4, 0, z))
    room = Scene("room", (stand, can), start=np.array([-1.5, 0.0, 0.0]))
    scene = save_scene(room, tmp_path / "scene.json")
    plan(scene, fetch, "pick", "can", folder=tmp_path)


def test_reasons_name_the_hull_of_a_moving_mesh_and_the_piece_of_one_that_stands_still(
    tmp_path: Path, fetch: Robot
) -> None:
    rim: given.Box = ((-0.25, -0.26, -0.1), (-0.23, 0.26, 0.1))
    bottom: given.Box = ((-0.23, -0.26, -0.1), (0.2, 0.26, -0.09))
    back: given.Box = ((0.19, -0.26, -0.09), (0.2, 0.26, 0.1))
    given.write_obj(tmp_path / "tray.obj", given.triangles_of((rim, bottom, back)))
    drawer = (
        '<link name="tray"><collision><geometry><mesh filename="tray.obj"/></geometry></collision>'
        '<collision name="handle"><origin xyz="-0.3 0 0"/><geometry><box size="0.02 0.16 0.02"/>'
        "</geometry></collision></link>"
    )
    scene = furniture_room(tmp_path, [carcass(), drawer, SLIDE])
    config = PipelineConfig()
    names = []
    for request in (("open", "cupboard", "slide"), ("pick", "cup")):
        cup = SceneObject.box("cup", (0.05, 0.05, 0.1), (0.4, 0.0, 0.95))
        room = replace(scene, objects=(*scene.objects, cup))
        ready = prepare(room, fetch, make_task(room, *request), config, clearance=0.03)
        verifier = ready.verifier
        exact = {*verifier.part.shapes.names, *verifier.fixed.names}
        assert {n for n in exact if "tray" in n} == {n for n in ready.motion.labels if "tray" in n}
        names.append(sorted({n for n in exact if "tray.obj" in n}))
    assert names == [["cupboard/tray (hull of tray.obj)"], ["cupboard/tray (piece of tray.obj)"]]
