"""Change one meaning of right files; commands read each, or refuse it in one line.

    python benchmarks/hostile_schemas.py [--count 3000] [--seed 0] [--keep DIR]

The right files are a scene with every kind of member, the robots of the library, and plans of both
versions, a tour and a run that momapos writes first. One meaning of each is changed: a value of
another type or out of its range, another name of the same file, an optional member of
`docs/schemas`, a missing or unknown key, rows that are repeated, left out or exchanged. Every tenth
file stays as it is and must be read. What is read goes to the commands for it. They run in this
process with a time limit. Exit status 1 if one raises, writes several lines of error or control
characters, takes longer than the limit, says that it has written a file and has not, or refuses and
leaves one.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import random
import shutil
import signal
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

from momapos.apps.cli.main import main as momapos
from momapos.model.robots import library_file, library_names

SCHEMAS = Path(__file__).parents[1] / "docs" / "schemas"
LIMIT = 60
"""Time of one command [s]; the slowest takes less than 10 s."""
URDF = (
    '<robot name="r"><link name="body"><collision><geometry><box size="0.6 0.6 0.8"/></geometry>'
    '</collision></link><link name="door"><collision><origin xyz="0 0.3 0"/><geometry><box '
    'size="0.02 0.6 0.8"/></geometry></collision></link><link name="bar"><collision><origin '
    'xyz="0.04 0.5 0"/><geometry><box size="0.02 0.02 0.3"/></geometry></collision></link>'
    '<joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>'
    '<origin xyz="0.32 -0.3 0"/><axis xyz="0 0 -1"/><limit lower="0" upper="1.6" effort="1" '
    'velocity="1"/></joint><joint name="handle" type="revolute"><parent link="door"/>'
    '<child link="bar"/><origin xyz="0.02 0 0"/><axis xyz="1 0 0"/><limit lower="0" upper="0.7" '
    'effort="1" velocity="1"/></joint></robot>'
)
SCENE: dict[str, Any] = {
    "format": "momapos-scene", "version": 1, "name": "room",
    "floor": [[-3, -3], [3, -3], [3, 3], [-3, 3]], "walls": "floor",
    "start": {"x": 1.8, "y": -1.5, "yaw": 0.5}, "areas": {"mat": [[2, 2], [2.5, 2], [2.5, 2.5]]},
    "objects": [
        {
            "name": "cupboard", "category": "cabinet", "urdf": "part.urdf", "scale": 1.0,
            "pose": {"xyz": [-1.5, 0.0, 0.6], "wxyz": [1, 0, 0, 0]}, "joints": {"hinge": 0.1},
            "closed": {"hinge": 0.0}, "latch": {"joint": "handle", "to": "40deg", "holds": "hinge"},
            "resistance": {"hinge": {"seal_force": 5.0, "seal_travel": 0.01, "lever": 0.5,
                                     "friction": 0.2, "damping": 0.1, "mass": 4.0}},
            "hypotheses": {"hinge": [
                {"kind": "door_left", "probability": 0.9, "point": [0.32, -0.3, 0.0],
                 "axis": [0.0, 0.0, -1.0], "upper": 1.5},
                {"kind": "drawer", "probability": 0.1, "point": [0.32, 0.0, 0.0],
                 "axis": [1.0, 0.0, 0.0], "upper": 0.4},
            ]},
            "confidence": {"object": 0.9, "label": 0.8, "joints": {"hinge": 0.7}, "handles": {}},
        },
        {"name": "crate", "box": [0.3, 0.3, 0.3], "mass": 2.0,
         "pose": {"xyz": [0.5, 2.0, 0.15], "wxyz": [0.7071, 0, 0, 0.7071]}},
    ],
}  # fmt: skip
"""A room with every kind of member."""
MADE = {
    "plan": "place open kitchen_small fridge/door_hinge --robot segway_ur5e",
    "pick": "place pick kitchen_small bottle --robot fetch",
    "plan2": "place open kitchen_small microwave --robot stretch --base moving",
    "tour": "place open kitchen_small fridge/door_hinge --robot fetch then close fridge/door_hinge",
    "run": "run {folder}/plan.json",
}
"""Commands that write the other right files."""
SCHEMA_OF = {"pick": "plan"}
"""Where a file's schema has another name."""
OF_PLANS = (
    "verify {0}", "export {0} --to csv --out {1}.csv", "export {0} --to npz --out {1}.npz",
    "export {0} --to ros2 --out {1}.json", "export {0} --to moveit --out {1}.scene",
    "export {0} --to mcap --out {1}", "view {0} --static {1}.html",
    "run {0} --exact --out {1}.json",
)  # fmt: skip
COMMANDS: dict[str, tuple[str, ...]] = {
    "scene": (
        "scene show {0}", "scene show {0} --json", "rank {0} cupboard", "scene check {0}",
        "place open {0} cupboard/hinge --robot fetch --timeout 3 --out {1}.json",
    ),
    "robot": ("robot show {0}", "robot show {0} --json", "scene check kitchen_small --robot {0}"),
    "plan": OF_PLANS, "pick": OF_PLANS, "plan2": OF_PLANS,
    "tour": ("verify {0}", "export {0} --to csv --out {1}.csv"),
    "run": ("export {0} --to csv --out {1}.csv", "export {0} --to mcap --out {1}",
            "view {0} --static {1}.html"),
}  # fmt: skip
"""Commands for each file {0}, the first reads it to its end; {1} begins names of what it writes."""
CHANGES: tuple[Any, ...] = (
    None, True, 0, -1, 2**63, 10**30, -1e300, 1e308, math.nan, math.inf, 0.1, "", "x",
    "90 furlongs", "1e999deg", "../../etc/passwd", "a" * 100_000, "\x00", "\x1b[2J\x1b]0;x\x07",
    "\u202eabc", "\ud800", "$x^2^3$", "<b>&amp;", "|`*_", [], [1, 2, 3], [[[[[[]]]]]], {},
    {"x": {"y": [None]}},
)  # fmt: skip
"""Values that replace right ones."""


class Late(BaseException):
    """The time limit is over; no error, which a command would report as a refusal."""


def instance(schema: dict[str, Any], whole: dict[str, Any], rng: random.Random) -> Any:
    """Return a value that follows a schema.

    Args:
        schema: The schema of the value.
        whole: The schema of the file, with its definitions.
        rng: Chooses among alternatives.
    """
    if "$ref" in schema:
        return instance(whole["$defs"][schema["$ref"].rpartition("/")[2]], whole, rng)
    for word in ("anyOf", "oneOf"):
        if word in schema and "properties" not in schema:
            return instance(rng.choice(schema[word]), whole, rng)
    if "const" in schema:
        return schema["const"]
    if "enum" in schema:
        return rng.choice(schema["enum"])
    kind = schema.get("type")
    kind = rng.choice(kind) if isinstance(kind, list) else kind
    if kind == "object":
        members = schema.get("properties", {}).items()
        return {name: instance(one, whole, rng) for name, one in members}
    if kind == "array":
        rows = schema.get("prefixItems") or [schema.get("items", {})] * schema.get("minItems", 2)
        return [instance(one, whole, rng) for one in rows]
    if kind in ("number", "integer"):
        low = schema.get("minimum", schema.get("exclusiveMinimum", 0))
        high = schema.get("maximum", low + 1)
        return rng.randint(int(low), int(high)) if kind == "integer" else rng.uniform(low, high)
    return {"boolean": True, "null": None}.get(str(kind), "x")


def texts(value: Any) -> Iterator[str]:
    """Yield all keys and texts of a file."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from value
        for one in value.values():
            yield from texts(one)
    elif isinstance(value, list):
        for one in value[:50]:
            yield from texts(one)


def changed(data: dict[str, Any], schema: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """Return a file with one meaning changed; each member is as probable as the long ones."""
    data = copy.deepcopy(data)
    holder: Any = data
    at: dict[str, Any] = schema
    while True:
        at = _resolved(at, schema)
        members = at.get("properties", {})
        absent = [name for name in members if isinstance(holder, dict) and name not in holder]
        key = rng.choice([*(holder if isinstance(holder, dict) else range(len(holder)))])
        if absent and rng.random() < 0.2:
            name = rng.choice(absent)
            holder[name] = instance(members[name], schema, rng)
            return data
        if not isinstance(holder[key], dict | list) or not holder[key] or rng.random() < 0.25:
            break
        at = members.get(key) or at.get("items") or at.get("additionalProperties") or {}
        holder, at = holder[key], at if isinstance(at, dict) else {}
    kind, value = rng.random(), holder[key]
    if kind < 0.1 and isinstance(holder, dict):
        del holder[key]
    elif kind < 0.15 and isinstance(holder, dict):
        holder[f"{key}{rng.choice(CHANGES)!s:.50}"] = value
    elif kind < 0.3 and isinstance(holder, list):
        _reordered(holder, key, rng)
    elif kind < 0.65 and isinstance(value, str):
        holder[key] = rng.choice([*texts(data)])
    elif kind < 0.65 and isinstance(value, int | float) and not isinstance(value, bool):
        holder[key] = value * rng.choice((-1, 1e-12, 0.5, 2, 1e3, 1e12)) + rng.choice((0, 1e-3, 1))
    else:
        holder[key] = rng.choice(CHANGES)
    return data


def _resolved(at: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema that a reference or the first alternative with members names."""
    for one in (at, *at.get("anyOf", ())):
        if "$ref" in one:
            found: dict[str, Any] = schema["$defs"][one["$ref"].rpartition("/")[2]]
            return found
        if "items" in one or "additionalProperties" in one:
            return dict(one)
    return at


def _reordered(rows: list[Any], key: int, rng: random.Random) -> None:
    """Repeat, leave out, exchange or reverse rows."""
    kind = rng.randrange(4)
    if kind == 0:
        rows.extend([rows[key]] * rng.choice((1, 2, 5000)))
    elif kind == 1:
        del rows[key]
    elif kind == 2:
        other = rng.randrange(len(rows))
        rows[key], rows[other] = rows[other], rows[key]
    else:
        rows.reverse()


def toml(value: Any) -> str:
    """Write a value as TOML, on one line; TOML has no null."""
    if isinstance(value, dict):
        rows = (f"{json.dumps(k)} = {toml(v)}" for k, v in value.items() if v is not None)
        return f"{{{', '.join(rows)}}}"
    if isinstance(value, list):
        return f"[{', '.join(toml(one) for one in value if one is not None)}]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value)


def outcome(words: str, path: Path, out: Path) -> str:
    """Run a command on a file; return what happened, beginning with WRONG for a defect.

    Args:
        words: The command.
        path: The file.
        out: An empty folder for what it writes.
    """

    def late(*_: object) -> None:
        raise Late

    shown, errors = StringIO(), StringIO()
    args = [word.format(path, out / "made") for word in words.split()]
    signal.signal(signal.SIGALRM, late)
    signal.alarm(LIMIT)
    try:
        with redirect_stdout(shown), redirect_stderr(errors):
            status = momapos(args)
    except Late:
        return "WRONG: hang"
    except Exception as error:  # what this looks for
        return f"WRONG: traceback {type(error).__name__}: {error!s:.120}"
    finally:
        signal.alarm(0)
    made, refusal = any(out.iterdir()), errors.getvalue().strip()
    if any(not line.isprintable() for line in (shown.getvalue() + refusal).splitlines()):
        return "WRONG: control characters"
    # The report of a scene that planning refuses stands on the output.
    checked = words.startswith("scene check") and "error:" in shown.getvalue()
    if status == 2 and not checked:
        if not refusal or len(refusal.splitlines()) > 1:
            return f"WRONG: refused in {len(refusal.splitlines())} lines: {refusal[:200]!r}"
        return "WRONG: refused, and wrote a file" if made else "refused"
    if status not in (0, 1, 3, 4) and not checked:
        return f"WRONG: exit status {status}"
    promised = str(out) in shown.getvalue() or (
        status == 0 and "{1}" in words and not words.startswith("place")
    )
    return "WRONG: no file" if promised and not made else "read"


def right_files(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Write right files to a folder; return them by kind."""
    (folder / "part.urdf").write_text(URDF)
    for name, words in MADE.items():
        out = folder / f"{name}.json"
        with redirect_stdout(StringIO()):
            status = momapos([*words.format(folder=folder).split(), "--out", str(out)])
        if status:
            sys.exit(f"momapos {words}: exit status {status}")
    made = {name: [json.loads((folder / f"{name}.json").read_text())] for name in MADE}
    robots = [tomllib.loads(library_file(name).read_text()) for name in library_names()]
    for name, robot in zip(library_names(), robots, strict=True):
        for place in (robot, *robot.get("arms", {}).values(), robot.get("mount", {})):
            for key in {"urdf", "srdf"} & set(place):
                place[key] = str(library_file(name).parent / place[key])
    return {"scene": [SCENE], "robot": robots, **made}


def main() -> int:
    """Change the files and count the outcomes."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder for the files of defects")
    args = parser.parse_args()
    rng, counts, wrong = random.Random(args.seed), Counter[str](), Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        right = right_files(folder)
        for number in range(args.count):
            kind = rng.choice(list(COMMANDS))
            schema = json.loads((SCHEMAS / f"{SCHEMA_OF.get(kind, kind)}.schema.json").read_text())
            data, same = rng.choice(right[kind]), number % 10 == 0
            data = data if same else changed(data, schema, rng)
            path = folder / f"changed{'.toml' if kind == 'robot' else '.json'}"
            if kind == "robot":
                rows = (f"{json.dumps(k)} = {toml(v)}\n" for k, v in data.items() if v is not None)
                path.write_text("".join(rows), errors="surrogatepass")
            else:
                path.write_text(json.dumps(data))
            first, *others = COMMANDS[kind]
            for words in (first, rng.choice(others)):
                out = folder / "out"
                out.mkdir()
                found = outcome(words, path, out)
                shutil.rmtree(out)
                if same and found == "refused":
                    found = "WRONG: a right file is refused"
                step = "first command" if words == first else "further command"
                counts[f"{kind}, {'as it was' if same else 'changed'}, {step}: {found}"] += 1
                if found.startswith("WRONG"):
                    wrong[f"{words}: {found}"] += 1
                    print(f"{number} {words}: {found}", flush=True)
                    if args.keep is not None:
                        args.keep.mkdir(parents=True, exist_ok=True)
                        shutil.copy(path, args.keep / f"{args.seed}_{number}_{kind}{path.suffix}")
                if found == "refused":
                    break
    for words, count in sorted(counts.items()):
        print(f"{count:6} {words}")
    print(f"{sum(wrong.values())} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
