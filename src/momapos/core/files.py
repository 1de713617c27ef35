"""Reading files that come from strangers, and knowing beforehand where a result can go."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from .errors import FileFormatError, InputError, MomaposError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


_CHUNK = 1 << 20
"""Read at once [bytes]; of a read, Python makes the whole buffer at once."""


def open_regular(
    path: Path, limit: int | None = None, *, error: type[MomaposError] = FileFormatError
) -> BinaryIO:
    """Open a file for reading, if it is one: no folder, fifo, socket or device.

    Args:
        path: The file; links are followed.
        limit: Largest size [bytes]; any where None.
        error: What to raise.

    Raises:
        MomaposError: As `error`: it does not exist, is no regular file, or is too large.
    """
    try:
        # Looked at before it is opened: opening a fifo waits, opening a device may act on it.
        _refuse_special(os.stat(path), path, limit, error)
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except FileNotFoundError as missing:
        raise error(f"{path}: no such file") from missing
    except OSError as reason:
        raise error(f"{path}: cannot be read ({reason.strerror})") from reason
    except ValueError as reason:  # a NUL in the name
        raise error(f"{str(path)!r}: is no name of a file") from reason
    try:
        _refuse_special(os.fstat(file.fileno()), path, limit, error)
    except BaseException:
        file.close()
        raise
    return file


def read_bytes_bounded(
    path: Path, limit: int, *, error: type[MomaposError] = FileFormatError
) -> bytes:
    """Read a file that may come from a stranger.

    Args:
        path: The file; links are followed.
        limit: Largest size [bytes].
        error: What to raise.

    Raises:
        MomaposError: As `error`: it does not exist, is no regular file (a fifo, a device, a
            folder), cannot be read, or is larger than the limit.
    """
    with open_regular(path, limit, error=error) as file:
        data = bytearray()
        try:
            while len(data) <= limit and (chunk := file.read(_CHUNK)):
                data += chunk
        except OSError as reason:
            raise error(f"{path}: cannot be read ({reason.strerror})") from reason
    if len(data) > limit:  # it grew meanwhile
        raise error(_too_large(path, limit))
    return bytes(data)


def read_xml(path: Path, limit: int, *, error: type[MomaposError] = FileFormatError) -> Element:
    """Read an XML file as UTF-8, whatever it declares; no DTDs, no entities.

    Args:
        path: The file.
        limit: Largest size [bytes].
        error: What to raise.

    Raises:
        MomaposError: As `error`: it cannot be read or is not well-formed.
    """
    return parse_xml(read_text_bounded(path, limit, error=error), path, error=error)


def read_text_bounded(
    path: Path, limit: int, *, error: type[MomaposError] = FileFormatError
) -> str:
    """Read a text file in UTF-8 as `read_bytes_bounded` does; what is no UTF-8 becomes U+FFFD."""
    data = read_bytes_bounded(path, limit, error=error)
    return data.decode("utf-8-sig", errors="replace")


def parse_xml(text: str, path: Path, *, error: type[MomaposError] = FileFormatError) -> Element:
    """Parse XML; no DTDs, no entities.

    Raises:
        MomaposError: As `error`: it is not well-formed.
    """
    from defusedxml import DefusedXmlException, ElementTree

    try:
        # A text, not bytes: a declared encoding is then passed over, which may be one that
        # Python does not know.
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
        raise error(f"{path}: is a fifo, a socket or a device; give a regular file")
    if limit is not None and status.st_size > limit:
        raise error(_too_large(path, limit))


def _too_large(path: Path, limit: int) -> str:
    return f"{path}: larger than such a file can be ({limit / 1e6:g} MB)"


def check_outputs(files: Sequence[Path | None] = (), folders: Sequence[Path | None] = ()) -> None:
    """Make sure that results can be written, before the work that makes them.

    Args:
        files: Files that will be written, made or replaced; None is passed over.
        folders: Folders that files will be written into, which need not exist yet.

    Raises:
        InputError: A file is a folder or the other way round, or its folder cannot be made or
            written to; the message says which.
    """
    for path in files:
        if path is not None:
            kind = _kind(path)
            if kind is not None and not stat.S_ISREG(kind):
                what = "is a folder" if stat.S_ISDIR(kind) else "is no regular file"
                raise InputError(f"{path}: {what}; give the name of a file to write")
            _check_folder(path.absolute().parent, path)
    for path in folders:
        if path is not None:
            _check_folder(path.absolute(), path)


def _kind(path: Path) -> int | None:
    """Mode of what is at a path; None where nothing is."""
    try:
        return os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:  # a name too long, links in a circle
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{str(path)!r}: is no name of a file") from error


def _check_folder(folder: Path, path: Path) -> None:
    """Whether a folder can be written into, or made below the nearest one that exists."""
    there = folder
    while (kind := _kind(there)) is None:
        there = there.parent
    if not stat.S_ISDIR(kind):
        raise InputError(f"{path}: cannot be written, for {there} is no folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{path}: cannot be written, for {there} may not be written to")
