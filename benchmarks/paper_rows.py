"""Keep the rows of a run of the paper's suites, and print its tables for docs/results/paper.md.

    python benchmarks/paper_rows.py DIR [--out docs/results/rows] [--name NAME]

DIR is a folder of `momapos bench run paper-table`, `authors-sim`, or `paper-real --scan 60`. The
rows go into a compressed CSV file, from which a test computes every line of the tables again.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from momapos.apps.bench import all_rows, read_folder
from momapos.apps.bench.bench_records import Row
from momapos.apps.bench.metrics import succeeded
from momapos.apps.bench.report_tables import (
    MODELING,
    PUBLISHED,
    STAGES,
    SURVEY,
    modeling_times,
    scan_shares,
)

MODEL_ALL, ALL_CHECKS = "paper:importance.alpha=0", "paper:planner.optimize=true"
SIMULATED = ("fetch", "segway_ur5e", "husky_ur5e")
"""Robots of the paper's simulation."""


class Answer(NamedTuple):
    """What the table needs of an answer."""

    task: str
    group: str
    method: str
    protocol: str
    success: bool
    seconds: float
    """Processor time of the answer [s]."""
    driving: float
    """Driving length [m]; NaN without a plan."""
    stages: Mapping[str, float]
    """Processor time by stage in an answer from a scan [s]; empty in a known scene."""


def answers_of(folder: Path) -> tuple[str, list[Answer]]:
    """Return the suite of a results folder, and its answers."""
    suite = read_folder(folder).suite
    found = [
        Answer(
            row.task, row.group, row.method, row.protocol, succeeded(row),
            round(row.seconds or 0.0, 4), np.nan if row.driving is None else round(row.driving, 4),
            {name: round(t, 5) for name, t in row.stages.items()} if MODELING in row.stages else {},
        )
        for row in all_rows(folder)
    ]  # fmt: skip
    return suite.name, sorted(found)


def write(answers: Sequence[Answer], file: Path) -> None:
    """Write answers as CSV, compressed without a date so that equal answers give equal files."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(Answer._fields)
    for one in answers:
        driving = "" if np.isnan(one.driving) else one.driving
        stages = json.dumps(one.stages) if one.stages else ""
        lines.writerow([*one[:4], int(one.success), one.seconds, driving, stages])
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(gzip.compress(text.getvalue().encode(), mtime=0))


def read(file: Path) -> list[Answer]:
    """Read what `write` wrote."""
    text = gzip.decompress(file.read_bytes()).decode()
    return [
        Answer(
            row["task"], row["group"], row["method"], row["protocol"], row["success"] == "1",
            float(row["seconds"]), float(row["driving"] or "nan"),
            json.loads(row["stages"] or "{}"),
        )
        for row in csv.DictReader(io.StringIO(text))
    ]  # fmt: skip


def table(suite: str, answers: Sequence[Answer]) -> list[str]:
    """Return the lines of a suite's table as Markdown: time [s], driving [m], success [%]."""
    published = PUBLISHED[suite]
    counts = [len({a.task for a in answers if a.group == task}) for task in published.tasks]
    heads = [f"{task} ({count})" for task, count in zip(published.tasks, counts, strict=True)]
    lines = [f"| method | condition | {' | '.join(heads)} |", "|---" * (len(heads) + 2) + "|"]
    names = {ours: name for name, ours in published.methods.items()}
    for method in dict.fromkeys(a.method for a in sorted(answers, key=lambda a: _order(a.method))):
        if method in names:
            printed = [one for one in published.lines if one.name == names[method]]
            cells = [f"{one.time:.1f}, {one.driving:.1f}, {one.success:.0f}" for one in printed]
            lines.append(f"| {names[method]} | as published | {' | '.join(cells)} |")
        for protocol in sorted({a.protocol for a in answers}):
            mine = [a for a in answers if (a.method, a.protocol) == (method, protocol)]
            cells = [_cell([a for a in mine if a.group == task]) for task in published.tasks]
            lines.append(f"| `{method}` | {protocol} | {' | '.join(cells)} |")
    return lines


def medians(suite: str, answers: Sequence[Answer]) -> list[str]:
    """Return the lines of a table of median times under the first protocol [ms], as Markdown."""
    tasks, first = PUBLISHED[suite].tasks, min(a.protocol for a in answers)
    head = f"| median time, {first} [ms] | {' | '.join(tasks)} |"
    lines = [head, "|---" * (len(tasks) + 1) + "|"]
    for method in sorted({a.method for a in answers}, key=_order):
        mine = [a for a in answers if (a.method, a.protocol) == (method, first) and a.success]
        times = [[1000 * a.seconds for a in mine if a.group == task] for task in tasks]
        cells = [f"{np.median(some):.0f}" if some else "-" for some in times]
        lines.append(f"| `{method}` | {' | '.join(cells)} |")
    return lines


def phrases(answers: Sequence[Answer]) -> list[str]:
    """Return what docs/paper.md and docs/results/paper.md say of the paper's table in words."""
    first = min(a.protocol for a in answers)

    def some(method: str, *groups: str) -> list[Answer]:
        return [
            a for a in answers if (a.method, a.protocol) == (method, first) and a.group in groups
        ]

    def rate(method: str, *groups: str) -> str:
        return f"{100 * np.mean([a.success for a in some(method, *groups)]):.0f}"

    def times(method: str, group: str = "grasp apple") -> list[float]:
        return [a.seconds for a in some(method, group) if a.success]

    fridge, oven = "open fridge", "open microwave"
    unchecked = rate("paper:paper.check_stops=false", oven)
    named = {"Habitat": "habitat", "M3*": "m3", "Reuleaux": "reuleaux"}
    median = {name: f"{1000 * np.median(times(method)):.0f}" for name, method in named.items()}
    lost = {n: f"{100 - float(rate(m, fridge, oven)):.0f} % ({n})" for n, m in named.items()}
    means = [f"{np.mean(times(method)):.2f}" for method in ("paper", ALL_CHECKS)]
    medians_ = [f"{np.median(times(method)):.2f}" for method in ("paper", ALL_CHECKS)]
    door = {name: (rate(m, fridge), rate(m, oven)) for name, m in named.items()}
    at_fridge = [
        1000 * float(np.median(times(method, fridge))) for method in ("habitat", "paper", "m3")
    ]
    spread = [float(np.std(times(method))) for method in ("paper", "m3", "reuleaux")]

    def drive(method: str, group: str) -> float:
        return float(np.mean([a.driving for a in some(method, group) if a.success]))

    saved = sorted(
        drive(method, group) - drive("paper", group)
        for group in ("grasp apple", "grasp cup")
        for method in named.values()
    )
    retried = [a for a in answers if a.protocol != first]
    failing = sorted({f"`{a.method}`" for a in retried if not a.success})
    return [
        f"The {len(answers):,} answers take",
        f"here MoMa-Pos is, by {saved[0]:.1f} to {saved[-1]:.1f} m",
        f"every method but {' and '.join(failing)} solves all tasks",
        f"{1000 * np.median(times('paper')):.0f} ms against {median['Habitat']} (Habitat), "
        f"{median['M3*']} (M3*) and {median['Reuleaux']} (Reuleaux) for the apple",
        f"the unchecked first stop opens {unchecked} % of the microwaves",
        f"its first stop opens {unchecked} % of the microwaves",
        *(
            f"{one} and {other} % with first poses, 100 % with retries"
            for one, other in door.values()
        ),
        "at the fridge {:.0f} ms against {:.0f} (MoMa-Pos), but {:.0f} (M3*)".format(*at_fridge),
        "{:.2f} s (MoMa-Pos), {:.2f} s (M3*), {:.2f} s (Reuleaux)".format(*spread),
        f"`authors` {rate('authors', fridge)} % of the fridges, {rate('authors', oven)} % of the "
        "microwaves",
        f"takes {means[0]} s instead of {means[1]} s for the apple on average, and {medians_[0]} "
        f"instead of {medians_[1]} s in the median",
        f"opens {rate('authors', fridge)} % of the fridges and {rate('authors', oven)} % of the "
        "microwaves at its first stop",
        f"fail at {lost['Habitat']}, {lost['M3*']} and {lost['Reuleaux']} of the openings",
        f"here MoMa-Pos {rate('paper', fridge)} = Habitat {door['Habitat'][0]} > M3* "
        f"{door['M3*'][0]} > Reuleaux {door['Reuleaux'][0]}",
        f"here MoMa-Pos {rate('paper', oven)} > M3* {door['M3*'][1]} > Reuleaux "
        f"{door['Reuleaux'][1]} = Habitat {door['Habitat'][1]}",
    ]


def kitchen_phrases(answers: Sequence[Answer]) -> list[str]:
    """Return what docs/results/paper.md says of the authors' simulation in words."""
    numbers = ("no", "one", "two", "three", "four", "five")
    first = min(a.protocol for a in answers)

    def missed(method: str) -> list[str]:
        mine = [a for a in answers if (a.method, a.protocol) == (method, first)]
        return [a.group.removeprefix("in ") for a in mine if not a.success]

    (place,), lost = set(missed("paper")), sorted(set(missed("authors")), reverse=True)
    return [
        f"{len(answers)} answers",
        f"`paper` misses {numbers[len(missed('paper'))]} of five in the {place}",
        f"`authors` fails in {' and '.join(lost)}",
    ]


def simulation_tables(answers: Sequence[Answer]) -> list[str]:
    """Return the lines of the table of the paper's simulation, as Markdown: time, solved tasks."""
    robots = [*SIMULATED, "all"]

    def of(method: str | None, robot: str) -> list[Answer]:
        return [
            a for a in answers if method in (None, a.method) and robot in ("all", a.task.split()[0])
        ]

    tasks = {robot: len({a.task for a in of(None, robot)}) for robot in robots}
    heads = [f"{robot} ({count:,})" for robot, count in tasks.items()]
    lines = [f"| | time | {' | '.join(heads)} |"]
    for method in sorted({a.method for a in answers}, key=_order):
        times = np.percentile([a.seconds for a in of(method, "all")], [50, 95])
        counts = {robot: sum(a.success for a in of(method, robot)) for robot in robots}
        cells = [f"{n}, {100 * n / tasks[robot]:.0f} %" for robot, n in counts.items()]
        lines.append(f"| `{method}` | {times[0]:.2f} s, {times[1]:.1f} s | {' | '.join(cells)} |")
    return lines


def simulation_phrases(answers: Sequence[Answer]) -> list[str]:
    """Return what the pages say of the methods in the paper's simulation in words."""
    methods = {a.method for a in answers}
    solved = {m: {a.task for a in answers if a.success and a.method == m} for m in methods}
    tasks = {a.task: a.group for a in answers}
    first, second = solved["paper"], solved["ours"]
    by_none = Counter(tasks[task] for task in tasks.keys() - set().union(*solved.values()))
    more = {m: len(solved[m] - second) for m in ("habitat", "m3", "reuleaux")}
    lost = Counter(tasks[task] for task in second - first)
    neither = Counter(group for task, group in tasks.items() if task not in first | second)
    drives = {m: {a.task: a.driving for a in answers if a.method == m} for m in solved}
    far, short = (sum(drives[m][task] for task in first & second) for m in ("paper", "ours"))
    shares = [
        100
        * sum(task.split()[0] == robot for task in first)
        / sum(task.split()[0] == robot for task in tasks)
        for robot in SIMULATED
    ]
    return [
        f"{len(first & second)} tasks are solved by both, {len(first - second)} only by `paper` "
        f"and {len(second - first)} only by `ours`",
        f"{lost['in fridge']} objects in fridges and {lost['in drawer']} in drawers",
        f"Neither solves {neither.total()}, of which {neither['in dishwasher']} are objects in "
        f"dishwashers and {neither['in fridge']} in fridges",
        f"drives {100 * (far / short - 1):.0f} % farther",
        f"Of the tasks that `ours` does not solve, `habitat` solves {more['habitat']}, `m3` "
        f"{more['m3']} and `reuleaux` {more['reuleaux']}",
        f"None solves {by_none.total()}, of which {by_none['in dishwasher']} are objects in "
        f"dishwashers and {by_none['in fridge']} in fridges",
        f"{shares[0]:.0f}, {shares[1]:.0f} and {shares[2]:.0f} % of 500 tasks each, "
        f"{100 * len(first) / len(first | second):.0f} % of those that `paper` or `ours` solves",
    ]


def check_phrases(answers: Sequence[Answer]) -> list[str]:
    """Return what the pages say in words of an RRT* that spends all its checks."""
    solved = {
        method: {a.task for a in answers if a.success and a.method == method}
        for method in ("paper", ALL_CHECKS)
    }
    first, every = solved["paper"], solved[ALL_CHECKS]
    total = {m: sum(a.seconds for a in answers if a.method == m) for m in ("paper", ALL_CHECKS)}
    return [
        f"{len(first & every)} tasks are solved with both, {len(first - every)} only with the "
        f"first and {len(every - first)} only with the second",
        f"{100 * (1 - total['paper'] / total[ALL_CHECKS]):.0f} % less time",
    ]


def scan_tables(answers: Sequence[Answer]) -> list[str]:
    """Return the lines of the tables of a run from scans as Markdown: shares, modeling times."""
    rows = [_row(a) for a in answers if a.success]
    lines = []
    methods = sorted({row.method for row in rows}, key=_order)
    for method in methods:
        mine = [row for row in rows if row.method == method]
        for words, without in (("", ()), (f", without the {SURVEY}", (SURVEY,))):
            shares = scan_shares(mine, without)
            cells = [f"{shares[s]:.1f} %" if s in shares else "-" for s in (SURVEY, *STAGES)]
            lines.append(f"| `{method}`{words} | {' | '.join(cells)} |")
    tasks = PUBLISHED["paper-real"].tasks
    counts = [len({row.task for row in rows if row.group == task}) for task in tasks]
    heads = [f"{task} ({count})" for task, count in zip(tasks, counts, strict=True)]
    lines.append(f"| | {' | '.join(heads)} | all |")
    times = modeling_times(rows)
    for method in methods:
        spent = [row.stages[MODELING] for row in rows if row.method == method]
        cells = [f"{times[method].get(task, np.nan):.2f} s" for task in tasks]
        lines.append(f"| `{method}` | {' | '.join([*cells, f'{np.mean(spent):.2f} s'])} |")
    return lines


def scan_phrases(
    answers: Sequence[Answer], others: Sequence[Answer], unseen: Sequence[Answer]
) -> list[str]:
    """Return what the pages say in words of the runs from scans.

    Args:
        answers, others: In the layouts that showed the faults.
        unseen: In layouts that did not.
    """
    (same,) = {
        frozenset(a.task for a in answers if a.success and a.method == method)
        for method in {a.method for a in answers}
    }
    tasks = {a.task for a in answers}
    layouts = {task.split()[1] for task in tasks}
    six, new = (
        {m: sum(a.success for a in some if a.method == m) for m in ("ours", "paper")}
        for some in (others, unseen)
    )
    many = len({a.task for a in unseen})
    good = [a for a in answers if a.success and a.method == "paper"]
    total = np.array([a.seconds for a in good])
    boxes = np.array([a.stages[SURVEY] for a in good])
    rows = [_row(a) for a in answers if a.success]
    whole, alone = (
        scan_shares([row for row in rows if row.method == "paper"], without)
        for without in ((), (SURVEY,))
    )
    models, images = {}, {}
    for method in ("paper", MODEL_ALL):
        mine = [row.stages for row in rows if row.method == method]
        models[method] = np.mean([stages[MODELING] for stages in mine])
        images[method] = np.mean([stages[MODELING] + stages[SURVEY] for stages in mine])
    saves, later = (100 * (1 - one["paper"] / one[MODEL_ALL]) for one in (models, images))
    checks = [sum(t for s, t in a.stages.items() if s not in (SURVEY, *STAGES)) for a in good]
    chosen = ("potential", "importance")
    return [
        f"[{len(same)} of {len(tasks)}](results/paper.md#from-a-scan), and {new['paper']} of "
        f"{many} in layouts that were not looked at",
        f"{len(tasks)} tasks in {len(layouts)} layouts, of which each method solves the same "
        f"{len(same)}",
        f"`ours` solves {six['ours']} and `paper` {six['paper']} of these {len(others) // 2}",
        f"`ours` solves {new['ours']} and `paper` {new['paper']} of {many}",
        f"takes {np.median(total):.1f} s of processor time (median; {total.max():.0f} s at most), "
        f"{np.median(boxes):.1f} s of it for the survey",
        f"{np.median(total):.1f} s with a scan (median, {total.max():.0f} s at most)",
        f"potential and importance {sum(whole[s] for s in chosen):.1f} %, without the boxes of the "
        f"objects {sum(alone[s] for s in chosen):.1f} %",
        f"{models['paper']:.2f} s instead of {models[MODEL_ALL]:.2f} s",
        f"with them importance saves {later:.0f} %",
        f"Importance saves {saves:.0f} % of the modeling time, and {later:.0f} % of the time",
        f"{alone[MODELING]:.0f}, {alone['checks']:.0f}, {alone['potential']:.1f}, "
        f"{alone['importance']:.1f} %. With them, boxes and models take "
        f"{whole[SURVEY] + whole[MODELING]:.0f} %",
        f"the checks of an answer take {np.mean(checks):.1f} s",
    ]


def _row(answer: Answer) -> Row:
    """Return a solved answer as a row of the benchmark."""
    return Row(
        "", answer.task, answer.group, "", answer.method, 0, "solved", stages=answer.stages
    )  # fmt: skip


def _order(method: str) -> tuple[int, str]:
    first = ("ours", "paper", "authors", "habitat", "m3", "reuleaux")
    return first.index(method.partition(":")[0]), method


def _cell(answers: Sequence[Answer]) -> str:
    good = [a for a in answers if a.success]
    if not good:
        return "-, -, 0"
    seconds, driving = (
        float(np.mean([getattr(a, f) for a in good])) for f in ("seconds", "driving")
    )
    return f"{seconds:.2f}, {driving:.2f}, {100 * len(good) / len(answers):.0f}"


def main() -> None:
    """Keep the rows and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/results/rows"))
    parser.add_argument("--name", help="name of the file; that of the suite by default")
    args = parser.parse_args()
    suite, answers = answers_of(args.folder)
    write(answers, args.out / f"{args.name or suite}.csv.gz")
    if suite == "paper-sim":
        said = check_phrases if any(a.method == ALL_CHECKS for a in answers) else simulation_phrases
        print("\n".join([*simulation_tables(answers), *said(answers)]))
    elif any(a.stages for a in answers):
        print("\n".join(scan_tables(answers)))
    else:
        print("\n".join([*table(suite, answers), "", *medians(suite, answers)]))


if __name__ == "__main__":
    main()
