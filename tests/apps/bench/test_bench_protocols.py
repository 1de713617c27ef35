"""Laws of protocols: the first base pose counts, or all; one grasp, pinches, or all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.apps.bench.fakes import suite, task
from tests.commands import error_of, json_of, output_of

from momapos.apps.bench import job as steps
from momapos.apps.bench.bench_records import (
    Commit,
    GraspSet,
    Job,
    Protocol,
    Row,
    Settings,
    SuiteTask,
)
from momapos.apps.bench.job import answer_job
from momapos.apps.bench.methods import method_config
from momapos.apps.bench.runner import failed_row, jobs_of
from momapos.apps.bench.suites import SUITES, protocols_of
from momapos.core.errors import FileFormatError, InputError
from momapos.planning.query import PlacementQuery
from momapos.planning.result import PlacementResult

DRAWER = SuiteTask(
    "d", "drawer", "kitchen_small", "segway_ur5e", "open", "cabinet_left", "drawer_slide"
)
CUP = replace(DRAWER, group="pick", verb="pick", object="cup", joint=None)
FRIDGE = SuiteTask("f", "door", "kitchen_small", "segway_ur5e", "open", "fridge", "door_hinge")
ALL = [
    Protocol(commit, grasps) for commit in ("first", "retry") for grasps in ("one", "pinch", "all")
]


def answer(
    one: SuiteTask,
    method: str,
    protocol: Protocol,
    monkeypatch: pytest.MonkeyPatch,
    timeout: float = 10.0,
) -> tuple[Row, PlacementResult]:
    """Run a job; return its row and the planner's result."""
    seen: list[PlacementResult] = []
    plan = steps.plan_with_method

    def watched(query: PlacementQuery) -> PlacementResult:
        seen.append(plan(query))
        return seen[-1]

    with monkeypatch.context() as patch:
        patch.setattr(steps, "plan_with_method", watched)
        job = Job("key", "unused", one, method, Settings(timeout=timeout), protocol)
        row = answer_job(job)
    assert row.protocol == str(protocol)
    return row, seen[-1]


@pytest.mark.parametrize("protocol", ALL, ids=str)
def test_a_protocol_is_read_from_its_words(protocol: Protocol) -> None:
    assert Protocol.of(str(protocol)) == protocol
    with pytest.raises(FileFormatError, match="protocol 'second, all'"):
        Protocol.of("second, all")


@pytest.mark.parametrize("method", ["habitat", "m3", "reuleaux", "paper:paper.check_stops=false"])
def test_after_the_first_base_pose_no_other_is_tried(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, result = answer(FRIDGE, method, Protocol("first", "all"), monkeypatch)
    again, free = answer(FRIDGE, method, Protocol("retry", "all"), monkeypatch)
    assert (first.sampled, len(result.search.poses)) == (1, 1)
    assert again.sampled >= 1
    proposed = result.search.poses[0][0]
    if first.outcome == "solved":
        assert first.bases == pytest.approx(np.array([proposed]))
        assert first.bases == again.bases
    else:
        assert first.outcome == "gave up"
        assert free.search.base is None or not (free.search.base == proposed).all()


@pytest.mark.parametrize("method", ["ours", "paper"])
def test_a_method_that_checks_its_poses_proposes_the_one_that_works(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, _ = answer(DRAWER, method, Protocol("first", "pinch"), monkeypatch)
    again, _ = answer(DRAWER, method, Protocol("retry", "pinch"), monkeypatch)
    assert (first.outcome, first.bases) == (again.outcome, again.bases)
    assert first.outcome == "solved"


@pytest.mark.parametrize("one", [FRIDGE, CUP])
def test_pinches_are_straight_holds_and_the_one_grasp_is_among_them(
    one: SuiteTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = {}
    for grasps in ("one", "pinch", "all"):
        protocol = Protocol("retry", grasps)  # type: ignore[arg-type]
        row, result = answer(one, "habitat", protocol, monkeypatch, timeout=2.0)
        found[grasps] = result.prepared.motion
        if row.outcome == "solved" and grasps != "all":
            holds = result.plan.motion.holds
            assert {hold.family for hold in holds} <= {"pinch"}
            assert all(hold.turn_axis is None for hold in holds)
    counts = {grasps: len(motion.Ts_world_tool) for grasps, motion in found.items()}
    assert counts["one"] == 1 < counts["pinch"] <= counts["all"]
    (single,) = found["one"].Ts_world_tool
    away = np.abs(found["pinch"].Ts_world_tool - single).max((1, 2, 3))
    assert away.min() < 1e-6


def test_if_the_first_base_pose_counts_a_container_is_opened_from_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The object in the drawer is too high in it to be picked."""
    tried: list[object] = []
    monkeypatch.setattr(
        steps.StepPlanner,
        "other_poses",
        lambda *given: tried.append(given),  # returns None
    )
    failed = (None, ("gave up", "out of reach"))
    monkeypatch.setattr(steps, "_next_plan", lambda *_: failed)
    monkeypatch.setattr(steps, "opened", lambda scene, *_: scene)
    box = steps.Container("cabinet_left", "drawer_slide")
    inside = replace(CUP, inside=box)
    for commit, count in (("first", 0), ("retry", 1)):
        tried.clear()
        protocol = Protocol(commit, "all")  # type: ignore[arg-type]
        job = Job("key", "unused", inside, "habitat", Settings(timeout=10.0), protocol)
        assert answer_job(job).reason == "out of reach"
        assert len(tried) == count


def test_every_protocol_is_a_job_of_its_own_and_determines_its_key() -> None:
    jobs = jobs_of(
        suite(task("task")), ["ours", "m3"], Path("x"), Settings(protocols=tuple(ALL)), {}
    )
    assert len({job.key for job in jobs}) == len(jobs) == 2 * len(ALL)
    assert [job.protocol for job in jobs[::2]] == ALL
    assert failed_row(jobs[0], "hung").protocol == str(ALL[0])


def test_a_variant_cannot_change_what_the_protocol_sets() -> None:
    pinch = Protocol("first", "pinch")
    config = method_config("habitat:baselines.boxes=true", 1.0, pinch)
    assert (config.baselines.boxes, config.baselines.first_pose) == (True, True)
    assert config.motion.grasps.families == ("pinch",)
    for setting in ("baselines.first_pose=false", "motion.grasps.families=hook"):
        with pytest.raises(InputError, match=r"can't set .*, which the protocol sets"):
            method_config(f"habitat:{setting}", 1.0, pinch)
    free = method_config("habitat:motion.grasps.families=hook", 1.0, Protocol("first", "all"))
    assert free.motion.grasps.families == ("hook",)


@pytest.mark.parametrize("name", SUITES)
@pytest.mark.parametrize(("commit", "grasps"), [(None, None), ("first", None), (None, "one")])
def test_a_suite_has_its_own_protocols_or_the_users(
    name: str, commit: Commit | None, grasps: GraspSet | None
) -> None:
    own = SUITES[name].protocols
    if own and (commit or grasps):
        with pytest.raises(InputError, match=f"{name} has its own protocols .*; use smoke, "):
            protocols_of(name, commit, grasps)
    else:
        expected = (Protocol(commit or "retry", grasps or "all"),)
        assert protocols_of(name, commit, grasps) == (own or expected)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["paper-table", "--commit", "first"], "paper-table has its own protocols (first, pinch;"),
        (["ablations", "--grasps", "pinch"], "ablations has its own protocols (retry, all); use"),
        (["smoke", "--commit", "second"], "second"),
        (["smoke", "--grasps", "two"], "two"),
        (["openings", "--commit", "first", "--scan", "60"], "in the true scene; leave out --scan"),
        (
            ["smoke", "--grasps", "pinch", "--methods", "m3:motion.grasps.turning=true"],
            "can't set motion.grasps.turning, which the protocol sets",
        ),
    ],
)
def test_a_protocol_that_cannot_be_honored_is_refused_in_one_line(
    words: list[str], message: str, tmp_path: Path
) -> None:
    assert message in error_of("bench", "run", *words, "--out", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_paper_table_runs_the_tasks_of_paper_real_under_the_papers_protocol_and_ours() -> None:
    table, real = SUITES["paper-table"], SUITES["paper-real"]
    assert (table.build, table.robots) == (real.build, real.robots)
    assert set(table.methods) >= set(real.methods)
    assert table.protocols == (Protocol("first", "pinch"), Protocol("retry", "all"))


@pytest.mark.timeout(300)
def test_the_table_of_a_run_with_two_protocols_has_both_and_the_printed_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cup = replace(CUP, name="cup", group="grasp cup")
    made = replace(SUITES["paper-table"], build=lambda *_: [cup], robots=("segway_ur5e",))
    monkeypatch.setitem(SUITES, "paper-table", made)
    out = str(tmp_path / "out")
    run = ["bench", "run", "paper-table", "--methods", "habitat", "--workers", "1", "--out", out]
    for new in (2, 0):
        facts = json_of(*run, "--disturbances", "0", "--json")
        assert (facts["jobs"], facts["new"]) == (2, new)
    assert set(facts["outcomes"]) == {"habitat (first, pinch)", "habitat (retry, all)"}
    text = output_of("bench", "report", out, "--compare", out)
    for protocol in ("first, pinch", "retry, all"):
        assert f"The published table and ours ({protocol})" in text
        assert f"Orders of the methods that differ from the published table ({protocol})" in text
    lines = [line for line in text.splitlines() if line.startswith("| grasp cup | habitat (Habi")]
    assert len(lines) == 2
    assert all("100 % of 1 | 100 % |" in line and "3.2 +- 0.0 m" in line for line in lines)
    compared = text[text.index("## Comparison with the other results") :]
    for protocol in ("first, pinch", "retry, all"):
        assert f"| habitat ({protocol}) | 1 | 1 of 1 | 1 of 1 |" in compared
