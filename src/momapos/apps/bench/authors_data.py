"""Find what the suites of the paper need and momapos does not contain: the authors' models."""

from __future__ import annotations

import os
from pathlib import Path

from momapos.core import FileFormatError, InputError

SHARED = "MOMAPOS_SHARED"
"""Environment variable that names the folder of the authors' data."""
REPOSITORY = "https://github.com/AutonoBot-Lab/BestMan_Pybullet"
LABORATORY_FILE = "Asset/Scene/Scene/b512.json"
NEEDED = {
    "paper-real": (LABORATORY_FILE, "Asset/Scene/URDF_models/B512"),
    "paper-table": (LABORATORY_FILE, "Asset/Scene/URDF_models/B512"),
    "authors-sim": (
        "Asset/Scene/Kitchen_models", "Asset/Scene/URDF_models/furniture_chair",
        "Asset/Scene/URDF_models/furniture_table_rectangle_high",
    ),
}  # fmt: skip
"""Files and folders that a suite needs, in the authors' repository."""
PAPER = "paper"
"""Names all suites of the paper together."""


def authors_data(suite: str, file: str) -> Path:
    """Find the folder that holds the authors' repository.

    Args:
        suite: The suite that needs it.
        file: What is needed, below this folder.

    Raises:
        FileFormatError: It is in none of the searched places.
    """
    searched = _places()
    for folder in searched:
        if (folder / file).exists():
            return folder
    where = " or ".join(str((folder / file).absolute()) for folder in searched)
    raise FileFormatError(
        f"{suite}: the authors' models are not part of momapos, and there is no {where}; "
        "see 'momapos bench data paper'"
    )


def data_lines(name: str) -> tuple[list[str], bool]:
    """Return what a suite needs, where it comes from and where it lies, and whether all is there.

    Raises:
        InputError: The name is not that of a suite which needs data.
    """
    if name != PAPER and name not in NEEDED:
        known = ", ".join((PAPER, *NEEDED))
        raise InputError(f"no data belong to {name!r}; choose from {known}")
    suites = [name] if name in NEEDED else list(NEEDED)
    lines, complete = [], True
    for file in dict.fromkeys(one for suite in suites for one in NEEDED[suite]):
        found = next((folder / file for folder in _places() if (folder / file).exists()), None)
        users = ", ".join(suite for suite in suites if file in NEEDED[suite])
        lines.append(f"  {file} ({users}): {found.absolute() if found else 'missing'}")
        complete &= found is not None
    head = [f"from {REPOSITORY}, whose files keep their own licenses:"]
    steps = [
        f"  git clone --depth 1 {REPOSITORY} FOLDER/bestman",
        f"  export {SHARED}=FOLDER",
    ]
    return head + lines + ([] if complete else ["to get what is missing:", *steps]), complete


def _places() -> list[Path]:
    """Return the folders in which the repository may lie."""
    given = Path(os.environ.get(SHARED, "shared"))
    return [given / "data" / "bestman", given / "bestman", given]
