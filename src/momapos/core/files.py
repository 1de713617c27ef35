"""Read untrusted files safely, and check early that results can be written."""

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
