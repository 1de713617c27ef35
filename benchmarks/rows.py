"""Store the measurements of a benchmark in a folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def keep_rows(rows: Sequence[Any], folder: Path | None, name: str) -> None:
    """Write rows as FOLDER/NAME.json.

    Args:
        rows: Values that JSON can represent, one per row.
        folder: Created if missing; None to store nothing.
        name: Name of the benchmark.
    """
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.json").write_text(json.dumps(rows, indent=1) + "\n")
