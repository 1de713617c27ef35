"""Find the mesh files that a URDF names, within the folders that they may come from."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from momapos.core import UrdfError

PARENTS = 4
"""How many folders above the URDF's own its meshes may lie; packages keep them beside `urdf`."""
_SCHEME = re.compile(r"^(package|file|model)://")


@dataclass(frozen=True)
class MeshFinder:
    """Finds the meshes of one URDF."""

    path: Path
    """The URDF."""
    root: Path | None = None
    """Folder that no mesh may leave; None: `PARENTS` folders above the URDF."""
    packages: Mapping[str, Path] = field(default_factory=dict)
    """Folders of packages by name; meshes may come from these too."""

    def find(self, filename: str) -> Path:
        """Resolve a mesh name; `package://` is looked for in parent folders where it is not known.

        Raises:
            UrdfError: It is in none of the folders, or outside all of them.
        """
        scheme, relative = _SCHEME.match(filename), _SCHEME.sub("", filename)
        try:
            found = self._look(scheme[1] if scheme else "", relative)
            folder, *_ = self._folders
            outside = not self._allowed((folder / relative).resolve())
        except (OSError, RuntimeError, ValueError) as error:  # too long, links in a circle, NUL
            raise UrdfError(f"{self.path}: mesh {filename!r:.80} cannot be looked up") from error
        if found is not None:
            return found
        if outside:
            raise UrdfError(
                f"{self.path}: mesh {filename!r} leaves {self._root}; keep meshes inside it"
            )
        name = relative.partition("/")[0]
        if scheme and scheme[1] == "package" and name not in self.packages:
            looked = ", ".join(str(folder) for folder in self._folders)
            raise UrdfError(
                f"{self.path}: package {name!r} of mesh {filename!r} was not found (looked in "
                f"{looked}); put it there, or say where it is: --package {name}=DIR of momapos "
                "robot check, [packages] in a robot file"
            )
        beside = self.path.resolve().parent
        where = self.packages.get(name, self._root) if scheme else beside
        raise UrdfError(f"{self.path}: mesh {filename!r} does not exist below {where}")

    @cached_property
    def _folders(self) -> list[Path]:
        folder = self.path.resolve().parent
        return [folder, *list(folder.parents)[:PARENTS]]

    @cached_property
    def _root(self) -> Path:
        return self.root.resolve() if self.root else self._folders[-1]

    @cached_property
    def _roots(self) -> list[Path]:
        return [self._root, *(folder.resolve() for folder in self.packages.values())]

    def _allowed(self, path: Path) -> bool:
        return any(path.is_relative_to(root) for root in self._roots)

    def _look(self, scheme: str, relative: str) -> Path | None:
        name, _, rest = relative.partition("/")
        if scheme in ("package", "model") and name in self.packages:
            candidates = [self.packages[name] / rest]
        else:
            candidates = [f / text for f in self._folders for text in (relative, rest or relative)]
        for candidate in candidates:
            resolved = candidate.resolve()
            if self._allowed(resolved) and resolved.is_file():
                return resolved
        return None
