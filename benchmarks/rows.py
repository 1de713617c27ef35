"""What a benchmark has measured, kept in a folder for those who read on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def keep_rows(rows: Sequence[Any], folder: Path | None, name: str) -> None:
    """Write rows as FOLDER/NAME.json.

    Args:
        rows: What JSON can hold, a member a row.
        folder: Made where there is none; None to keep nothing.
        name: Of the benchmark.
    """
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.json").write_text(json.dumps(rows, indent=1) + "\n")
