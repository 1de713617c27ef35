"""Find the mesh files that a URDF names, within the allowed folders."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from momapos.core import UrdfError

MAX_MESH_PARENTS = 4
"""Meshes may be up to this many folders above the URDF's; packages have them next to `urdf` [-]."""
_SCHEME = re.compile(r"^(package|file|model)://")


@dataclass(frozen=True)
class MeshFinder:
    """Finds the meshes of one URDF."""

    path: Path
    """The URDF."""
    root: Path | None = None
    """Folder that must contain all meshes; None: `MAX_MESH_PARENTS` folders above the URDF."""
    packages: Mapping[str, Path] = field(default_factory=dict)
    """Folders of packages by name, which may contain meshes, too."""

    def find(self, filename: str) -> Path:
        """Find a mesh; unknown packages are searched in the URDF's parent folders.

        Raises:
            UrdfError: The mesh does not exist, or is outside the allowed folders.
        """
        scheme, relative = _SCHEME.match(filename), _SCHEME.sub("", filename)
        try:
            found = self._look(scheme[1] if scheme else "", relative)
            folder, *_ = self._folders
            outside = not self._allowed((folder / relative).resolve())
        except (OSError, RuntimeError, ValueError) as error:  # too long, cyclic links, NUL
            raise UrdfError(f"{self.path}: mesh {filename!r:.80} cannot be looked up") from error
        if found is not None:
            return found
        if outside:
            raise UrdfError(
                f"{self.path}: mesh {filename!r} is outside {self._root}; move it inside"
            )
        name = relative.partition("/")[0]
        if scheme and scheme[1] == "package" and name not in self.packages:
            looked = ", ".join(str(folder) for folder in self._folders)
            raise UrdfError(
                f"{self.path}: package {name!r} of mesh {filename!r} was not found (searched in "
                f"{looked}); move it there, or give its folder: --package {name}=DIR of momapos "
                "robot check, [packages] in a robot file"
            )
        beside = self.path.resolve().parent
        where = self.packages.get(name, self._root) if scheme else beside
        raise UrdfError(f"{self.path}: mesh {filename!r} does not exist below {where}")

    @cached_property
    def _folders(self) -> list[Path]:
        folder = self.path.resolve().parent
        return [folder, *list(folder.parents)[:MAX_MESH_PARENTS]]

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
