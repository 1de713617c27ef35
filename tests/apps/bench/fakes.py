"""Jobs and rows without a robot."""

from __future__ import annotations

import sys
from pathlib import Path

from momapos.apps.bench.bench_records import Job, Row, Settings, Suite, SuiteTask

WORKER = (sys.executable, str(Path(__file__).parent / "fake_worker.py"))


def task(name: str = "task", what: str = "answers", group: str = "door") -> SuiteTask:
    return SuiteTask(name, group, "kitchen_small", "segway_ur5e", "open", what)


def job(key: str, what: str = "answers", limit: float = 60.0) -> Job:
    return Job(key, "/nowhere", task(key, what), "ours", Settings(limit=limit))


def row(key: str, **changes: object) -> Row:
    plain: dict[str, object] = {
        "key": key, "task": f"task {key}", "group": "door", "robot": "fetch", "method": "ours",
        "seed": 0, "outcome": "solved", "verified": True, "seconds": 0.5, "wall": 1.0,
        "stages": {"search": 0.4, "model": 0.1}, "driving": 2.0, "checked": 3, "sampled": 512,
        "bases": ((1.0, 2.0, 0.5),), "host": "node", "finished": 10.0,
    }  # fmt: skip
    return Row(**{**plain, **changes})  # type: ignore[arg-type]


def suite(*tasks: SuiteTask) -> Suite:
    return Suite("made", 1, 0, ("segway_ur5e",), ("ours",), {"kitchen_small": "digest"}, tasks)
