"""Files that a file of a stranger names, looked for inside one folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from momapos.core import FileFormatError


def find_inside(name: str, places: Sequence[Path], root: Path, source: Path) -> Path:
    """The first of some places that is a file inside the root.

    Args:
        name: How the source calls it, for messages.
        places: Where it may be.
        root: Folder that it must lie in, links resolved.
        source: The file that names it.

    Raises:
        FileFormatError: It lies elsewhere, does not exist, or cannot be looked up.
    """
    try:
        resolved = [place.resolve() for place in places]
        inside = [place for place in resolved if place.is_relative_to(root)]
        found = next((place for place in inside if place.is_file()), None)
    except (OSError, RuntimeError, ValueError) as error:  # too long, links in a circle, a NUL
        raise FileFormatError(f"{source}: {name!r:.80} cannot be looked up") from error
    if found is not None:
        return found
    if not inside:
        raise FileFormatError(
            f"{source}: {name!r:.200} leaves {root}; if it is to be trusted with a larger folder, "
            "name that with --root"
        )
    raise FileFormatError(f"{source}: {name!r:.200} does not exist below {root}")
