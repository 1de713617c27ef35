"""Remember the vertices of the mesh files that were read last."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.core import fork_safe_lock

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

MAX_BYTES = 64_000_000
"""Memory that the vertices take, except those of one larger mesh; meshes of robots and furniture
have 10 kB to 1 MB of vertices [bytes]."""


class RecentPoints:
    """The vertices of mesh files, by path and time of the last change."""

    def __init__(self, size: int = MAX_BYTES) -> None:
        self.size = size
        self.held = 0
        """Memory that the vertices take [bytes]."""
        self._known: OrderedDict[tuple[Path, int], Float[np.ndarray, "n 3"]] = OrderedDict()
        self._lock = fork_safe_lock()

    def get(
        self, path: Path, stamp: int, read: Callable[[Path], Float[np.ndarray, "n 3"]]
    ) -> Float[np.ndarray, "n 3"]:
        """Return the vertices of a file, and read them if they are not known.

        Args:
            path: The file.
            stamp: Time of its last change.
            read: Returns the vertices.
        """
        key = path, stamp
        with self._lock:
            if key in self._known:
                self._known.move_to_end(key)
                return self._known[key]
        points = read(path)
        with self._lock:
            if key not in self._known:
                self._known[key] = points
                self.held += points.nbytes
            found = self._known[key]
            while self.held > self.size and len(self._known) > 1:
                self.held -= self._known.popitem(last=False)[1].nbytes
        return found
