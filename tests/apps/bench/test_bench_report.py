"""Laws of reports: correct numbers, in tables."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from tests.apps.bench.fakes import row, suite, task

from momapos.apps.bench.bench_records import Container, Row
from momapos.apps.bench.metrics import Table, in_order, markdown, paired_p_value, share
from momapos.apps.bench.report_tables import all_tables, compared_tables

HOSTILE = "</td><script>alert(\"1\")</script> | & 'quoted'"


def results() -> list[Row]:
    """Return rows of two methods on four tasks: `ours` solves three of them, `m3` two."""
    found = []
    for k, (ours, other) in enumerate([(True, True), (True, False), (True, False), (False, True)]):
        group = "door" if k < 2 else "drawer"
        for method, solved, seconds, driving in (("ours", ours, 0.1, 1.0), ("m3", other, 0.2, 1.5)):
            found.append(
                row(
                    f"{method} {k}", task=f"task {k}", group=group, method=method,
                    seconds=seconds * (k + 1),
                    outcome="solved" if solved else "infeasible" if method == "ours" else "gave up",
                    reason="" if solved else HOSTILE if k == 1 else "out of reach",
                    driving=driving + k if solved else None,
                )
            )  # fmt: skip
    return found


def cells(table: Table, line: int = 0) -> dict[str, str]:
    return dict(zip(table.columns, table.lines[line], strict=True))


def by_title(tables: list[Table]) -> dict[str, Table]:
    return {table.title: table for table in tables}


@pytest.mark.parametrize(("count", "of"), [(0, 7), (7, 7), (3, 10), (49, 50)])
def test_the_interval_is_wilsons(count: int, of: int) -> None:
    z, p = 1.959963984540054, count / of
    middle = (p + z * z / (2 * of)) / (1 + z * z / of)
    half = z / (1 + z * z / of) * np.sqrt(p * (1 - p) / of + z * z / (4 * of * of))
    found = share(count, of)
    assert (found.low, found.high) == pytest.approx((middle - half, middle + half), abs=1e-9)


def test_the_interval_of_no_rows_is_zero_to_one() -> None:
    assert (share(0, 0).low, share(0, 0).high) == (0.0, 1.0)


def test_the_line_of_a_method_summarizes_its_rows() -> None:
    table = by_title(all_tables(suite(), results()))["Methods"]
    ours, other = cells(table, 0), cells(table, 1)
    assert (ours["solved"], other["solved"]) == ("3 of 4", "2 of 4")
    assert ours["time, median"] == "0.25 s"
    assert ours["driving, median"] == "2.00 m"
    assert (ours["above shortest known"], other["above shortest known"]) == (
        "+0.00 m, +0 %",
        "+0.25 m, +9 %",
    )
    assert (ours["false infeasible"], other["false infeasible"]) == ("1", "0")


def test_the_time_per_solved_task_includes_failures() -> None:
    doors = [task("task 0"), task("task 1")]
    inside = replace(task("task 2"), verb="pick", inside=Container("fridge", "door_hinge"))
    loose = replace(task("task 3"), verb="pick")
    grid = [replace(one, key=f"grid {one.key}", method="exhaustive") for one in results()[:1]]
    rows = [*results(), *grid]
    table = by_title(all_tables(suite(*doors, inside, loose), rows))["Time per solved task"]
    ours, other, whole = map(list, table.lines)
    assert ours == ["ours", "3 of 4", "0.10 s", "0.33 s", "3 of 3", "0.10 s", "0.20 s"]
    assert other == ["m3", "2 of 4", "0.20 s", "1.00 s", "1 of 3", "0.20 s", "1.20 s"]
    assert whole == ["exhaustive", "1 of 1", "0.10 s", "0.10 s", "1 of 1", "0.10 s", "0.10 s"]
    none = by_title(all_tables(suite(loose), results()))["Time per solved task"]
    assert list(none.lines[0][4:]) == ["0 of 0", "-", "-"]


def test_the_time_of_a_class_counts_its_solved_tasks() -> None:
    table = by_title(all_tables(suite(), results()))["Time by class, solved tasks"]
    assert cells(table, 0) == {"method": "ours", "door": "150 ms", "drawer": "300 ms"}
    assert cells(table, 1) == {"method": "m3", "door": "200 ms", "drawer": "800 ms"}
    none = by_title(all_tables(suite(), [row("a", outcome="gave up")]))
    assert cells(none["Time by class, solved tasks"])["door"] == "-"


def test_a_failure_in_physics_is_no_success() -> None:
    rows = [row("a", done=True), row("b", done=False, reason="slipped"), row("c", done=None)]
    tables = by_title(all_tables(suite(), rows))
    assert cells(tables["Methods"])["success in physics"] == "1 of 3"
    assert cells(tables["Success by class"])["door"].startswith("2 of 3")
    assert cells(tables["Failures by reason"])["outcome"] == "failed in physics"


def test_success_under_base_errors_counts_a_task_by_the_share_of_poses_that_work() -> None:
    rows = [
        row("a", at_2cm=1.0, at_5cm=0.5),
        row("b", at_2cm=0.5, at_5cm=0.0),
        row("c", outcome="infeasible"),
        row("d", outcome="gave up"),
    ]
    table = by_title(all_tables(suite(), rows))["Methods"]
    found = cells(table)
    assert (found["base off by 2 cm, 2 deg"], found["by 5 cm, 5 deg"]) == ("38 %", "12 %")
    plain = by_title(all_tables(suite(), [row("a")]))["Methods"]
    assert "by 5 cm, 5 deg" not in plain.columns


def test_methods_are_compared_on_the_grid_solvable_tasks() -> None:
    rows = [
        row(f"{method} {k}", task=f"task {k}", method=method, done=done,
            outcome="solved" if solved else "gave up")
        for method, answers in (
            ("exhaustive", ((True, None), (True, None), (True, None), (False, None))),
            ("ours", ((True, True), (True, False), (False, None), (True, True))),
        )
        for k, (solved, done) in enumerate(answers)
    ]  # fmt: skip
    table = by_title(all_tables(suite(), rows))["Methods"]
    assert cells(table, 1)["of grid-solvable"] == "1 of 3, 33.3 %"
    assert cells(table, 0)["of grid-solvable"] == "3 of 3, 100.0 %"


def test_a_stage_has_its_share_its_median_and_its_95th_percentile() -> None:
    rows = [row(str(k), stages={"search": 0.001 * k, "model": 0.05}) for k in range(101)]
    found = cells(by_title(all_tables(suite(), rows))["Time by stage"])
    assert found["search"] == "50.0 %; 50, 95 ms"
    assert found["model"] == "50.0 %; 50, 50 ms"


def test_rows_have_the_order_of_the_suite() -> None:
    made = suite(*(task(f"task {k}") for k in range(4)))
    rows = in_order(made, reversed(results()))
    assert [one.task for one in rows] == sorted(one.task for one in rows)
    assert [one.method for one in rows[:2]] == ["ours", "m3"]


def test_markdown_tables_are_rectangles() -> None:
    rows = results()
    for block in markdown(["title"], all_tables(suite(), rows)).split("\n\n"):
        if block.startswith("|"):
            columns = {len(re.split(r"(?<!\\)\|", line)) for line in block.split("\n")}
            assert len(columns) == 1


def test_two_results_are_compared_by_task() -> None:
    first = results()
    second = [row(r.key, task=r.task, method=r.method, outcome="gave up", seconds=1.0,
                  driving=None) for r in first[:4]]  # fmt: skip
    summary, changed = compared_tables(first, second)
    line = cells(summary)
    assert (line["method"], line["common tasks"]) == ("ours", "2")
    assert (line["gained"], line["lost"]) == ("+2", "-0")
    assert line["time, median ratio"] == "0.15 times"
    assert {one[0] for one in changed.lines} == {"task 0", "task 1"}
    assert not compared_tables(first, [row("x", task="of another suite")])[0].lines


def test_the_p_value_is_one_for_one_change_and_small_for_ten_equal_changes() -> None:
    assert paired_p_value(0, 0) == paired_p_value(1, 0) == paired_p_value(5, 5) == 1.0
    assert paired_p_value(10, 0) == pytest.approx(2 / 2**10)
