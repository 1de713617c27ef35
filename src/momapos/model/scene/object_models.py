"""Models of the objects of a scene file."""

from __future__ import annotations

from pathlib import Path

from momapos.core import Cache, resolved
from momapos.model.urdf import Articulated, read_furniture


class ObjectModels:
    """Reads each URDF of a scene once per scale, so that objects share their models."""

    def __init__(self, root: Path | None, cache: Cache | None, visual_collisions: bool) -> None:
        self.root, self.cache, self.visual_collisions = root, cache, visual_collisions
        self.read: dict[tuple[Path, float], Articulated] = {}

    def __call__(self, path: Path, scale: float) -> Articulated:
        key = (resolved(path), scale)
        if key not in self.read:
            urdf = read_furniture(
                path,
                root=self.root,
                scale=scale,
                cache=self.cache,
                visual_collisions=self.visual_collisions,
            )
            self.read[key] = Articulated(urdf, cache=self.cache)
        return self.read[key]

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed or left out, once per file."""
        return tuple(dict.fromkeys(n for model in self.read.values() for n in model.urdf.notes))
