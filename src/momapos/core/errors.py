"""Errors that momapos raises for unusable input.

Each message is one line: what is wrong, where, and what would be right. The command line prints it
and exits with status 2.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Literal

from .texts import one_line

Extra = Literal[
    "bench", "film", "hdf5", "kitchens", "parquet", "physics", "scan", "torch", "usd", "view",
    "xacro",
]  # fmt: skip
"""Names of the package's extras."""
REQUIREMENTS: dict[Extra, tuple[str, ...]] = {
    "bench": ("distributed>=2024.8",),
    "film": ("av>=14",),
    "hdf5": ("h5py>=3.10",),
    "kitchens": ("scene-synthesizer>=1.0",),
    "parquet": ("pyarrow>=15",),
    "physics": ("mujoco>=3.10", "pillow>=10.1"),
    "scan": ("onnxruntime>=1.18", "pillow>=10", "rosbags>=0.10"),
    "torch": ("torch>=2.10,<2.14",),
    "usd": ("usd-core>=25.5",),
    "view": ("viser>=1.1",),
    "xacro": ("xacrodoc>=2.0",),
}
"""Packages of each extra, as in pyproject.toml."""


class MomaposError(Exception):
    """Base class of momapos errors; its message is always one line."""

    def __str__(self) -> str:
        return one_line(super().__str__())


class InputError(MomaposError):
    """Unusable input."""


class FileFormatError(InputError):
    """A file is missing, unreadable, damaged, or of the wrong format or version."""


class UrdfError(FileFormatError):
    """A URDF is unusable: malformed, malicious, or not a tree."""


class SceneError(InputError):
    """A scene is inconsistent or does not contain what was requested."""


class RobotError(InputError):
    """A robot file is inconsistent with itself or with its URDF."""


class TaskError(InputError):
    """A task does not fit the scene or the robot."""


class TaskDoneError(TaskError):
    """Nothing is left to do: the part is where the task would move it."""


class UnknownNameError(InputError):
    """A name does not exist; the message suggests similar ones."""


class OutOfTimeError(MomaposError):
    """A time limit ended the work before there was an answer."""


class MissingExtraError(MomaposError):
    """An optional package is not installed; the message tells how to install it."""


@contextmanager
def require(extra: Extra) -> Iterator[None]:
    """Guard the import of an extra's packages, as in `with require("scan"): import PIL`.

    Raises:
        MissingExtraError: A package is not installed; the message tells how to install it.
    """
    try:
        yield
    except ImportError as error:
        name = error.name.partition(".")[0] if error.name else "a package"
        raise MissingExtraError(f"{name} is not installed; {install_hint(extra)}") from error


def install_hint(extra: Extra) -> str:
    """Return the command that installs the packages of an extra."""
    names = (
        f"'{requirement}'" if "<" in requirement else requirement.partition(">")[0]
        for requirement in REQUIREMENTS[extra]
    )
    return f"pip install {' '.join(names)}"


def unknown_name(kind: str, name: str, known: Iterable[str], where: str) -> UnknownNameError:
    """Build an error for a name that does not exist; its message suggests similar names.

    Args:
        kind: Kind of the named item, e.g. "object".
        name: The unknown name.
        known: Existing names.
        where: Where they exist, e.g. "scene kitchen".
    """
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.4)
    offer = near or names[:12]
    more = "" if near or len(names) <= 12 else f" and {len(names) - 12} more"
    hint = f"did you mean {', '.join(offer)}?" if near else f"it has {', '.join(offer)}{more}"
    return UnknownNameError(f"no {kind} {name!r} in {where}; {hint if names else 'it has none'}")
