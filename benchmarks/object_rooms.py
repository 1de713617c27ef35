"""Read furniture lists of other programs for `objects.room`."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from momapos.apps.bench.articulated import Usual

FRONT = (0.0, -1.0)
"""Direction of the front of every listed model, in its own frame."""
_NAME = re.compile(r"[\w .-]+(?:/[\w .-]+)+")
_MAX_HEIGHT = 10.0
"""Maximum height of hanging furniture [m]."""


def listed(folder: Path) -> list[tuple[str, Path, Usual]]:
    """Read the articulated objects of a folder's list: name, URDF and placement.

    Exits with a one-line message if the list is invalid.

    Args:
        folder: Holds `models.json`, a list of records: `name` with its kind before the last slash,
            `urdf` relative to the folder, `above` the floor [m], and whether it stands on a
            `counter`.
    """
    file = folder / "models.json"
    try:
        rows = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        sys.exit(f"{file}: cannot be read ({error.strerror}); sweet_home.py writes one")
    except (ValueError, RecursionError) as error:
        sys.exit(f"{file}: is not JSON ({error})")
    if not isinstance(rows, list) or not rows:
        sys.exit(f"{file}: must be a list of models, as sweet_home.py writes it")
    found: list[tuple[str, Path, Usual]] = []
    for number, row in enumerate(rows):
        why = _why_not(row, folder)
        if not why and row["name"] in {name for name, _, _ in found}:
            why = f"{row['name']} is there twice"
        if why:
            sys.exit(f"{file}: model {number}: {why}")
        usual = Usual(0.0, row["above"], counter=row["counter"], front=FRONT)
        found.append((row["name"], folder / row["urdf"], usual))
    return found


def _why_not(row: Any, folder: Path) -> str:
    """Return why a record is invalid; "" if it is valid."""
    if not isinstance(row, dict):
        return "is not a record"
    name, urdf = row.get("name"), row.get("urdf")
    above: Any = row.get("above")
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        return "name must be words with a slash between them, such as Maker/fridge/1"
    if not isinstance(row.get("counter"), bool):
        return "counter must be true or false"
    if type(above) not in (int, float) or not 0.0 <= above <= _MAX_HEIGHT:
        return f"above must be a height from 0 to {_MAX_HEIGHT:g} m"
    if row["counter"] and not above:
        return "above must be more than 0 for a model on a counter"
    if not isinstance(urdf, str) or "\0" in urdf:
        return "urdf must name a file"
    if not (folder / urdf).resolve().is_relative_to(folder.resolve()):
        return f"{urdf} is not in the folder"
    return "" if (folder / urdf).is_file() else f"{urdf} is not there"
