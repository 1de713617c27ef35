"""Give files generated from `docs/schemas` to their readers: each is read, or refused in one line.

    python benchmarks/hostile_schemas.py [--count 3000] [--seed 0]

Each file follows its schema, with one meaning changed: another type, a value out of its range, a
missing or unknown key, control characters, huge numbers and texts, no numbers, a wrong unit. The
readers run in this process with a time limit. Exit status 1 if one raises anything but an error in
words, writes a message of several lines or with control characters, or takes longer than the limit.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import random
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

from momapos.apps.cli.main import main as momapos
from momapos.core.errors import MomaposError
from momapos.model.robots.robot import load_arms
from momapos.simulation.run_record import read_run

SCHEMAS = Path(__file__).parents[1] / "docs" / "schemas"
LIMIT = 20
"""Time of one reader [s]; the slowest reads in less than 1 s."""
URDF = (
    '<robot name="r"><link name="body"><collision><geometry><box size="0.6 0.6 0.8"/></geometry>'
    '</collision></link><link name="door"><collision><geometry><box size="0.02 0.6 0.8"/>'
    '</geometry></collision></link><joint name="hinge" type="revolute"><parent link="body"/>'
    '<child link="door"/><axis xyz="0 0 1"/><limit lower="0" upper="1.6" effort="1" '
    'velocity="1"/></joint></robot>'
)
OPTIONAL = 0.2
"""Share of the optional members that a file has [-]; with more, few files are read to their end."""
NAMES = {"urdf": "part.urdf", "format": "", "joint": "hinge", "holds": "hinge", "base_link": "body"}
"""Values of keys that name something in the generated folder."""
FORMATS = {"plan2": "momapos-plan"}
"""Where the name of a format is not that of its schema."""
CHANGES: tuple[Any, ...] = (
    None, True, 0, -1, 2**63, 10**30, -1e300, 1e308, math.nan, math.inf, 0.1, "", "x",
    "90 furlongs", "1e999deg", "../../etc/passwd", "a" * 100_000, "\x00", "\x1b[2J\x1b]0;x\x07",
    "\u202eabc", "\ud800", "$x^2^3$", "<b>&amp;", "|`*_", [], [1, 2, 3], [[[[[[]]]]]], {},
    {"x": {"y": [None]}},
)  # fmt: skip
"""Values that replace right ones."""


def instance(schema: dict[str, Any], whole: dict[str, Any], rng: random.Random, key: str) -> Any:
    """Return a value that follows a schema.

    Args:
        schema: The schema of the value.
        whole: The schema of the file, with its definitions.
        rng: Chooses among alternatives, and optional members.
        key: The key that holds the value.
    """
    if "$ref" in schema:
        return instance(whole["$defs"][schema["$ref"].rpartition("/")[2]], whole, rng, key)
    for word in ("anyOf", "oneOf"):
        if word in schema and "properties" not in schema:
            return instance(rng.choice(schema[word]), whole, rng, key)
    if "const" in schema:
        return schema["const"]
    if "enum" in schema:
        return rng.choice(schema["enum"])
    kind = schema.get("type")
    kind = rng.choice(kind) if isinstance(kind, list) else kind
    if kind == "object":
        needed = schema.get("required", ())
        members = schema.get("properties", {}).items()
        found = {
            name: instance(one, whole, rng, name)
            for name, one in members
            if name in needed or rng.random() < OPTIONAL
        }
        if {"urdf", "box"} <= set(schema.get("properties", {})):  # exactly one of them
            found.pop("box", None)
            found["urdf"] = NAMES["urdf"]
        more = schema.get("additionalProperties")
        if not found and isinstance(more, dict):
            return {"hinge": instance(more, whole, rng, key)}
        return found
    if kind == "array":
        if "prefixItems" in schema:
            return [instance(one, whole, rng, key) for one in schema["prefixItems"]]
        count = schema.get("minItems", rng.randrange(1, 3))
        return [instance(schema.get("items", {}), whole, rng, key) for _ in range(count)]
    if kind in ("number", "integer"):
        low = schema.get("minimum", schema.get("exclusiveMinimum", 0))
        high = schema.get("maximum", low + 1)
        return (
            rng.randint(int(low) + 1, int(high) + 1)
            if kind == "integer"
            else low + 0.5 * (high - low)
        )
    return {"boolean": True, "null": None}.get(
        str(kind), NAMES.get(key, f"{key}_{rng.randrange(3)}")
    )


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield all places of a file, as the list or dict that holds them, and the key there."""
    keys: Any = value if isinstance(value, dict) else range(len(value))
    for key in keys:
        yield value, key
        if isinstance(value[key], list | dict):
            yield from places(value[key])


def changed(data: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """Return a file with one meaning changed."""
    data = copy.deepcopy(data)
    holder, key = rng.choice(list(places(data)))
    kind = rng.random()
    if kind < 0.1 and isinstance(holder, dict):
        del holder[key]
    elif kind < 0.2 and isinstance(holder, dict):
        holder[f"{key}{rng.choice(CHANGES)!s:.50}"] = holder[key]
    elif kind < 0.3 and isinstance(holder, list):
        holder.extend([holder[key]] * rng.choice((1, 2, 5000)))
    elif kind < 0.4 and isinstance(holder[key], int | float):
        holder[key] *= rng.choice((-1, 1e-12, 1e3, 1e12))
    else:
        holder[key] = rng.choice(CHANGES)
    return data


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


def command(*words: str) -> Callable[[Path], None]:
    """Return a reader that runs a command; an exit status of 2 is a refusal."""

    def read(path: Path) -> None:
        shown, errors = StringIO(), StringIO()
        with redirect_stdout(shown), redirect_stderr(errors):
            status = momapos([word.format(path) for word in words])
        if any(not line.isprintable() for line in shown.getvalue().splitlines()):
            raise AssertionError("control characters in the output")
        if status == 2:
            raise MomaposError(errors.getvalue().strip())
        if status not in (0, 1, 3):
            raise AssertionError(f"exit status {status}")

    return read


READERS: dict[str, tuple[Callable[[Path], Any], ...]] = {
    "scene": (command("scene", "show", "{}"), command("scene", "show", "{}", "--json")),
    "robot": (load_arms,),
    "plan": (command("verify", "{}"), command("export", "{}", "--to", "csv", "--out", "{}.csv")),
    "plan2": (command("verify", "{}"), command("export", "{}", "--to", "ros2", "--out", "{}.ros")),
    "tour": (command("verify", "{}"),),
    "run": (read_run,),
}


def outcome(read: Callable[[Path], Any], path: Path) -> str:
    """Read a file; return what happened in words."""

    def late(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, late)
    signal.alarm(LIMIT)
    try:
        read(path)
    except TimeoutError:
        return "hang"
    except (MomaposError, OSError) as error:
        text = str(error)
        return "refused" if text and text.isprintable() else f"message {text!r:.120}"
    except Exception as error:  # what this looks for
        return f"traceback {type(error).__name__}: {error!s:.120}"
    finally:
        signal.alarm(0)
    return "read"


def main() -> int:
    """Generate the files and count the outcomes."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng, counts, wrong = random.Random(args.seed), Counter[str](), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "part.urdf").write_text(URDF)
        for number in range(args.count):
            name = rng.choice(list(READERS))
            schema = json.loads((SCHEMAS / f"{name}.schema.json").read_text())
            data = instance(schema, schema, rng, "")
            if name != "robot":
                data |= {"format": FORMATS.get(name, f"momapos-{name}")}
                data |= {"version": 2 if name == "plan2" else 1}
            whole = changed(data, rng) if number % 10 else data
            path = Path(folder) / f"f.{'toml' if name == 'robot' else 'json'}"
            rows = (f"{json.dumps(k)} = {toml(v)}" for k, v in whole.items() if v is not None)
            text = "\n".join(rows) if name == "robot" else json.dumps(whole)
            path.write_text(text, errors="replace")
            found = outcome(rng.choice(READERS[name]), path)
            counts[f"{name} {found.partition(' ')[0]}"] += 1
            if found not in ("read", "refused"):
                wrong[f"{name}: {found}"] += 1
    for words, count in sorted(counts.items()):
        print(f"{count:6} {words}")
    for words, count in wrong.most_common(20):
        print(f"{count:6} WRONG {words}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
