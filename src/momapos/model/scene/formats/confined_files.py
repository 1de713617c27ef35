"""Find files named by an untrusted file, inside one folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from momapos.core import FileFormatError, resolved


def find_inside(name: str, places: Sequence[Path], root: Path, source: Path) -> Path:
    """Return the first of some places that is a file inside the root.

    Args:
        name: Name in the source, for messages.
        places: Possible paths.
        root: Folder that must contain the file after resolving links.
        source: File that contains the name.

    Raises:
        FileFormatError: The file is outside the root, is missing, or has an invalid name.
    """
    try:
        inside = [place for place in map(resolved, places) if place.is_relative_to(root)]
        found = next((place for place in inside if place.is_file()), None)
    except (FileFormatError, OSError) as error:  # too long, cyclic links, a NUL
        raise FileFormatError(f"{source}: {name!r:.80} is not a valid path") from error
    if found is not None:
        return found
    if not inside:
        raise FileFormatError(
            f"{source}: {name!r:.200} leaves {root}; if you trust the file, set root to a folder "
            "that contains both"
        )
    raise FileFormatError(f"{source}: {name!r:.200} does not exist below {root}")
