"""Draw one-line faults in the numeric cores, and run the tests of each fault's own folder.

    python benchmarks/source_faults.py [--count 40] [--seed 0] [--groups verification statics ...]
                                       [--only K ...] [--tests PATH ...] [--list] [--out DIR]

A fault exchanges + and -, * and /, < and >, `min` and `max`, sine and cosine, or `and` and `or`;
it drops a factor, a sign, an absolute value or a `not`, doubles a number, or moves an index by one.
Messages, annotations and what only raises an error stay as they are, and so do numbers below 1e-6,
which guard divisions. The faults are spread evenly over the groups, in a group over the modules,
and in a module over the kinds; no line has two.

Each fault is applied alone, in a copy of `src`. It is caught if a test fails, or if the tests need
more than twice their usual time and `GRACE`; quick tests come first. The copy has a cache of its
own, without what the packages compute: kernels are stamped by their content, so a changed one is
compiled again. A fault that no test catches is a hole in the tests, or changes no result; which of
them has to be judged by reading.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from momapos.core import default_cache_dir
from placement import machine
from rows import keep_rows

REPOSITORY = Path(__file__).parents[1]
CORES = "momapos/verification", "momapos/model/kinematics"
GROUPS = ("verification", "statics", "kinematics")
WORDS = ("__init__", "report", "trust_notes", "plan_check", "scene_claims")
"""Modules that compare names and write messages."""
TESTS = {
    "verification": "tests/verification",
    "statics": "tests/model/kinematics",
    "kinematics": "tests/model/kinematics",
}
"""The folder of tests of each group."""
GRACE = 90.0
"""Time for compiling kernels, besides twice the usual time of the tests [s]."""
LEAST_NUMBER = 1e-6
"""Smaller numbers guard divisions and are not doubled."""
CACHED = {
    "verification": (
        "kernel-",
        "urdf-",
        "hulls-",
        "hull-",
        "boxes-",
        "static-",
        "pieces-",
        "reach-",
    ),
    "statics": ("kernel-",),
    "kinematics": ("kernel-",),
}
"""Prefixes of cached values that do not depend on a group, or are stamped by their content."""
OPPOSITE: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Lt: ast.Gt,
    ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
NAMES = {
    "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "argmin": "argmax",
    "argmax": "argmin", "sin": "cos", "cos": "sin", "any": "all", "all": "any",
}  # fmt: skip
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


@dataclass(frozen=True)
class Fault:
    """One changed line."""

    group: str
    file: str
    """In `src`."""
    line: int
    kind: str
    before: str
    after: str
    """The whole lines, without their line break."""


class _Sites(ast.NodeVisitor):
    """Collects the faults of a module: (kind, node, its replacement)."""

    def __init__(self) -> None:
        self.found: list[tuple[str, ast.expr | ast.stmt, ast.expr | ast.stmt]] = []
        self._in_function = False

    def _add(self, kind: str, node: Any, **changes: Any) -> None:
        changed = copy.deepcopy(node)
        for name, value in changes.items():
            setattr(changed, name, value)
        self.found.append((kind, node, changed))

    def _body(self, statements: Sequence[ast.stmt]) -> None:
        for statement in statements:
            self.visit(statement)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        before, self._in_function = self._in_function, True
        self._body(node.body)
        self._in_function = before

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._body(node.body)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None and "TypeAlias" not in ast.unparse(node.annotation):
            self.visit(node.value)

    def visit_If(self, node: ast.If) -> None:
        """Skip conditions of errors, and imports of type checkers."""
        if isinstance(node.body[-1], ast.Raise) or ast.unparse(node.test) == "TYPE_CHECKING":
            self._body(node.orelse)
        else:
            self.generic_visit(node)

    def _skip(self, node: ast.AST) -> None:
        pass

    visit_Raise = visit_Assert = visit_JoinedStr = visit_ExceptHandler = visit_arguments = _skip

    def visit_BinOp(self, node: ast.BinOp) -> None:
        self.generic_visit(node)
        op, parts = type(node.op), (node.left, node.right)
        if op not in OPPOSITE or not self._in_function or any(map(_is_text, parts)):
            return
        kind = "+ and -" if op in (ast.Add, ast.Sub) else "* and /"
        self._add(kind, node, op=OPPOSITE[op]())
        if op in (ast.Mult, ast.Div):
            self.found.append(("factor dropped", node, node.left))
        if op is ast.Mult:
            self.found.append(("factor dropped", node, node.right))

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self.generic_visit(node)
        op = type(node.op)
        if op in OPPOSITE and not _is_text(node.value):
            kind = "+ and -" if op in (ast.Add, ast.Sub) else "* and /"
            self._add(kind, node, op=OPPOSITE[op]())

    def visit_Compare(self, node: ast.Compare) -> None:
        self.generic_visit(node)
        if all(type(op) in OPPOSITE for op in node.ops):
            self._add("< and >", node, ops=[OPPOSITE[type(op)]() for op in node.ops])

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        self.generic_visit(node)
        self._add("and, or, not", node, op=OPPOSITE[type(node.op)]())

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        self.generic_visit(node)
        if isinstance(node.op, ast.Not):
            self.found.append(("and, or, not", node, node.operand))
        elif isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant):
            self.found.append(("sign dropped", node, node.operand))

    def visit_Call(self, node: ast.Call) -> None:
        self.generic_visit(node)
        name = _name(node.func)
        if name == "abs" and len(node.args) == 1:
            self.found.append(("absolute value dropped", node, node.args[0]))
        elif name in NAMES:
            kinds = {"sin": "sine and cosine", "cos": "sine and cosine", "any": "and, or, not"}
            kind = kinds.get(name, "and, or, not" if name == "all" else "min and max")
            changed: ast.expr = ast.Name(NAMES[name], ast.Load())
            if isinstance(node.func, ast.Attribute):
                changed = ast.Attribute(node.func.value, NAMES[name], ast.Load())
            self._add(kind, node, func=changed)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        self.generic_visit(node)
        if not self._in_function or not isinstance(node.ctx, ast.Load):
            return
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        for k, part in enumerate(parts):
            if isinstance(part, ast.Constant) and type(part.value) is int:
                moved = ast.Constant(part.value - 1 if part.value else 1)
                parts_moved = [*parts[:k], moved, *parts[k + 1 :]]
                tuple_moved = ast.Tuple(parts_moved, ast.Load())
                is_tuple = isinstance(node.slice, ast.Tuple)
                self._add("index moved", node, slice=tuple_moved if is_tuple else moved)

    def visit_Constant(self, node: ast.Constant) -> None:
        if type(node.value) is float and node.value >= LEAST_NUMBER:
            self._add("number doubled", node, value=2.0 * node.value)


def _is_text(node: ast.expr) -> bool:
    """Return whether an operand is text or a list, for which + concatenates."""
    if isinstance(node, ast.BinOp):
        return _is_text(node.left) or _is_text(node.right)
    text = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return text or isinstance(node, ast.JoinedStr | ast.List | ast.Tuple | ast.ListComp)


def _name(function: ast.expr) -> str:
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def faults_in(text: str, group: str, file: str) -> Iterator[Fault]:
    """Yield all faults of a module that change one line."""
    sites, lines = _Sites(), text.splitlines()
    sites.visit(ast.parse(text))
    for kind, node, changed in sites.found:
        if node.lineno != node.end_lineno:
            continue
        line = lines[node.lineno - 1].encode()  # columns count bytes
        words = ast.unparse(changed)
        words = words if isinstance(changed, ast.stmt | ast.Constant) else f"({words})"
        after = (line[: node.col_offset] + words.encode() + line[node.end_col_offset :]).decode()
        yield Fault(group, file, node.lineno, kind, line.decode(), after)


def modules() -> Iterator[tuple[str, Path]]:
    """Yield the modules that faults are drawn from, with their groups."""
    for folder in CORES:
        for path in sorted((REPOSITORY / "src" / folder).glob("*.py")):
            if path.stem not in WORDS:
                name = folder.rsplit("/", 1)[1]
                yield ("statics" if path.stem == "statics" else name), path


def draw(groups: Sequence[str], count: int, rng: np.random.Generator) -> list[Fault]:
    """Draw faults evenly over groups, over the modules of a group, and over the kinds."""
    out: list[Fault] = []
    for k, group in enumerate(GROUPS):
        own = [path for name, path in modules() if name == group]
        orders = []
        for path in own:
            file = str(path.relative_to(REPOSITORY / "src"))
            by_kind = defaultdict(list)
            for fault in faults_in(path.read_text(), group, file):
                by_kind[fault.kind].append(fault)
            orders.append(_in_turn([_shuffled(some, rng) for some in by_kind.values()], rng))
        drawn: dict[tuple[str, int], Fault] = {}
        for fault in _in_turn(orders, rng):
            drawn.setdefault((fault.file, fault.line), fault)
        share = count // len(GROUPS) + (k < count % len(GROUPS))
        out += list(drawn.values())[:share] if group in groups else []
    return out


def _shuffled(some: list[Any], rng: np.random.Generator) -> list[Any]:
    return [some[i] for i in rng.permutation(len(some))]


def _in_turn(lists: list[list[Fault]], rng: np.random.Generator) -> list[Fault]:
    """Return the first faults of all lists, then the second ones; the lists in random order."""
    lists = _shuffled(lists, rng)
    most = max(map(len, lists), default=0)
    return [one[i] for i in range(most) for one in lists if i < len(one)]


class Bench:
    """A copy of the sources, and the tests that run on it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(REPOSITORY / "src", folder / "src")

    def run(self, tests: Sequence[str], group: str, limit: float | None) -> tuple[str, float]:
        """Return the first failure of the tests, empty if there is none, and their time [s]."""
        cache = self.folder / "cache"
        cache.mkdir()
        home = default_cache_dir()
        for file in home.iterdir() if home.is_dir() else ():
            if file.name.startswith(CACHED[group]):
                (cache / file.name).symlink_to(file)
        environment = {
            **os.environ, "PYTHONPATH": str(self.folder / "src"), "MOMAPOS_CACHE": str(cache),
            "PYTHONDONTWRITEBYTECODE": "1",  # a change within a second would go unnoticed
        }  # fmt: skip
        command = [sys.executable, "-m", "pytest", "-x", "-n", "0", "-p", "no:cacheprovider"]
        began = time.monotonic()
        process = subprocess.Popen(
            [*command, f"--junitxml={self.folder / 'times.xml'}", *tests], cwd=REPOSITORY,
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            start_new_session=True,
        )  # fmt: skip
        try:
            out, _ = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return "time limit", time.monotonic() - began
        finally:
            shutil.rmtree(cache)
        found = _FAILED.search(out)
        failure = found[1] if found else f"exit status {process.returncode}"
        return failure if process.returncode else "", time.monotonic() - began

    def usual(self, group: str, tests: Sequence[str]) -> tuple[dict[str, float], float]:
        """Run tests without a fault; return the time of each file and of all [s].

        Raises:
            SystemExit: A test fails.
        """
        failure, seconds = self.run(tests, group, None)
        if failure:
            raise SystemExit(f"{failure} fails without a fault")
        times = dict.fromkeys(_files(tests), 0.0)
        for case in ElementTree.parse(self.folder / "times.xml").iter("testcase"):
            name = case.attrib["classname"].replace(".", "/") + ".py"
            times[name] = times.get(name, 0.0) + float(case.attrib["time"])
        return times, seconds

    def judge(self, fault: Fault, times: dict[str, float], limit: float) -> dict[str, Any]:
        """Apply a fault, run the tests and take it back; return a row."""
        names = sorted(times, key=times.__getitem__)
        path = self.folder / "src" / fault.file
        text = path.read_text()
        lines = text.splitlines(keepends=True)
        lines[fault.line - 1] = fault.after + "\n"
        path.write_text("".join(lines))
        failure, seconds = self.run(names, fault.group, limit)
        path.write_text(text)
        return {**asdict(fault), "caught": bool(failure), "by": failure, "seconds": seconds}


def _files(tests: Sequence[str]) -> list[str]:
    """Return the files with tests in folders, in order."""
    found = []
    for name in tests:
        path = REPOSITORY / name
        files = sorted(path.glob("test_*.py")) if path.is_dir() else [path]
        found += [str(file.relative_to(REPOSITORY)) for file in files]
    return found


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Return a table by group."""
    lines = [f"machine: {machine()}", "| group | faults | caught | by time limit | not caught |"]
    lines += ["|---" * 5 + "|"]
    for group in (*GROUPS, "all"):
        mine = [row for row in rows if group in (row["group"], "all")]
        caught = sum(row["caught"] for row in mine)
        late = sum(row["by"] == "time limit" for row in mine)
        lines.append(f"| {group} | {len(mine)} | {caught} | {late} | {len(mine) - caught} |")
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=40, help="number of faults")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--only", nargs="+", type=int, help="numbers of the faults to try")
    parser.add_argument("--tests", nargs="+", help="instead of the tests of the faults' folders")
    parser.add_argument("--list", action="store_true", help="print the faults, and run nothing")
    parser.add_argument("--out", type=Path, help="folder for source_faults.json")
    args = parser.parse_args()
    every = enumerate(draw(GROUPS, args.count, np.random.default_rng(args.seed)))
    faults = [
        (k, fault)
        for k, fault in every
        if fault.group in args.groups and (args.only is None or k in args.only)
    ]
    if args.list:
        for k, fault in faults:
            print(f"{k} {fault.file}:{fault.line} ({fault.kind})\n  {fault.before.strip()}")
            print(f"  {fault.after.strip()}")
        return
    rows: list[dict[str, Any]] = []
    usual: dict[tuple[str, ...], tuple[dict[str, float], float]] = {}
    with tempfile.TemporaryDirectory() as name:
        bench = Bench(Path(name))
        for k, fault in faults:
            tests = tuple(args.tests or (TESTS[fault.group],))
            if tests not in usual:
                usual[tests] = bench.usual(fault.group, tests)
                print(f"{' '.join(tests)}: {usual[tests][1]:.0f} s without a fault", flush=True)
            times, seconds = usual[tests]
            row = {"number": k, **bench.judge(fault, times, 2.0 * seconds + GRACE)}
            rows.append(row)
            keep_rows(rows, args.out, "source_faults")
            print(f"{k} {fault.file}:{fault.line} ({fault.kind}, {row['seconds']:.0f} s)")
            print(f"  {fault.before.strip()}\n  {fault.after.strip()}")
            print(f"  {row['by'] or 'NOT CAUGHT'}", flush=True)
    print(report(rows))


if __name__ == "__main__":
    main()
