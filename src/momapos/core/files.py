"""Read untrusted files safely, and write files whole: paths, folders, YAML, torch files.

A temporary file or folder is locked while its process lives, and named so that a later run
recognizes it.

A file of `torch.save` is a pickle inside a zip archive, and a pickle can run code. torch's
weights-only reader accepts tensors alone; this module checks the archive, and turns all failures
into one-line errors.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import secrets
import shutil
import stat
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from .errors import (
    FileFormatError,
    InputError,
    MissingExtraError,
    MomaposError,
    install_hint,
    require,
)
from .garbage import no_garbage_collection

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
"""Begins what a clone has instead of a large file until Git LFS downloads it."""
_CHUNK = 1 << 20
"""Size of one read; Python allocates the whole buffer of a read in advance [bytes]."""


def resolved(path: Path, *, error: type[MomaposError] = FileFormatError) -> Path:
    """Return an absolute path without links; the path need not exist.

    All code resolves paths by this function, since untrusted files name some of them.

    Raises:
        MomaposError: As `error`: links form a cycle, or the path is no path.
    """
    try:
        return path.resolve()
    except (OSError, RuntimeError) as reason:  # up to Python 3.12, a cycle is a RuntimeError
        cause = getattr(reason, "strerror", None) or "its links form a cycle"
        raise error(f"{path}: cannot be looked up ({cause})") from reason
    except ValueError as reason:  # a NUL in the name
        raise error(f"{str(path)!r}: not a valid file name") from reason


def open_regular(
    path: Path, limit: int | None = None, *, error: type[MomaposError] = FileFormatError
) -> BinaryIO:
    """Open a regular file for reading; reject folders, fifos, sockets and devices.

    Args:
        path: The file; links are followed.
        limit: Largest size [bytes]; None for no limit.
        error: Class of the error to raise.

    Raises:
        MomaposError: As `error`: the file does not exist, is not regular, or is too large.
    """
    try:
        # Check before opening: opening a fifo blocks, opening a device may have side effects.
        _refuse_special(os.stat(path), path, limit, error)
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except FileNotFoundError as missing:
        raise error(f"{path}: no such file") from missing
    except OSError as reason:
        raise error(f"{path}: cannot be read ({reason.strerror})") from reason
    except ValueError as reason:  # a NUL in the name
        raise error(f"{str(path)!r}: not a valid file name") from reason
    try:
        _refuse_special(os.fstat(file.fileno()), path, limit, error)
    except BaseException:
        file.close()
        raise
    return file


def read_bytes_bounded(
    path: Path, limit: int, *, error: type[MomaposError] = FileFormatError
) -> bytes:
    """Read an untrusted file; arguments and errors as for `open_regular`."""
    with open_regular(path, limit, error=error) as file:
        data = bytearray()
        try:
            while len(data) <= limit and (chunk := file.read(_CHUNK)):
                data += chunk
        except OSError as reason:
            raise error(f"{path}: cannot be read ({reason.strerror})") from reason
    if len(data) > limit:  # it has grown meanwhile
        raise error(_too_large(path, limit))
    if data.startswith(_LFS_POINTER):
        raise error(
            f"{path}: is a Git LFS pointer, not the file itself; run 'git lfs pull' in its "
            "repository"
        )
    return bytes(data)


def read_xml(path: Path, limit: int, *, error: type[MomaposError] = FileFormatError) -> Element:
    """Read an XML file as UTF-8, ignoring the declared encoding; see `parse_xml`.

    Raises:
        MomaposError: As `error`: the file is unreadable, or not well-formed XML.
    """
    return parse_xml(read_text_bounded(path, limit, error=error), path, error=error)


def read_text_bounded(
    path: Path, limit: int, *, error: type[MomaposError] = FileFormatError
) -> str:
    """Read an untrusted text file in UTF-8; invalid bytes become U+FFFD."""
    data = read_bytes_bounded(path, limit, error=error)
    return data.decode("utf-8-sig", errors="replace")


def parse_json(text: str, *, constant: Callable[[str], Any] | None = None) -> Any:
    """Parse JSON.

    Args:
        text: The content of a file; a byte order mark is skipped.
        constant: Called with NaN, Infinity and -Infinity, which are no JSON.

    Raises:
        ValueError: The text is no JSON.
        RecursionError: It is nested too deeply.
    """
    # One call, which no time limit interrupts: 20 MB take 0.4 s.
    with no_garbage_collection():
        return json.loads(text.lstrip("\ufeff"), parse_constant=constant)


def parse_xml(text: str, path: Path, *, error: type[MomaposError] = FileFormatError) -> Element:
    """Parse XML without DTDs and entities.

    Raises:
        MomaposError: As `error`: the text is not well-formed, or has a DTD.
    """
    from defusedxml import DefusedXmlException, ElementTree

    try:
        # Pass text, not bytes: Python may not know the declared encoding.
        root: Element = ElementTree.fromstring(text, forbid_dtd=True)
    except DefusedXmlException as reason:
        raise error(f"{path}: DTDs and entities are not allowed") from reason
    except (ElementTree.ParseError, ValueError, LookupError) as reason:
        raise error(f"{path}: not well-formed XML ({reason})") from reason
    return root


def _refuse_special(
    status: os.stat_result, path: Path, limit: int | None, error: type[MomaposError]
) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise error(f"{path}: is a folder, not a file")
    if not stat.S_ISREG(status.st_mode):
        raise error(f"{path}: is a fifo, socket or device; give a regular file")
    if limit is not None and status.st_size > limit:
        raise error(_too_large(path, limit))


def _too_large(path: Path, limit: int) -> str:
    return f"{path}: larger than the limit of {limit / 1e6:g} MB"


def check_outputs(files: Sequence[Path | None] = (), folders: Sequence[Path | None] = ()) -> None:
    """Check that results can be written, before computing them.

    Args:
        files: Files to write or replace; None is skipped.
        folders: Folders to write into; they need not exist.

    Raises:
        InputError: A file is a folder or vice versa, or a folder cannot be created or written to.
    """
    for path in files:
        if path is not None:
            kind = _kind(path)
            if kind is not None and not stat.S_ISREG(kind):
                what = "is a folder" if stat.S_ISDIR(kind) else "is not a regular file"
                raise InputError(f"{path}: {what}; give the name of a file to write")
            _check_folder(path.absolute().parent, path)
    for path in folders:
        if path is not None:
            _check_folder(path.absolute(), path)


def _kind(path: Path) -> int | None:
    """Return the mode of a path, or None if it does not exist."""
    try:
        return os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:  # the name is too long, or the links form a cycle
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{str(path)!r}: not a valid file name") from error


def _check_folder(folder: Path, path: Path) -> None:
    """Check that a folder can be written to, or created below its nearest existing parent."""
    there = folder
    while (kind := _kind(there)) is None:
        there = there.parent
    if not stat.S_ISDIR(kind):
        raise InputError(f"{path}: cannot be written, {there} is not a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{path}: cannot be written, no write permission for {there}")


SUFFIX = ".momapos"
"""Ending of the names of temporary files and folders, which begin with a dot."""
INCOMPLETE = f".incomplete{SUFFIX}"
"""Name of the file that marks a folder as incomplete."""
_RANDOM_BYTES = 6


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file atomically, creating its folder: readers see the old or the new content."""
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_abandoned(path.parent)
    with _locked(path.parent, path.name, folder=False) as (temporary, handle):
        view = memoryview(data)
        while len(view):
            view = view[os.write(handle, view) :]
        os.fsync(handle)
        temporary.replace(path)


def write_file(path: Path, content: str | bytes, *, error: type[MomaposError] = InputError) -> None:
    """Write a file atomically, creating its folder.

    Raises:
        MomaposError: As `error`: it cannot be written.
    """
    try:
        write_atomic(path, content.encode() if isinstance(content, str) else content)
    except OSError as reason:
        raise error(f"{path}: cannot be written ({reason.strerror})") from reason


@contextmanager
def temporary_folder(parent: Path, name: str) -> Iterator[Path]:
    """Make a folder in another one, and remove it at the end.

    Args:
        parent: The other folder.
        name: What it is for; part of its name.
    """
    remove_abandoned(parent)
    with _locked(parent, name, folder=True) as (temporary, _):
        yield temporary


def remove_abandoned(folder: Path) -> None:
    """Remove the temporary files and folders that killed processes left in a folder."""
    try:
        with os.scandir(folder) as entries:
            names = [e.name for e in entries if e.name.startswith(".") and e.name.endswith(SUFFIX)]
    except OSError:
        return
    for path in (folder / name for name in names if name != INCOMPLETE):
        _remove_if_unused(path, path)


@contextmanager
def incomplete(folder: Path, final: Path) -> Iterator[None]:
    """Mark a new folder as incomplete during a block, which renames it and completes it.

    Args:
        folder: The folder, before the block renames it.
        final: Its name after that.
    """
    handle = os.open(folder / INCOMPLETE, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o666)
    try:
        _lock(handle)
        yield
        with contextlib.suppress(FileNotFoundError):
            (final / INCOMPLETE).unlink()
    finally:
        os.close(handle)


def remove_if_incomplete(folder: Path) -> None:
    """Remove a folder that a killed process left incomplete."""
    if not folder.is_symlink():
        _remove_if_unused(folder / INCOMPLETE, folder)


@contextmanager
def _locked(parent: Path, name: str, *, folder: bool) -> Iterator[tuple[Path, int]]:
    """Make a temporary file or folder, locked and open; remove what is left of it at the end."""
    while True:
        path = parent / f".{name[:100]}.{secrets.token_hex(_RANDOM_BYTES)}{SUFFIX}"
        if folder:
            path.mkdir()
            flags = os.O_RDONLY | os.O_DIRECTORY
        else:
            flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
        try:
            handle = os.open(path, flags | os.O_CLOEXEC, 0o666)
        except FileNotFoundError:  # another process took the new folder for an abandoned one
            continue
        _lock(handle)
        if os.fstat(handle).st_nlink:
            break
        os.close(handle)
    try:
        yield path, handle
    finally:
        _remove(path)
        os.close(handle)


def _lock(handle: int) -> None:
    with contextlib.suppress(OSError):  # the file system has no locks
        fcntl.flock(handle, fcntl.LOCK_EX)


def _remove_if_unused(locked: Path, path: Path) -> None:
    """Remove a file or folder unless a living process holds a lock, or that is unknown."""
    try:
        handle = os.open(locked, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _remove(path)  # before the lock is free, for which its maker waits
    except OSError:
        return
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        if stat.S_ISDIR(path.lstat().st_mode):
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()


MAX_BYTES = 4_000_000_000
"""Largest file: several times the size of weights with two optimizer moments each [bytes]."""
MIN_TORCH = (2, 10)
"""Older versions of torch accept a pickle that claims more numbers than the archive contains."""
_GLOBAL = re.compile(r"GLOBAL ([\w.]{1,100})")


def load_tensors(path: Path) -> Any:
    """Read a file of `torch.save` on the CPU: tensors, plain values, lists and dictionaries.

    Raises:
        FileFormatError: The file is missing, damaged, not of torch, or contains other types.
        MissingExtraError: torch is not installed, or too old.
    """
    with require("torch"):
        import torch
    if tuple(map(int, torch.__version__.split(".")[:2])) < MIN_TORCH:
        raise MissingExtraError(
            f"torch {torch.__version__} cannot read untrusted files safely; {install_hint('torch')}"
        )
    with open_regular(path, MAX_BYTES) as file:
        check_archive(file, path)
        try:
            return torch.load(file, map_location="cpu", weights_only=True)
        except Exception as error:  # a forged pickle can make its reader raise anything
            raise FileFormatError(f"{path}: {_reason(error)}") from error


def check_archive(file: BinaryIO, path: Path) -> None:
    """Reject files that are not zip archives, or that unpack to more than their size."""
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise FileFormatError(
            f"{path}: truncated, or not written by torch.save ({error})"
        ) from error
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
        raise FileFormatError(f"{path}: is compressed; torch.save does not compress")
    if sum(entry.file_size for entry in entries) > os.fstat(file.fileno()).st_size:
        raise FileFormatError(f"{path}: damaged; its entries are larger than the file")
    file.seek(0)


def _reason(error: Exception) -> str:
    """Summarize torch's error, whose message fills a screen, in one line."""
    found = _GLOBAL.search(str(error))
    if found:
        return f"would run code when loaded ({found[1]}); use torch.save for tensors only"
    first = next(iter(str(error).strip().splitlines()), type(error).__name__)
    return f"damaged, or not written by torch.save ({first.split('. ')[0]:.120})"


MAX_DEPTH = 50
"""Maximum number of nested lists and mappings [-]."""
_NUMBER = re.compile(r"[-+]?(\.\d+|\d[\d_]*(\.\d*)?)([eE][-+]?\d+)?")
_CONSTANTS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE", "yes", "Yes", "YES", "on", "On", "ON"), True),
    **dict.fromkeys(("false", "False", "FALSE", "no", "No", "NO", "off", "Off", "OFF"), False),
}
"""Plain words with a meaning in YAML 1.1."""
_INFINITE = re.compile(r"([-+]?)\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


def parse_yaml(text: str, path: Path) -> Any:
    """Return the first document of a YAML text as dicts, lists, texts, numbers, bools and None.

    Args:
        text: The content of a file; later documents are not read.
        path: The file, for messages.

    Raises:
        FileFormatError: The text is not YAML, names a key twice, or has tags, aliases, or more than
            50 levels; one line says what is wrong and in which line.
    """
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        # Build from events: recursive readers of deep documents overflow the stack.
        builder = _Builder(path)
        for event in yaml.parse(text, Loader=loader):
            if isinstance(event, yaml.DocumentEndEvent):
                break
            builder.take(event)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f"line {mark.line + 1}: "
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise FileFormatError(f"{path}: {where}invalid YAML ({problem})") from error
    return builder.value


class _Builder:
    """Builds values from the events of a parser."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.value: Any = None
        self.open: list[Any] = []
        """Lists and mappings that are not complete, outermost first."""
        self.keys: list[Any] = []
        """The key of each open mapping that waits for its value."""

    def take(self, event: Any) -> None:
        """Add an event."""
        import yaml

        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise self._error(event, "anchors and aliases are not supported")
        tag = getattr(event, "tag", None)
        if tag is not None and tag != "!":
            raise self._error(event, f"the tag {tag!r:.60} is not supported")
        if isinstance(event, yaml.ScalarEvent):
            quoted = event.style in ("'", '"', "|", ">")
            self._add(event, event.value if quoted else _plain(event.value))
        elif isinstance(event, yaml.SequenceStartEvent):
            self._begin(event, [])
        elif isinstance(event, yaml.MappingStartEvent):
            self._begin(event, {})
        elif isinstance(event, yaml.SequenceEndEvent | yaml.MappingEndEvent):
            self.open.pop()
            self.keys.pop()

    def _error(self, event: Any, text: str) -> FileFormatError:
        return FileFormatError(f"{self.path}: line {event.start_mark.line + 1}: {text}")

    def _begin(self, event: Any, value: list[Any] | dict[str, Any]) -> None:
        if len(self.open) >= MAX_DEPTH:
            raise self._error(event, f"more than {MAX_DEPTH} nested lists and mappings")
        self._add(event, value)
        self.open.append(value)
        self.keys.append(_NO_KEY)

    def _add(self, event: Any, value: Any) -> None:
        if not self.open:
            self.value = value
        elif isinstance(self.open[-1], list):
            self.open[-1].append(value)
        elif self.keys[-1] is _NO_KEY:
            if isinstance(value, list | dict):
                raise self._error(event, "a key must be a word")
            if str(value) in self.open[-1]:
                raise self._error(event, f"the key {value!r:.60} stands twice")
            self.keys[-1] = str(value)
        else:
            self.open[-1][self.keys[-1]] = value
            self.keys[-1] = _NO_KEY


_NO_KEY = object()


def _plain(text: str) -> Any:
    """Return the value of a scalar without quotes."""
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _NUMBER.fullmatch(text):
        digits = text.replace("_", "")
        whole = digits.lstrip("+-").isdigit() and len(digits) < 20
        return int(digits) if whole else float(digits)
    infinite = _INFINITE.fullmatch(text)
    if infinite is None:
        return text
    return float(f"{infinite[1] or ''}inf") if infinite[2] else float("nan")
