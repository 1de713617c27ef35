"""Reports: numbers that are right, and pages that stand alone."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from tests.bench.fakes import row, suite, task

from momapos.bench.figures import scatter_figure, success_figure
from momapos.bench.html import page
from momapos.bench.markdown import markdown
from momapos.bench.metrics import in_order, paired_p_value, share
from momapos.bench.records import Row
from momapos.bench.tables import Table, all_tables, compared_tables

SVG = "{http://www.w3.org/2000/svg}"
HOSTILE = "</td><script>alert(\"1\")</script> | & 'quoted'"


def results() -> list[Row]:
    """Two methods on four tasks: ours solves three, the other one two, one of them alone."""
    found = []
    for k, (ours, other) in enumerate([(True, True), (True, False), (True, False), (False, True)]):
        group = "door" if k < 2 else "drawer"
        for method, solved, seconds, way in (("ours", ours, 0.1, 1.0), ("m3", other, 0.2, 1.5)):
            found.append(
                row(
                    f"{method} {k}", task=f"task {k}", group=group, method=method,
                    seconds=seconds * (k + 1),
                    outcome="solved" if solved else "infeasible" if method == "ours" else "gave up",
                    reason="" if solved else HOSTILE if k == 1 else "out of reach",
                    driving=way + k if solved else None,
                )
            )  # fmt: skip
    return found


def cells(table: Table, line: int = 0) -> dict[str, str]:
    return {name: cell.text for name, cell in zip(table.columns, table.lines[line], strict=True)}


def by_title(tables: list[Table]) -> dict[str, Table]:
    return {table.title: table for table in tables}


@pytest.mark.parametrize(("count", "of"), [(0, 7), (7, 7), (3, 10), (49, 50)])
def test_the_interval_is_wilsons(count: int, of: int) -> None:
    z, p = 1.959963984540054, count / of
    middle = (p + z * z / (2 * of)) / (1 + z * z / of)
    half = z / (1 + z * z / of) * np.sqrt(p * (1 - p) / of + z * z / (4 * of * of))
    found = share(count, of)
    assert (found.low, found.high) == pytest.approx((middle - half, middle + half), abs=1e-9)


def test_a_share_of_nothing_says_nothing() -> None:
    assert (share(0, 0).low, share(0, 0).high) == (0.0, 1.0)


def test_one_line_a_method_sums_up_its_rows() -> None:
    table = by_title(all_tables(suite(), results()))["Methods"]
    ours, other = cells(table, 0), cells(table, 1)
    assert (ours["solved"], other["solved"]) == ("3 of 4", "2 of 4")
    assert ours["time, median"] == "0.25 s"
    assert ours["driving, median"] == "2.00 m"
    assert (ours["over the least known"], other["over the least known"]) == ("+0.00 m", "+0.25 m")
    assert (ours["wrong no"], other["wrong no"]) == ("1", "0")


def test_numbers_know_the_rows_that_they_count() -> None:
    tables = by_title(all_tables(suite(), results()))
    solved = tables["Methods"].lines[0][2]
    assert solved.keys == ("ours 0", "ours 1", "ours 2")
    assert tables["Success by class"].lines[0][2].keys == ("ours 2",)
    reasons = tables["Failures by reason"]
    assert sum(int(cell.text or 0) for line in reasons.lines for cell in line[2:]) == 3


def test_what_physics_did_not_do_is_no_success() -> None:
    rows = [row("a", done=True), row("b", done=False, reason="slipped"), row("c", done=None)]
    tables = by_title(all_tables(suite(), rows))
    assert cells(tables["Methods"])["done in physics"] == "1 of 3"
    assert cells(tables["Success by class"])["door"].startswith("2 of 3")
    assert cells(tables["Failures by reason"])["outcome"] == "not done in physics"


def test_rows_stand_in_the_order_of_the_suite() -> None:
    made = suite(*(task(f"task {k}") for k in range(4)))
    rows = in_order(made, reversed(results()))
    assert [one.task for one in rows] == sorted(one.task for one in rows)
    assert [one.method for one in rows[:2]] == ["ours", "m3"]


class _Page(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: set[str] = set()
        self.tags: set[str] = set()
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(str(value))
            if name == "href":
                self.links.add(str(value))
            if name in ("src", "srcset", "data"):
                self.loaded.append(str(value))


def test_every_link_of_the_page_leads_to_a_place_in_it() -> None:
    rows = results()
    made = _Page(page(["title"], all_tables(suite(), rows), rows))
    assert len(set(made.ids)) == len(made.ids)
    assert {link[0] for link in made.links} == {"#"}
    assert {link[1:] for link in made.links} <= set(made.ids)
    assert {f"r{k}" for k in range(len(rows))} <= set(made.ids)


def test_the_page_loads_nothing_and_runs_nothing_that_a_row_says() -> None:
    rows = results()
    text = page([HOSTILE], all_tables(suite(), rows), rows)
    made = _Page(text)
    assert "script" not in made.tags
    assert not made.loaded
    assert not re.search(r"@import|url\(", text)
    assert text.count(HOSTILE[:12]) == 0


def test_figures_show_every_method_and_every_solved_task() -> None:
    rows = results()
    anchors = {one.key: f"r{k}" for k, one in enumerate(rows)}
    bars = ElementTree.fromstring(success_figure(rows))
    assert len(bars.findall(f"{SVG}rect")) == 2
    points = ElementTree.fromstring(scatter_figure(rows, anchors)).findall(f"{SVG}a")
    assert {point.get("href") for point in points} == {
        f"#{anchors[one.key]}" for one in rows if one.outcome == "solved"
    }
    assert scatter_figure([row("x", outcome="gave up", driving=None)], {"x": "r0"}) == ""


def test_markdown_tables_are_rectangles() -> None:
    rows = results()
    for block in markdown(["title"], all_tables(suite(), rows)).split("\n\n"):
        if block.startswith("|"):
            columns = {len(re.split(r"(?<!\\)\|", line)) for line in block.split("\n")}
            assert len(columns) == 1


def test_two_results_are_compared_task_by_task() -> None:
    first = results()
    second = [row(r.key, task=r.task, method=r.method, outcome="gave up", seconds=1.0,
                  driving=None) for r in first[:4]]  # fmt: skip
    summary, changed = compared_tables(first, second)
    line = cells(summary)
    assert (line["method"], line["tasks of both"]) == ("ours", "2")
    assert (line["gained"], line["lost"]) == ("+2", "-0")
    assert line["time, median ratio"] == "0.15 times"
    assert {one[0].text for one in changed.lines} == {"task 0", "task 1"}
    assert not compared_tables(first, [row("x", task="of another suite")])[0].lines


def test_one_task_that_changed_proves_nothing_and_ten_that_did_alike_do() -> None:
    assert paired_p_value(0, 0) == paired_p_value(1, 0) == paired_p_value(5, 5) == 1.0
    assert paired_p_value(10, 0) == pytest.approx(2 / 2**10)
