"""Laws of the tables that stand next to the figures of the paper."""

from __future__ import annotations

from dataclasses import replace

from tests.apps.bench.fakes import row, suite

from momapos.apps.bench.bench_records import Row
from momapos.apps.bench.metrics import LABORATORY, Table, labeled
from momapos.apps.bench.report_tables import all_tables


def by_title(tables: list[Table]) -> dict[str, Table]:
    return {table.title: table for table in tables}


def test_printed_figures_stand_beside_ours_in_every_line_of_a_printed_method() -> None:
    made = replace(suite(), name="paper-real")
    rows = [
        row("a", method="m3", group="open fridge", seconds=1.0),
        row("b", method="m3", group="open fridge", seconds=3.0),
        row("c", method="m3", group="open fridge", outcome="gave up"),
        row("d", group="open fridge"),
    ]  # fmt: skip
    table = by_title(all_tables(made, rows))["The published table and ours (retry, all)"]
    lines = {line[0] + line[1]: list(line[2:]) for line in table.lines}
    assert lines["open fridgem3 (M3*)"] == [
        "67 % of 3", "26 %", "2.00 +- 0.00 m", "2.2 +- 0.1 m", "2.00 +- 1.00 s", "18.2 +- 8.4 s"
    ]  # fmt: skip
    assert lines["open fridgeours"][1::2] == ["-", "-", "-"]
    assert lines["grasp cuphabitat (Habitat)"][::2] == ["-", "-", "-"]
    assert len(table.lines) == 1 + len(LABORATORY.lines)


def test_each_protocol_of_a_run_has_its_own_figures() -> None:
    made = replace(suite(), name="paper-table")
    rows = [
        row("a", group="open fridge", protocol="first, pinch", outcome="gave up", driving=None),
        row("b", group="open fridge", protocol="retry, all"),
    ]
    tables = by_title(all_tables(made, rows))
    for protocol, solved in (("first, pinch", "0 % of 1"), ("retry, all", "100 % of 1")):
        lines = tables[f"The published table and ours ({protocol})"].lines
        (line,) = (line for line in lines if line[1] == "ours")
        assert line[2] == solved
    methods = [line[0] for line in tables["Methods"].lines]
    assert methods == ["ours (first, pinch)", "ours (retry, all)"]
    assert [one.method for one in labeled(rows[:1])] == ["ours"]


def fridge_rows(**solved: range) -> list[Row]:
    """Return rows of methods that open some of 40 fridges; all drive as far and take as long."""
    return [
        row(f"{method} {k}", task=f"task {k}", group="open fridge", method=method,
            outcome="solved" if k in those else "gave up", driving=1.0 if k in those else None)
        for method, those in solved.items()
        for k in range(40)
    ]  # fmt: skip


def sentences(rows: list[Row], figure: str) -> list[str]:
    made = replace(suite(), name="paper-real")
    table = by_title(all_tables(made, rows))[
        "Orders of the methods that differ from the published table (retry, all)"
    ]
    return [line[0] for line in table.lines if f", {figure} [" in line[0]]


def test_an_order_as_in_print_has_no_sentence_and_a_reversed_one_has_one() -> None:
    as_printed = fridge_rows(
        paper=range(40), reuleaux=range(28), m3=range(16), habitat=range(4)
    )  # fmt: skip
    assert sentences(as_printed, "success") == []
    swapped = fridge_rows(paper=range(40), habitat=range(28), m3=range(16), reuleaux=range(4))
    assert sentences(swapped, "success") == [
        "Open fridge, success [%]: in print MoMa-Pos 100 > Reuleaux 70 > M3* 26 > Habitat 18; here "
        "MoMa-Pos 100 > Habitat 70 > M3* 40 > Reuleaux 10."
    ]


def test_a_difference_by_chance_is_no_order() -> None:
    (said,) = sentences(fridge_rows(paper=range(40), reuleaux=range(38)), "success")
    assert said.endswith("in print MoMa-Pos 100 > Reuleaux 70; here MoMa-Pos 100 = Reuleaux 95.")
    assert sentences(fridge_rows(paper=range(40)), "success") == []


def test_driving_is_compared_over_the_tasks_that_both_solve() -> None:
    rows = fridge_rows(paper=range(40), habitat=range(20))
    far = [replace(r, driving=2.0) if r.method == "habitat" and r.driving else r for r in rows]
    near = [
        replace(r, driving=9.0) if r.method == "paper" and int(r.task.split()[1]) >= 20 else r
        for r in rows
    ]
    assert sentences(far, "driving") == [
        "Open fridge, driving [m]: in print Habitat 2.2 < MoMa-Pos 2.3; here MoMa-Pos 1.00 < "
        "Habitat 2.00."
    ]
    assert sentences(near, "driving")[0].endswith("here Habitat 1.00 = MoMa-Pos 5.00.")


def test_the_simulation_counts_each_robot_and_what_the_grid_can_do() -> None:
    made = replace(suite(), name="paper-sim")
    rows = [
        row(f"{robot} {method} {k}", task=f"{robot} {k}", robot=robot, method=method,
            outcome="solved" if k < count else "infeasible")
        for robot, method, count in (
            ("fetch", "exhaustive", 3), ("fetch", "paper", 2), ("husky_ur5e", "paper", 4)
        )
        for k in range(4)
    ]  # fmt: skip
    table = by_title(all_tables(made, rows))["The paper's simulation and ours"]
    assert list(map(list, table.lines)) == [
        ["fetch", "exhaustive", "75 % of 4", "100 % of 3", "-"],
        ["fetch", "paper (MoMa-Pos)", "50 % of 4", "67 % of 3", "100 %"],
        ["husky_ur5e", "paper (MoMa-Pos)", "100 % of 4", "-", "100 %"],
    ]


def test_with_a_scan_the_report_has_the_shares_of_the_papers_stages() -> None:
    stages = {"survey": 10.0, "modeling": 6.0, "importance": 1.0, "search": 2.0, "way": 1.0}
    rows = [row("a", stages=stages), row("b", stages={"modeling": 9.0}, outcome="infeasible")]
    table = by_title(all_tables(suite(), rows))["From scan to motion"]
    lines = list(map(list, table.lines))
    assert lines[0] == ["ours", "50.0 %", "30.0 %", "15.0 %", "0.0 %", "5.0 %"]
    assert lines[1] == ["ours, without survey", "-", "60.0 %", "30.0 %", "0.0 %", "10.0 %"]
    assert lines[2] == ["MoMa-Pos, as printed", "-", "58.0 %", "40.0 %", "0.9 %", "0.8 %"]
    known = by_title(all_tables(suite(), [row("a")]))
    assert not {"From scan to motion", "Modeling time by class"} & set(known)


def test_the_modeling_time_of_each_class_is_a_mean_over_the_solved_tasks() -> None:
    rows = [
        row(f"{method} {k}", method=method, group=group,
            stages={"survey": 9.0, "modeling": factor * seconds})
        for method, factor in (("paper", 1.0), ("paper:importance.alpha=0", 4.0))
        for k, (group, seconds) in enumerate((("cup", 1.0), ("cup", 2.0), ("fridge", 0.0)))
    ]  # fmt: skip
    rows.append(
        row("no", method="paper", group="cup", outcome="gave up", stages={"modeling": 99.0})
    )
    table = by_title(all_tables(suite(), rows))["Modeling time by class"]
    assert list(map(list, table.lines)) == [
        ["paper", "1.50 s", "0.00 s"], ["paper:importance.alpha=0", "6.00 s", "0.00 s"]
    ]  # fmt: skip
