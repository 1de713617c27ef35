"""Find what the suites of the paper need and momapos does not contain: the authors' models."""

from __future__ import annotations

import os
from pathlib import Path

from momapos.core import FileFormatError, InputError

SHARED = "MOMAPOS_SHARED"
"""Environment variable that names the folder of the authors' data."""
REPOSITORY = "https://github.com/AutonoBot-Lab/BestMan_Pybullet"
SUBMODULE = "Asset/Scene/URDF_models"
"""Folder of the repository which a clone without its submodules leaves empty."""
LABORATORY_FILE = "Asset/Scene/Scene/b512.json"
_LABORATORY = (LABORATORY_FILE, f"{SUBMODULE}/B512")
NEEDED = {
    "paper-real": _LABORATORY,
    "paper-table": _LABORATORY,
    "authors-sim": (
        *(f"Asset/Scene/Kitchen_models/models/{name}"
          for name in ("Dishwasher/2085", "Fridge/10144", "Microwave/7128")),
        *(f"Asset/Scene/Kitchen_models/models_yan/{name}" for name in ("elementA", "elementB")),
        f"{SUBMODULE}/furniture_chair", f"{SUBMODULE}/furniture_table_rectangle_high",
    ),
}  # fmt: skip
"""Files and folders that a suite needs, in the authors' repository."""
PAPER = "paper"
"""Names all suites of the paper together."""


def authors_data(suite: str) -> Path:
    """Find the folder that holds all that a suite needs of the authors' repository.

    Raises:
        FileFormatError: Something is in none of the searched places.
    """
    places = _places()
    for folder in places:
        if not _missing(folder, suite):
            return folder
    nearest = min(places, key=lambda folder: len(_missing(folder, suite)))
    lacking = ", ".join(str((nearest / file).absolute()) for file in _missing(nearest, suite))
    raise FileFormatError(
        f"{suite}: the authors' models are not part of momapos, and there is no {lacking}; "
        f"'momapos bench data {suite}' says how to get them"
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
    head = [f"from {REPOSITORY} and its submodule {SUBMODULE}, whose files keep their licenses:"]
    steps = [
        f"  git clone --depth 1 --recurse-submodules {REPOSITORY} FOLDER/bestman",
        f"  export {SHARED}=FOLDER",
        f"in a clone without its submodule: git submodule update --init {SUBMODULE}",
    ]
    return head + lines + ([] if complete else ["to get what is missing:", *steps]), complete


def _missing(folder: Path, suite: str) -> list[str]:
    """Return what a suite needs and a folder lacks."""
    return [file for file in NEEDED[suite] if not (folder / file).exists()]


def _places() -> list[Path]:
    """Return the folders in which the repository may lie."""
    given = Path(os.environ.get(SHARED, "shared"))
    return [given / "data" / "bestman", given / "bestman", given]
