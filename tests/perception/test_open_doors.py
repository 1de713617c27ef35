"""A flap that is open in a single scan is open in the scene, and can be closed."""

from __future__ import annotations

import numpy as np
import pytest
from tests.perception.segmentation.cupboards import cupboard, leaf_of

from momapos.apps.cli.scan_report import report_to_dict
from momapos.apps.synthetic_scans.depth_sensor import DepthSensor
from momapos.apps.synthetic_scans.recording import synthetic_scan, write_scan
from momapos.core.geometry.transforms import apply
from momapos.model.records.scans import Cloud
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.perception.open_doors import open_leaves
from momapos.perception.pipeline import default_tools
from momapos.perception.recordings.scan_reader import read_scan
from momapos.perception.records import Modeled
from momapos.perception.segmentation.open_leaves import find_open_leaves
from momapos.planning.grasps.task_requests import make_task, openable
from momapos.workflows.scan import scan_to_scene

pytestmark = pytest.mark.slow
OPEN = np.radians(65.0)


@pytest.fixture(scope="module")
def kitchen() -> Scene:
    return load_scene("kitchen_small").with_joint("dishwasher", "door_hinge", OPEN)


@pytest.fixture(scope="module")
def made(kitchen: Scene, tmp_path_factory: pytest.TempPathFactory) -> Modeled:
    path = tmp_path_factory.mktemp("open")
    write_scan(synthetic_scan(kitchen, frames=40, seed=5, sensor=DepthSensor()), path / "scan")
    return scan_to_scene(read_scan(path / "scan"), path / "scene.json", default_tools())


def hinge(item: SceneObject, joint: str) -> np.ndarray:
    """Return a point on the axis of a joint in the world [m]."""
    record = item.model.joint(joint)
    return np.asarray((item.link_poses()[record.parent] @ record.T_parent_joint)[:3, 3])


def test_a_flap_that_is_open_in_the_only_scan_is_open_in_the_scene(
    kitchen: Scene, made: Modeled
) -> None:
    moved = {(d.detection.name, part): m for d in made.decisions for part, m in d.moved.items()}
    (((name, part), seen),) = moved.items()
    assert seen.kind == "door_down"
    item = load_scene(str(made.scene)).object(name)
    joint = f"{part}_hinge"
    assert item.values()[joint] == pytest.approx(OPEN, abs=np.radians(3.0))
    assert [way.probability for way in item.hypotheses[joint]] == [1.0]
    true = kitchen.object("dishwasher")
    ours, theirs = (
        (thing.link_poses()[record.parent] @ record.T_parent_joint)[:3, 3]
        for thing, record in (
            (item, item.model.joint(joint)),
            (true, true.model.joint("door_hinge")),
        )
    )
    theirs = apply(made.T_scene_scan, theirs[None])[0]
    assert np.linalg.norm((ours - theirs)[1:]) < 0.02
    data = report_to_dict(made, read_scan(made.scene.parent / "scan"), None)
    (told,) = [entry["moved"] for entry in data["objects"] if entry["moved"]]
    assert told[part]["kind"] == "door_down"


def test_the_open_flap_is_not_a_separate_object(kitchen: Scene, made: Modeled) -> None:
    scene = load_scene(str(made.scene))
    leaf = kitchen.object("dishwasher")
    poses = leaf.link_poses()
    hulls = [
        apply(made.T_scene_scan @ poses[link], hull.vertices)
        for link in leaf.model.moved_by("door_hinge")
        for hull in leaf.model.hulls[link]
    ]
    middle = max(hulls, key=lambda points: float(np.ptp(points, axis=0).prod())).mean(0)
    (name,) = [d.detection.name for d in made.decisions if d.moved]
    for item in scene.objects:
        if item.name != name:
            low, high = item.bounds
            assert not ((middle > low) & (middle < high)).all()


def test_the_flap_can_be_closed_and_opened_wider_and_other_parts_are_found(
    kitchen: Scene, made: Modeled
) -> None:
    scene = load_scene(str(made.scene))
    assert len(openable(scene)) >= len(openable(kitchen)) - 2
    (name,) = [d.detection.name for d in made.decisions if d.moved]
    (joint,) = [j for j, value in scene.object(name).joints.items() if value > 0.0]
    now = scene.object(name).values()[joint]
    assert make_task(scene, "close", name, joint).to == pytest.approx(0.0)
    wider = make_task(scene, "open", name, joint).to
    assert wider is not None
    assert wider > now + np.radians(10.0)


def test_a_cloud_without_images_has_no_open_leaves() -> None:
    room = cupboard(leaf_of("door_left", np.radians(80.0)))
    assert open_leaves(room.cloud(), (), ()) == ()
    nothing = Cloud(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    assert find_open_leaves(nothing, room.free) == []
