"""The suite of arm motions reads MoveIt's files, plans, and counts what it cannot use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.commands import error_of, json_of, output_of
from tests.urdf_parts import LIMIT, joint, link

from momapos.apps.bench.arm_suite import (
    ARM_FILE,
    ProblemFiles,
    arm_heading,
    arm_tables,
    find_problems,
    read_arm_results,
    read_problem,
    run_arm_suite,
    spread_problems,
    write_arm_results,
)
from momapos.apps.bench.metrics import markdown
from momapos.core.errors import FileFormatError, InputError

PILLAR = {"type": "cylinder", "dimensions": [0.6, 0.3]}


def gantry(folder: Path) -> Path:
    """Write a ball that two rails move in a plane; its hand is a finger that stays."""
    limit = LIMIT.format(-3, 3)
    parts = [
        link("root"),
        joint("x", "prismatic", "root", "rail", "0 0 0.3", "1 0 0", limit),
        link("rail"),
        joint("y", "prismatic", "rail", "ball", "0 0 0", "0 1 0", limit),
        link("ball", '<sphere radius="0.01"/>'),
        joint("finger", "prismatic", "ball", "tip", "0 0 0", "0 0 1", limit),
        link("tip", '<sphere radius="0.005"/>'),
    ]
    path = folder / "gantry.urdf"
    path.write_text(f'<robot name="any">{"".join(parts)}</robot>')
    return path


def scene(*shapes: dict[str, Any], at: tuple[float, ...] = (0.0, 0.0, 0.3)) -> dict[str, Any]:
    """Return a planning scene with an object per shape."""
    pose = {"position": list(at), "orientation": [0, 0, 0, 1]}
    items = [
        {"id": f"block{k}", "primitives": [shape], "primitive_poses": [pose]}
        for k, shape in enumerate(shapes)
    ]
    return {"robot_model_name": "any", "world": {"collision_objects": items}}


def request(start: tuple[float, float], goal: dict[str, float]) -> dict[str, Any]:
    """Return a motion plan request."""
    names = [*goal, "finger"]
    wanted = [{"joint_name": name, "position": value} for name, value in goal.items()]
    return {
        "group_name": "rails",
        "start_state": {"joint_state": {"name": names, "position": [*start, 0.02]}},
        "goal_constraints": [{"joint_constraints": wanted}],
    }


def write(folder: Path, kind: str, number: int, what: Any, ends: Any) -> ProblemFiles:
    """Write a problem of the gantry."""
    place = folder / f"{kind}_gantry"
    place.mkdir(parents=True, exist_ok=True)
    files = ProblemFiles(
        kind, f"{number:04d}", place / f"scene{number:04d}.yaml",
        place / f"request{number:04d}.yaml",
    )  # fmt: skip
    files.scene.write_text(what if isinstance(what, str) else yaml.safe_dump(what))
    files.request.write_text(yaml.safe_dump(ends))
    return files


ACROSS = request((-1.0, 0.0), {"x": 1.0, "y": 0.0})


def test_a_cylinder_is_a_cylinder_and_the_way_around_it_is_short(tmp_path: Path) -> None:
    """Corners of the box around the cylinder are free, where the goal of the second one is."""
    urdf, folder = gantry(tmp_path), tmp_path / "problems"
    write(folder, "pillar", 1, scene(PILLAR), ACROSS)
    write(folder, "pillar", 2, scene(PILLAR), request((-1.0, 0.0), {"x": 0.25, "y": 0.25}))
    box = {"type": "box", "dimensions": [0.6, 0.6, 0.6]}
    write(folder, "block", 1, scene(box), request((-1.0, 0.0), {"x": 0.25, "y": 0.25}))
    found = run_arm_suite(folder, [str(urdf)], ["ours"])
    results = {(row.kind, row.problem): row for row in found.rows}
    first, second = results["pillar", "0001"], results["pillar", "0002"]
    assert first.result == second.result == "solved"
    assert first.length is not None
    assert first.seconds is not None
    # Tangents to a circle of 0.31 m from both ends, and the arc between.
    reach = 0.31
    shortest = 2 * np.sqrt(1 - reach**2) + reach * (np.pi - 2 * np.arccos(reach))
    assert shortest - 0.02 < first.length < 1.15 * shortest
    assert results["block", "0001"].result == "invalid ends"
    assert results["block", "0001"].reason == "goal touches block0"


def test_an_object_has_a_pose_and_shapes_have_numbers_too(tmp_path: Path) -> None:
    what = scene({"type": 3, "dimensions": [0.4, 0.1]}, {"type": 1, "dimensions": [0.2, 0.4, 0.6]})
    half = float(np.sqrt(0.5))
    for item in what["world"]["collision_objects"]:
        item["pose"] = {"position": [1.0, 0.0, 0.0], "orientation": [0.0, 0.0, half, half]}
        item["primitive_poses"] = [{"position": [0.5, 0.0, 0.0], "orientation": [0, 0, 0, 1]}]
    found = read_problem(write(tmp_path, "odd", 1, what, ACROSS))
    np.testing.assert_allclose(found.boxes.center, [[1.0, 0.5, 0.0]] * 2, atol=1e-12)
    np.testing.assert_allclose(found.boxes.half, [[0.1, 0.1, 0.2], [0.1, 0.2, 0.3]])
    assert found.cylinder.tolist() == [True, False]
    assert (found.group, found.start["finger"], found.goal) == ("rails", 0.02, {"x": 1, "y": 0})


def changed(what: dict[str, Any], **values: Any) -> dict[str, Any]:
    """Return a scene whose first object has other values."""
    what["world"]["collision_objects"][0].update(values)
    return what


@pytest.mark.parametrize(
    ("what", "ends", "words"),
    [
        (scene({"type": "cone", "dimensions": [1, 1]}), ACROSS, "'block0'.*'cone' is not supp"),
        (scene({"type": "sphere", "dimensions": [1]}), ACROSS, "'sphere' is not supported"),
        (scene({"type": "box", "dimensions": [1, 1]}), ACROSS, "must be 3 numbers"),
        (scene({"type": "cylinder", "dimensions": [1, -1]}), ACROSS, "numbers above 0"),
        (scene({"type": "box", "dimensions": [1, 1, "x"]}), ACROSS, r"dimensions\[2\]"),
        (scene({"type": "box", "dimensions": [1, 1, float("inf")]}), ACROSS, "below 100 m"),
        (changed(scene(PILLAR), meshes=[{}]), ACROSS, "meshes and planes"),
        (changed(scene(PILLAR), primitive_poses=[]), ACROSS, "differ in number"),
        (scene(PILLAR, at=(0.0, 0.0, float("nan"))), ACROSS, "is not below 100"),
        (
            changed(scene(PILLAR), primitive_poses=[{"orientation": [0, 0, 0, 0]}]), ACROSS,
            "unit quaternion",
        ),
        ("world: [", ACROSS, "invalid YAML"),
        ("world: !!python/object:os.system {}", ACROSS, "tag"),
        ({"name": "empty"}, ACROSS, "world"),
        (scene(), {**ACROSS, "goal_constraints": []}, "one set of joint constraints"),
        (scene(), {**ACROSS, "goal_constraints": [{"position_constraints": [{}]}]}, "only joint"),
        (scene(), {**ACROSS, "path_constraints": {"joint_constraints": [1]}}, "path_constraints"),
        (scene(), request((0.0, 0.0), {"x": float("nan"), "y": 0.0}), "not finite"),
    ],
)  # fmt: skip
def test_files_that_cannot_be_planned_with_are_refused_in_one_line(
    tmp_path: Path, what: Any, ends: Any, words: str
) -> None:
    with pytest.raises(FileFormatError, match=words) as caught:
        read_problem(write(tmp_path, "wrong", 1, what, ends))
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_groups_and_ends_beyond_limits_are_counted(tmp_path: Path) -> None:
    urdf, folder = gantry(tmp_path), tmp_path / "problems"
    write(folder, "a", 1, scene(PILLAR), ACROSS)
    write(folder, "a", 2, scene(PILLAR), request((0.0, 0.0), {"x": 1.0, "elbow": 0.0}))
    write(folder, "a", 3, scene(PILLAR), request((-1.0, 0.0), {"x": 3.5, "y": 0.0}))
    write(folder, "a", 4, scene({"type": "cone", "dimensions": [1, 1]}), ACROSS)
    rows = run_arm_suite(folder, [str(urdf)], ["ours"]).rows
    assert [row.result for row in rows] == ["solved", "refused", "invalid ends", "refused"]
    assert "no movable joint elbow" in rows[1].reason
    assert rows[2].reason == "goal is beyond the limit of x"


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        ({"panda_joint1": 0.0}, "another joint group, 'rails': fetch's arm has no panda_joint1"),
        ({"shoulder_pan_joint": 0.0}, "fetch's arm also has elbow_flex_joint"),
    ],
)
def test_a_robot_of_the_library_refuses_requests_of_other_groups(
    tmp_path: Path, goal: dict[str, float], words: str
) -> None:
    files = write(tmp_path / "x", "a", 1, scene(), request((0.0,), goal))  # type: ignore[arg-type]
    files.scene.parent.rename(tmp_path / "x" / "a_fetch")
    with pytest.raises(InputError, match=words):
        run_arm_suite(tmp_path / "x", ["fetch"], ["ours"])


def test_a_limit_takes_the_first_problems_of_every_kind(tmp_path: Path) -> None:
    for kind in ("a", "b_c"):
        for number in (1, 2, 3):
            write(tmp_path, kind, number, scene(), ACROSS)
    (tmp_path / "a_gantry" / "request0002.yaml").unlink()
    files = find_problems(tmp_path, "gantry")
    assert [(one.kind, one.number) for one in spread_problems(files, 3)] == [
        ("a", "0001"), ("a", "0003"), ("b_c", "0001"),
    ]  # fmt: skip
    assert spread_problems(files, 0) == files
    with pytest.raises(InputError, match="KIND_ur5; it has folders for gantry"):
        find_problems(tmp_path, "ur5")


def test_the_command_writes_results_and_the_report_shows_them(tmp_path: Path) -> None:
    urdf, folder, out = gantry(tmp_path), tmp_path / "problems", tmp_path / "out"
    write(folder, "tall_pillar", 1, scene(PILLAR), ACROSS)
    write(folder, "tall_pillar", 2, scene(PILLAR), request((0.0, 0.0), {"x": 1.0, "y": 0.0}))
    run = ["bench", "run", "motionbenchmaker", "--out", str(out)]
    given = ["--problems", str(folder), "--robots", str(urdf)]
    assert json_of(*run, *given, "--json")["results"] == {
        "gantry, ours": {"solved": 1, "invalid ends": 1}
    }
    text = output_of("bench", "report", str(out))
    assert "| tall pillar | 2 | 1 | 1 |" in text
    assert "| invalid ends | start touches block0 | 1 |" in text
    found = read_arm_results(out)
    assert markdown(arm_heading(found), arm_tables(found)) == text.rstrip("\n")
    write_arm_results(found, tmp_path)
    assert (tmp_path / ARM_FILE).read_bytes() == (out / ARM_FILE).read_bytes()
    (out / ARM_FILE).write_text('{"format": "momapos-bench"}')
    with pytest.raises(FileFormatError, match=ARM_FILE):
        read_arm_results(out)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ([], "needs --problems"),
        (["--problems", "none"], "none: is not a folder"),
        (["--problems", ".", "--robots", "fetsh"], "fetch"),
        (["--problems", ".", "--robots", "gone.urdf"], "no file gone.urdf"),
        (["--problems", ".", "--methods", "paper"], "arm planner"),
        (["--problems", ".", "--execute", "--scan", "3"], "leave out --execute, --scan"),
    ],
)
def test_wrong_options_end_with_one_line_and_status_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: list[str], words: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert words in error_of("bench", "run", "motionbenchmaker", "--out", "out", *given)
    assert "--problems is for articulated, motionbenchmaker" in error_of(
        "bench", "run", "smoke", "--out", "out", "--problems", "."
    )
