"""JSON Schemas accept all our files, refuse wrong ones, and stand in the documentation."""

from __future__ import annotations

import copy
import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import docs_hooks
import jsonschema
import pytest
from jsonschema import Draft202012Validator
from tests.commands import error_of, output_of

from momapos.apps.bench.bench_records import Row, to_plain
from momapos.apps.cli.main import main
from momapos.apps.schemas.generate import SCHEMAS, field_list, schema_of
from momapos.core.errors import InputError
from momapos.model.plan_files.plan_format import plan_to_dict, read_plan, write_plan
from momapos.model.plan_files.tour_format import TourFile, TourStep, tour_to_dict
from momapos.model.records.plans import PlacementPlan, Task
from momapos.model.robots.robot import Robot
from momapos.model.robots.robot_names import library_file, library_names
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_names import LIBRARY, builtin_names
from momapos.model.trajectory import with_times
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.simulation.run_record import (
    Collision,
    Execution,
    RunMotion,
    RunRecord,
    Visit,
    run_to_dict,
)

DOCS = Path(__file__).parents[3] / "docs"


def check(name: str, data: Any) -> None:
    """Check the content of a file, as JSON has it."""
    Draft202012Validator(schema_of(name)).validate(json.loads(json.dumps(data)))


def unknown(data: Any, name: str) -> set[str]:
    """Return messages about members of a file that its schema does not name."""
    closed = copy.deepcopy(schema_of(name))
    for record in (closed, *closed.get("$defs", {}).values()):
        if "properties" in record:
            record["additionalProperties"] = False
    errors = Draft202012Validator(closed).iter_errors(json.loads(json.dumps(data)))
    return {error.message for error in errors}


@pytest.fixture(scope="module")
def plans(kitchen: Scene, segway: Robot) -> dict[str, PlacementPlan]:
    found = {
        "solved": make_task(kitchen, "open", "fridge", "door_hinge"),
        "infeasible": make_task(kitchen, "open", "dishwasher"),
    }
    return {
        name: with_times(plan_base_placement(kitchen, segway, task).with_notes().plan, segway)
        for name, task in found.items()
    }


def a_run() -> RunRecord:
    """Return a record in which most optional members have a value."""
    pose = (1.0, 2.0, 0.5)
    done = Execution(
        True, "", "contact", 0.0, 1.5, 1.49,
        collisions=(Collision("hand", "fridge/body", 3.0, 0.001, 0.1, 2.0, "open"),),
        stability=0.1, clearance=0.02, base_pose=pose, notes=("note",), time={"open": 2.0},
    )  # fmt: skip
    visit = Visit(pose, pose, 1.0, 3.0, "")
    return RunRecord(
        "room.json", "fetch", Task("open", "fridge", "door", 1.5), (visit,), done, failed=(done,),
        seed=3, noise=True, plan="plan.json", world_at=pose,
        motion=RunMotion((0.0, 1.0), ("drive", "open"), (pose, pose), {"pan": (0.0, 0.1)}),
    )  # fmt: skip


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_schema_is_valid_json_schema(name: str) -> None:
    made = schema_of(name)
    Draft202012Validator.check_schema(made)
    assert made["title"]
    assert made["description"]


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_member_of_a_file_is_described(name: str) -> None:
    made = schema_of(name)
    for record in (made, *made.get("$defs", {}).values()):
        for member, part in record.get("properties", {}).items():
            assert part.get("description"), member


@pytest.mark.parametrize("name", builtin_names())
def test_built_in_scenes_match_their_schema(name: str, tmp_path: Path) -> None:
    check("scene", json.loads((LIBRARY / f"{name}.json").read_text()))
    scene = load_scene(name)
    boxes = tuple(item for item in scene.objects if item.model.urdf.path is None)
    save_scene(replace(scene, objects=boxes), tmp_path / "again.json")
    check("scene", json.loads((tmp_path / "again.json").read_text()))


@pytest.mark.parametrize("name", library_names())
def test_robots_of_the_library_match_their_schema(name: str) -> None:
    check("robot", tomllib.loads(library_file(name).read_text()))


@pytest.mark.parametrize("status", ["solved", "infeasible"])
def test_plans_match_their_schema_and_have_no_other_member(
    plans: dict[str, PlacementPlan], status: str, tmp_path: Path
) -> None:
    plan = plans[status]
    assert plan.status == status
    write_plan(plan, tmp_path / "plan.json")
    data = json.loads((tmp_path / "plan.json").read_text())
    check("plan", data)
    assert unknown(data, "plan") == set()
    assert unknown(plan_to_dict(read_plan(tmp_path / "plan.json")), "plan") == set()


def test_version_2_has_a_pose_of_the_base_at_each_state(plans: dict[str, PlacementPlan]) -> None:
    data = plan_to_dict(plans["solved"])
    states = len(data["manipulation"]["q"])
    data["version"], data["manipulation"]["base"] = 2, [[0.0, 1.0, 0.5]] * states
    check("plan2", data)
    for wrong in ([[0.0, 1.0]], [[0.0, 1.0, "x"]], None):
        changed = copy.deepcopy(data)
        changed["manipulation"]["base"] = wrong
        with pytest.raises(jsonschema.ValidationError):
            check("plan2", changed)
    with pytest.raises(jsonschema.ValidationError):
        check("plan", data)


def test_other_records_match_their_schemas_and_have_no_other_member() -> None:
    tour = TourFile("solved", (TourStep(1, "a.json"),), 1, 2.5, ("carries cup",))
    row = Row("k", "task", "group", "fetch", "ours", 1, "solved", bases=((1.0, 2.0, 0.5),))
    for name, data in (
        ("tour", tour_to_dict(tour, ["a.json"])), ("run", run_to_dict(a_run())),
        ("bench-row", to_plain(row)),
    ):  # fmt: skip
        check(name, data)
        assert unknown(data, name) == set()


@pytest.mark.parametrize("name", ["scene", "robot", "plan"])
def test_files_without_a_required_member_or_with_a_wrong_type_do_not_match(
    name: str, plans: dict[str, PlacementPlan]
) -> None:
    good: dict[str, Any] = {
        "scene": json.loads((LIBRARY / "kitchen_small.json").read_text()),
        "robot": tomllib.loads(library_file("fetch").read_text()),
        "plan": plan_to_dict(plans["solved"]),
    }[name]
    check(name, good)
    required = schema_of(name)["required"]
    assert required
    for member in required:
        without = {key: value for key, value in good.items() if key != member}
        for changed in (without, {**good, member: 1.5}, {**good, member: [None]}):
            with pytest.raises(jsonschema.ValidationError):
                check(name, changed)


WRONG: list[tuple[tuple[str | int, ...], Any]] = [
    (("floor", 0, 0), 1e5), (("walls",), [{"from": [0, 0], "to": [1, 0], "thickness": 0.0}]),
    (("areas",), {"a": [[0, 0], [1, 0]]}), (("start", "yaw"), 1e5),
    (("objects", 0, "urdf"), None), (("objects", 0, "mass"), None), (("objects", 0, "mass"), 2e5),
    (("objects", 0, "pose", "xyz", 2), 1e5), (("objects", 0, "confidence"), {"object": 0.5}),
    (("objects", 0, "resistance"), {"door_hinge": {"friction": -1.0}}),
    (("objects", 0, "resistance"), {"door_hinge": {"fricton": 1.0}}),
    (("objects", 0, "hypotheses"), {"door_hinge": []}),
    (("objects", 0, "hypotheses"), {"door_hinge": [
        {"kind": "hinge_left", "probability": 1, "point": [0, 0, 0], "axis": [0, 0, 1], "upper": 1}
    ]}),
]  # fmt: skip


@pytest.mark.parametrize(("where", "value"), WRONG)
def test_the_schema_of_scenes_refuses_what_the_reader_refuses(
    where: tuple[str | int, ...], value: Any, tmp_path: Path
) -> None:
    scene: Any = json.loads((LIBRARY / "kitchen_small.json").read_text())
    shutil.copytree(LIBRARY, tmp_path / "library")
    scene["objects"] = [one for one in scene["objects"] if one["name"] == "fridge"]
    check("scene", scene)
    part = scene
    for key in where[:-1]:
        part = part[key]
    part[where[-1]] = value
    with pytest.raises(jsonschema.ValidationError):
        check("scene", scene)
    file = tmp_path / "library" / "wrong.json"
    file.write_text(json.dumps(scene))
    with pytest.raises(InputError):
        load_scene(file)


def test_misspelled_members_of_files_that_people_write_do_not_match() -> None:
    scene = json.loads((LIBRARY / "kitchen_small.json").read_text())
    scene["objects"][0]["pose"]["rpy"] = [0, 0, 0]
    robot = tomllib.loads(library_file("fetch").read_text())
    robot["base"]["max_sped"] = 1.0
    for name, data in (("scene", scene), ("robot", robot)):
        with pytest.raises(jsonschema.ValidationError):
            check(name, data)


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_documentation_has_each_schema(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", name]) == 0
    file = DOCS / "schemas" / f"{name}.schema.json"
    assert file.read_text() == capsys.readouterr().out, f"momapos schema {name} > {file}"


def test_the_documentation_lists_the_members() -> None:
    shown = output_of("schema", "--fields")
    page: Any = SimpleNamespace(file=SimpleNamespace(src_uri="formats.md"))
    nothing: Any = None
    site = docs_hooks.on_page_markdown("# Formats", page=page, config=nothing, files=nothing)
    assert site == f"# Formats\n\n{shown}"
    for name in SCHEMAS:
        made = schema_of(name)
        for record in (made, *made.get("$defs", {}).values()):
            assert all(f"| `{member}` |" in shown for member in record.get("properties", ()))


def test_a_member_is_listed_once_with_its_default() -> None:
    robot, both = field_list(("robot",)), field_list(("plan", "plan2"))
    assert "| `max_speed` | number | `0.5` | [m/s] |" in robot
    assert "| `base_link` | string | required |" in robot
    assert both.count("| `base_path` |") == 1
    assert both.count("| `version` |") == 2


def test_the_command_lists_the_formats_and_refuses_others() -> None:
    listed = output_of("schema")
    assert all(f"{name} " in listed for name in SCHEMAS)
    assert "did you mean plan" in error_of("schema", "plna")
