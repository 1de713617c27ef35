"""A rendered kitchen is scanned and modeled, and its doors are opened."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from tests.commands import error_of, json_of, output_of

from momapos import PipelineConfig, PlaceConfig, load_reach_map
from momapos.apps.cli.main import main
from momapos.apps.cli.scan_report import report_to_dict, write_report
from momapos.apps.schemas.generate import schema_of
from momapos.apps.synthetic_scans.depth_sensor import DepthSensor
from momapos.apps.synthetic_scans.recording import synthetic_scan, write_scan
from momapos.core.errors import InputError, UnknownNameError
from momapos.core.geometry.polygons import UprightBox
from momapos.core.geometry.transforms import apply
from momapos.model.records.plans import Task
from momapos.model.records.scans import (
    Cloud,
    FaceImage,
    Front,
    ImageDetection,
    Instance,
    LabelSource,
    PartKind,
    Scan,
)
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.perception.fusion.tsdf import fuse
from momapos.perception.modeling import decide
from momapos.perception.pipeline import model_room, survey
from momapos.perception.reconstruction.front_network import FrontNetwork
from momapos.perception.reconstruction.scene_builder import GivenModel
from momapos.perception.reconstruction.usual_kinds import TemplatePredictor
from momapos.perception.recordings.scan_reader import read_scan
from momapos.perception.records import Modeled, ScanConfig, Survey, Tools
from momapos.perception.segmentation.pointing import PointAt
from momapos.perception.segmentation.segmenter import ClassicalSegmenter
from momapos.perception.views.front_view import ViewMethod
from momapos.planning.grasps.task_requests import hand_path, make_task, openable
from momapos.planning.importance.config import ImportanceConfig
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import Method
from momapos.planning.result import PlacementResult
from momapos.workflows.joint_belief import plan_by_hypothesis
from momapos.workflows.solve import ScanTask, rank_survey, scan_to_scene, solve_scan


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, kitchen: Scene) -> Path:
    """Return a folder with a scan of a built-in kitchen."""
    path = tmp_path_factory.mktemp("scan") / "kitchen"
    write_scan(synthetic_scan(kitchen, frames=40, seed=3, sensor=DepthSensor()), path)
    return path


@pytest.fixture(scope="module")
def scan(folder: Path) -> Scan:
    """Read the scan, and fuse its cloud once."""
    scan = read_scan(folder)
    return replace(scan, cloud=fuse(scan.frames, ScanConfig().voxel, ScanConfig().fusion))


@pytest.fixture(scope="module")
def tools() -> Tools:
    network = FrontNetwork()
    return Tools(ClassicalSegmenter(), network, network, TemplatePredictor())


@pytest.fixture(scope="module")
def seen(scan: Scan, tools: Tools) -> Survey:
    return survey(scan, tools)


@pytest.fixture(scope="module")
def made(seen: Survey, tools: Tools, tmp_path_factory: pytest.TempPathFactory) -> Modeled:
    return model_room(seen, tmp_path_factory.mktemp("made") / "scene.json", tools)


def true_fridge(folder: Path) -> UprightBox:
    truth = json.loads((folder / "truth.json").read_text())
    fridge = next(o for o in truth["objects"] if o["category"] == "fridge")
    return UprightBox(np.array(fridge["center"]), np.array(fridge["size"]), fridge["yaw"])


def nearest(made: Modeled, box: UprightBox) -> str:
    gaps = {
        d.detection.name: np.linalg.norm(d.detection.box.center - box.center)
        for d in made.decisions
    }
    return min(gaps, key=lambda name: gaps[name])


def same_door(made: Modeled, folder: Path) -> tuple[str, str, float]:
    """Return the scanned fridge, its true door, and the error of its handle path [m]."""
    truth, scene = load_scene("kitchen_small"), load_scene(str(made.scene))
    name = nearest(made, true_fridge(folder))
    ours = apply(made.T_scene_scan, hand_path(truth, "fridge", "door_hinge", np.pi / 2))
    gaps = {
        joint: float(np.linalg.norm(hand_path(scene, name, joint, np.pi / 2) - ours, axis=1).max())
        for item, joint in openable(scene)
        if item == name
    }
    door = min(gaps, key=lambda joint: gaps[joint])
    return name, door, gaps[door]


def test_the_scanned_fridge_opens_like_the_true_one(made: Modeled, folder: Path) -> None:
    _, _, gap = same_door(made, folder)
    assert gap < 0.06


def test_names_follow_from_places_whatever_segments_the_room(
    scan: Scan, tools: Tools, seen: Survey
) -> None:
    rng = np.random.default_rng(5)
    own = [Instance(item.label, item.score, None, item.box) for item in seen.detections]

    def given(_: Cloud) -> list[Instance]:
        return [own[k] for k in rng.permutation(len(own))]

    again = survey(scan, replace(tools, segment=given)).detections
    assert len(again) == len(own)
    for item in seen.detections:
        apart = {d.name: float(np.linalg.norm(d.box.center - item.box.center)) for d in again}
        assert min(apart, key=lambda name: apart[name]) == item.name


@pytest.mark.parametrize(
    ("appliance", "label", "kinds"),
    [
        ("dishwasher", "cabinet", {"door_down"}),
        pytest.param("fridge", "fridge", {"door_right"}, marks=pytest.mark.slow),
    ],
)
def test_an_appliance_front_without_depth_is_completed_and_reported(
    scan: Scan,
    tools: Tools,
    appliance: str,
    label: str,
    kinds: set[str],
    tmp_path: Path,
    kitchen: Scene,
) -> None:
    low, high = kitchen.object(appliance).bounds
    front = np.array([low - 0.02, [high[0] + 0.02, low[1] + 0.14, high[2] + 0.02]])
    dark = []
    for frame in scan.frames[::2]:
        v, u = np.nonzero(frame.depth)
        rays = np.column_stack([u, v, np.ones(len(u))]) @ np.linalg.inv(frame.intrinsics).T
        points = apply(frame.T_world_camera, rays * frame.depth[v, u][:, None])
        on = ((points > front[0]) & (points < front[1])).all(axis=1)
        depth = frame.depth.copy()
        depth[v[on], u[on]] = 0.0
        dark.append(replace(frame, depth=depth))
    unseen = replace(scan, frames=tuple(dark), cloud=None)
    made = scan_to_scene(unseen, tmp_path / "scene.json", tools)
    middle = apply(made.T_scene_scan, ((low + high) / 2)[None])[0]
    name = nearest(made, UprightBox(middle, high - low))
    (found,) = [d for d in made.decisions if d.detection.name == name]
    assert found.detection.label == label
    assert np.abs(found.detection.box.center - middle)[:2].max() < 0.05
    assert found.detection.seen < 0.2
    assert {part.kind for part in found.parts} == kinds
    assert any("depth is missing" in text and name in text for text in found.warnings)
    item = next(o for o in report_to_dict(made, scan, None)["objects"] if o["name"] == name)
    assert item["completed"] == pytest.approx(found.detection.completed, abs=1e-3)


@pytest.fixture
def surveyed(seen: Survey, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the survey that exists, whatever is scanned."""
    monkeypatch.setattr("momapos.workflows.solve.survey", lambda *_, **__: seen)


@pytest.mark.usefixtures("surveyed")
def test_only_objects_that_matter_for_the_target_are_modeled(
    made: Modeled, seen: Survey, scan: Scan, tools: Tools, folder: Path, tmp_path: Path
) -> None:
    target = nearest(made, true_fridge(folder))
    scores = rank_survey(seen, target, ImportanceConfig()).by_name
    result = model_room(seen, tmp_path / "scene.json", tools, scores=scores, alpha=0.45)
    assert result.decisions[[d.detection.name for d in result.decisions].index(target)].model
    for decision in result.decisions:
        assert decision.model is None or (decision.importance or 0.0) >= 0.45
    left_out = [d for d in result.decisions if "importance" in d.reason]
    assert left_out
    assert all(d.view is None for d in left_out)
    with pytest.raises(UnknownNameError, match="object"):
        scan_to_scene(scan, tmp_path / "other.json", tools, target="frigde")
    assert not (tmp_path / "other.json").exists()


def test_given_boxes_and_models_are_used(
    scan: Scan, tools: Tools, folder: Path, tmp_path: Path
) -> None:
    box = true_fridge(folder)
    given = Tools(lambda _: [Instance("fridge", 1.0, box=box)], tools.look, tools.predict)
    kitchen = load_scene("kitchen_small").object("fridge")
    models = {"fridge": GivenModel(kitchen.model.urdf.path)}
    result = scan_to_scene(scan, tmp_path / "scene.json", given, given=models)
    scene = load_scene(str(result.scene))
    assert [d.source for d in result.decisions if not d.reason] == ["given"]
    found = scene.object("fridge_1")
    assert set(found.model.joints) == set(kitchen.model.joints)
    assert np.abs(found.bounds - kitchen.bounds).max() < 0.06


@pytest.mark.slow
def test_a_target_may_be_labeled_by_images_or_user_or_pointed_at(
    scan: Scan, tools: Tools, made: Modeled, folder: Path, tmp_path: Path
) -> None:
    fridge = true_fridge(folder)
    name, at = nearest(made, fridge), apply(made.T_scene_scan, fridge.center[None])[0]
    there = PointAt((float(at[0]), float(at[1]), float(at[2])))

    class Blind:
        labels = frozenset({"fridge", "oven", "microwave", "cup", "apple", "bottle", "bowl"})

        def __call__(self, color: np.ndarray) -> list[ImageDetection]:
            del color
            return []

    only = ImportanceConfig(alpha=1.0)
    unseen = scan_to_scene(
        scan, tmp_path / "a.json", replace(tools, detect=Blind()), target=there, importance=only
    )
    assert not {d.detection.label for d in unseen.decisions} & Blind.labels
    assert unseen.target == nearest(unseen, fridge)
    said = scan_to_scene(
        scan,
        tmp_path / "b.json",
        tools,
        target=there,
        labels={name: "wine cellar"},
        importance=only,
    )
    assert said.target == "wine_cellar_1"
    (item,) = (d.detection for d in said.decisions if d.detection.name == said.target)
    assert (item.label_from, item.score) == ("given", 1.0)


def test_a_confident_label_determines_how_an_ambiguous_part_opens(
    seen: Survey, tools: Tools, folder: Path
) -> None:
    def doubtful(face: FaceImage, label: str) -> Front:
        front = tools.look(face, label)
        odds = (("drawer", 0.6), ("door_down", 0.25), ("door_left", 0.15))
        return replace(
            front, parts=tuple(replace(part, kind="drawer", odds=odds) for part in front.parts)
        )

    unsure = replace(tools, look=doubtful, predict=doubtful)
    gaps = [
        float(np.linalg.norm(item.box.center - true_fridge(folder).center))
        for item in seen.detections
    ]
    fridge = seen.detections[int(np.argmin(gaps))]

    def odds_of(label: str, source: LabelSource) -> list[tuple[tuple[PartKind, float], ...]]:
        item = replace(fridge, label=label, label_from=source, score=1.0)
        return [part.odds for part in decide(item, None, seen, unsure, {}, ScanConfig()).parts]

    kinds: tuple[tuple[str, LabelSource, PartKind], ...] = (
        ("oven", "given", "door_down"),
        ("oven", "detector", "door_down"),
        ("fridge", "detector", "drawer"),
        ("cabinet", "given", "drawer"),
    )
    for label, source, kind in kinds:
        assert {odds[0][0] for odds in odds_of(label, source)} == {kind}
    by_size = odds_of("cabinet", "size")
    assert by_size
    assert odds_of("oven", "size") == by_size
    hung = next(item for item in seen.detections if item.name.startswith("wall"))
    parts = decide(hung, None, seen, unsure, {}, ScanConfig()).parts
    assert {part.kind for part in parts} == {"door_left"}  # nothing slides above the eyes


def test_a_scene_has_the_confidences_of_its_scan(made: Modeled) -> None:
    scene = load_scene(str(made.scene))
    assert scene.warnings == ()
    for decision in made.decisions:
        sure = scene.object(decision.detection.name).confidence
        if decision.reason == "wall":
            assert sure is None
            continue
        assert sure.object == pytest.approx(decision.detection.seen, abs=1e-3)
        assert sure.label == pytest.approx(decision.detection.score, abs=1e-3)
        joints = scene.object(decision.detection.name).model.joints
        assert set(sure.joints) == set(joints)
        assert all(0 < value <= 1 for value in (*sure.joints.values(), *sure.handles.values()))


def test_the_report_gives_a_reason_for_every_object(
    made: Modeled, scan: Scan, tmp_path: Path
) -> None:
    data = report_to_dict(made, scan, None)
    out = tmp_path / "scene.json"
    folder = write_report(replace(made, scene=out), data, made.scene, pictures=True)
    report = json.loads((made.scene.parent / "scan_report.json").read_text())
    assert report["format"] == "momapos-scan-report"
    looked_at = [item for item in report["objects"] if item["view"] is not None]
    figures = {path.name for path in folder.glob("*.png")}
    overviews = {name for name in figures if name.startswith("overview_")}
    assert {f"{item['name']}.png" for item in looked_at} == figures - overviews
    assert 1 <= len(overviews) <= 4
    for item in report["objects"]:
        assert item["modelled"] == (item["reason"] is None)
        assert len(item["parts"]) > 0 or not item["modelled"]


def test_an_empty_room_is_refused(scan: Scan, tools: Tools, tmp_path: Path) -> None:
    nothing = replace(tools, segment=lambda _: [])
    with pytest.raises(InputError, match="no object was found"):
        scan_to_scene(scan, tmp_path / "scene.json", nothing)
    assert list(tmp_path.iterdir()) == []


def test_the_command_prints_one_json_object(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "scene.json"
    words = [
        "scan",
        str(folder),
        "--out",
        str(out),
        "--json",
        "--no-pictures",
        "--max-frames",
        "12",
    ]
    data = json_of(*words)
    assert data["frames"] == 12
    assert len(load_scene(str(out)).objects) == len(data["objects"])


def refused(folder: Path, out: Path, words: list[str], says: str) -> None:
    given = [str(folder) if word == "SCAN" else word for word in words]
    assert says in error_of("scan", *given, "--out", str(out), "--max-frames", "12")
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nowhere"], "nowhere"),
        (["SCAN", "--models", "fridge"], "NAME=FILE"),
        (["SCAN", "--instances", "missing.json"], "missing.json"),
    ],
)
def test_wrong_options_are_refused_in_one_line(
    folder: Path, tmp_path: Path, words: list[str], says: str
) -> None:
    refused(folder, tmp_path / "scene.json", words, says)


@pytest.mark.usefixtures("surveyed")
def test_an_unknown_target_is_refused_in_one_line(folder: Path, tmp_path: Path) -> None:
    refused(folder, tmp_path / "scene.json", ["SCAN", "--target", "frigde"], "frigde")


@pytest.mark.slow
def test_a_failed_task_is_replanned_with_more_objects_until_all_are_modeled(
    made: Modeled, scan: Scan, tools: Tools, tmp_path: Path, husky: Robot
) -> None:
    looks = 0

    def counted(face: FaceImage, label: str) -> Front:
        nonlocal looks
        looks += 1
        return tools.look(face, label)

    name, joint = next(x for x in openable(load_scene(made.scene)) if x[0].startswith("wall"))
    config = PipelineConfig(
        place=PlaceConfig(grid=False, rounds=1), importance=ImportanceConfig(alpha=0.9)
    )
    counting = replace(tools, look=counted, predict=counted)
    out = tmp_path / "scene.json"
    scan_to_scene(scan, out, counting)
    all_at_once, looks = looks, 0
    answer = solve_scan(
        scan, [(husky, load_reach_map(husky))], ScanTask("open", name, joint), out,
        tools=counting, config=config,
    )  # fmt: skip
    assert answer.result.plan.status == "infeasible"
    assert len(answer.alphas) > 1
    assert list(answer.alphas) == sorted(answer.alphas, reverse=True)
    assert all(decision.looked for decision in answer.modeled.decisions)
    assert looks == all_at_once  # nothing is looked at twice


def test_one_command_plans_the_opening_of_a_door_from_a_scan(
    made: Modeled, folder: Path, tmp_path: Path
) -> None:
    name, door, _ = same_door(made, folder)
    out = tmp_path / "new" / "solved"
    words = ["solve", str(folder), "open", f"{name}/{door}", "--robot", "segway_ur5e"]
    words += ["--max-frames", "20", "--out", str(out), "--json", "--no-pictures"]
    words += ["--world", "kitchen_small", "--tolerance"]
    record = json_of(*words)
    assert (record["status"], record["done"]) == ("solved", True)
    assert record == json.loads((out / "solve.json").read_text())
    Draft202012Validator(schema_of("solve")).validate(record)
    assert set(record) <= set(schema_of("solve")["properties"])
    assert name in record["modeled"]
    assert len(record["modeled"]) < sum(d.model is not None for d in made.decisions)
    stages = {k: v for k, v in record["timing"].items() if k != "total"}
    assert {"fuse", "boxes", "rows", "importance", "model", "place", "execute"} <= set(stages)
    assert sum(stages.values()) <= record["timing"]["total"] + 0.01
    plan = json.loads((out / record["plan"]).read_text())
    assert plan["tolerance"]["samples"] == 100
    assert plan["tolerance"]["radius"] > 0.0
    assert main(["verify", str(out / record["plan"])]) == 0
    run = json.loads((out / record["run"]).read_text())
    assert run["success"]
    assert (run["true_task"]["object"], run["true_task"]["joint"]) == ("fridge", "door_hinge")


@pytest.mark.parametrize(
    ("method", "views", "taken"),
    [
        ("paper", None, "first"),
        ("paper", "voting", "voting"),
        ("exhaustive", None, "voting"),
        pytest.param("exhaustive", "first", "first", marks=pytest.mark.slow),
    ],
)
def test_the_method_chooses_the_views_unless_they_are_given(
    method: Method,
    views: ViewMethod | None,
    taken: ViewMethod,
    seen: Survey,
    made: Modeled,
    scan: Scan,
    tools: Tools,
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    segway: Robot,
) -> None:
    monkeypatch.setattr("momapos.workflows.solve.survey", lambda *_, **__: seen)
    (name, door, _) = same_door(made, folder)
    config = PipelineConfig(
        place=PlaceConfig(method=method), importance=ImportanceConfig(alpha=1.0), timeout=1.0
    )
    answer = solve_scan(
        scan, [(segway, load_reach_map(segway))], ScanTask("open", name, door),
        tmp_path / "scene.json", tools=tools, config=config, scanning=ScanConfig(views=views),
    )  # fmt: skip
    assert answer.scanning.views == taken
    (target,) = (d for d in answer.modeled.decisions if d.detection.name == name)
    assert (target.view.evidence == ()) == (taken == "first")  # the first image asks no others


def test_a_detector_locates_objects_for_the_views_of_the_paper_alone(
    scan: Scan, tools: Tools
) -> None:
    class Seeing:
        labels = frozenset({"fridge"})

        def __call__(self, color: np.ndarray) -> list[ImageDetection]:
            height, width = color.shape[:2]
            return [ImageDetection((0.0, 0.0, float(width), float(height)), "fridge", 0.9)]

    points, normals, colors = (
        a[::20] for a in (scan.cloud.points, scan.cloud.normals, scan.cloud.colors)
    )
    few = replace(scan, frames=scan.frames[:2], cloud=Cloud(points, normals, colors))
    seeing = replace(tools, detect=Seeing())
    located = survey(few, seeing, config=ScanConfig(views="first")).found
    assert set(located) == {frame.name for frame in few.frames}
    assert survey(few, seeing).found is None
    given = {few.frames[0].name: Seeing()(few.frames[0].color)}
    assert survey(few, seeing, found=given).found is given


def test_one_command_goes_from_a_scan_to_a_plan_as_the_paper_prints_it(
    made: Modeled, folder: Path, tmp_path: Path
) -> None:
    name, door, _ = same_door(made, folder)
    out = tmp_path / "solved"
    words = ["solve", str(folder), "open", f"{name}/{door}", "--robot", "segway_ur5e"]
    words += ["--out", str(out), "--no-pictures", "--no-run"]
    text = output_of(*words, "--method", "paper")
    assert "by the first frontal image" in text
    record = json.loads((out / "solve.json").read_text())
    assert (record["status"], record["method"]) == ("solved", "paper")
    assert record["views"] == "first"
    assert list(record["stand_ins"]) == ["Detectron2", "ResNet50", "URDFormer", "Mask3D"]
    assert all(f"{network}: {what}" in text for network, what in record["stand_ins"].items())
    report = json.loads((out / "scan_report.json").read_text())
    (target,) = (item for item in report["objects"] if item["name"] == name)
    assert target["view"]["evidence"] == []
    assert main(["verify", str(out / record["plan"])]) == 0


@pytest.mark.slow
def test_no_opening_of_a_scanned_kitchen_is_solved_for_an_improbable_joint(
    made: Modeled, segway: Robot
) -> None:
    scene = load_scene(made.scene)
    reach, statuses = load_reach_map(segway), []

    def plan(scene: Scene, task: Task) -> list[PlacementResult]:
        return [plan_base_placement(scene, segway, task, reach)]

    for name, joint in openable(scene)[:20]:
        hypotheses = scene.object(name).hypotheses[joint]
        _, _, (answer,) = plan_by_hypothesis(scene, make_task(scene, "open", name, joint), plan)
        statuses.append(answer.plan.status)
        if statuses[-1] == "solved":
            assert hypotheses[0].probability >= 0.5, f"{name}/{joint}"
    assert "solved" in statuses


@pytest.mark.slow
def test_a_target_that_the_scan_does_not_show_is_refused_in_one_line(
    made: Modeled, folder: Path, tmp_path: Path
) -> None:
    box = next(d.detection.name for d in made.decisions if d.looked and d.view is None)
    for target, message in ((box, "no door or drawer was found"), ("frigde", "mean")):
        words = ["solve", str(folder), "open", target, "--out", str(tmp_path / "solved")]
        assert message in error_of(*words)
