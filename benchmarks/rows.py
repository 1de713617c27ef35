"""Read the command line of a benchmark, and report and store its measurements."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tyro


def commands(doc: str | None, *functions: Callable[..., Any]) -> Any:
    """Call the function that the first word of the command line names, or the only one.

    Args:
        doc: Text of `--help`.
        functions: Their parameters are the options.
    """
    named = {each.__name__.replace("_", "-"): each for each in functions}
    config = (tyro.conf.PositionalRequiredArgs, tyro.conf.FlagCreatePairsOff)
    if len(functions) == 1:
        return tyro.cli(functions[0], description=doc, config=config)
    return tyro.extras.subcommand_cli_from_dict(named, description=doc, config=config)


def child(command: Sequence[str], **options: Any) -> tuple[int, float, float, float]:
    """Run a command.

    Args:
        command: The command.
        options: As for `subprocess.Popen`.

    Returns:
        Exit status, wall time [s], processor time [s] and peak memory [GB] with its own children.
    """
    began = time.perf_counter()
    process = subprocess.Popen(command, **options)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    took, spent = time.perf_counter() - began, used.ru_utime + used.ru_stime
    return process.returncode, took, spent, used.ru_maxrss / 1e6


def emit(row: Any) -> None:
    """Print a row as one line of JSON."""
    print(json.dumps(row), flush=True)


def markdown(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a Markdown table."""
    first, *others = (f"| {' | '.join(map(str, line))} |" for line in (head, *rows))
    return "\n".join([first, f"|{'---|' * len(head)}", *others])


def milliseconds(seconds: Sequence[float]) -> str:
    """Return the median and the 95th percentile of times in words."""
    median, late = 1000 * np.percentile(seconds, (50, 95))
    return f"median {median:.0f} ms, 95th percentile {late:.0f} ms"


def keep_rows(rows: Any, folder: Path | None, name: str) -> None:
    """Write rows as FOLDER/NAME.json.

    Args:
        rows: Values that JSON can represent, one per row.
        folder: Created if missing; None to store nothing.
        name: Name of the benchmark.
    """
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.json").write_text(json.dumps(rows, indent=1) + "\n")
