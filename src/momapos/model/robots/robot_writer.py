"""Write a derived robot file with its SRDF and URDF: all files, or none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from momapos.core import Cache, RobotError, UrdfError, write_atomic

from .derive import Derived, ReportProgress, RobotSource, derive_robot
from .robot import Robot, load_arms
from .srdf import srdf_text
from .xacro import Expanded, expand_xacro, is_xacro


def write_robot(
    source: Path | RobotSource,
    out: Path | None = None,
    *,
    args: Mapping[str, str] | None = None,
    seed: int = 0,
    cache: Cache | None = None,
    report: ReportProgress = lambda _share, _what: None,
    inspect: Callable[[Sequence[Robot]], None] = lambda _arms: None,
) -> tuple[Path, Derived]:
    """Derive a robot file from a URDF or xacro file and write it.

    An SRDF is written next to it if links in permanent contact are missing in the URDF's own SRDF;
    for a xacro file also the expanded URDF.

    Args:
        source: The URDF or xacro file, and its options.
        out: The robot file; None for the URDF's name with `.toml`.
        args: Arguments of the xacro file by name.
        seed: Seed of the sampled arm states.
        cache: Stores expensive geometry.
        report: Receives the progress.
        inspect: Receives the arms; if it raises, nothing is written.

    Returns:
        The robot file, and what was derived.

    Raises:
        RobotError: A file exists already or cannot be written, or nothing can be derived.
        UrdfError: The URDF is invalid.
    """
    source = RobotSource(source) if isinstance(source, Path) else source
    plain = source.urdf.with_suffix("") if is_xacro(source.urdf) else source.urdf
    out = out or plain.with_suffix(".toml")
    _refuse_existing(out)
    if out.parent.exists() and not out.parent.is_dir():
        raise RobotError(f"{out}: cannot be written ({out.parent} is no folder)")
    files: dict[Path, str] = {}
    if is_xacro(source.urdf):
        urdf = out.with_suffix(".urdf")
        _refuse_existing(urdf)
        expanded = expand_xacro(source.urdf, source.packages, args or {})
        files[urdf] = expanded.urdf
        derived = _derive_expanded(source, urdf, expanded, out, seed, cache, report)
    else:
        derived = derive_robot(source, out, seed=seed, cache=cache, report=report)
    if derived.pairs:
        srdf = out.with_suffix(".srdf")
        _refuse_existing(srdf)
        files[srdf] = srdf_text(out.stem, derived.pairs)
    _write({**files, out: derived.toml}, out, cache, inspect)
    return out, derived


def _derive_expanded(
    source: RobotSource,
    urdf: Path,
    expanded: Expanded,
    out: Path,
    seed: int,
    cache: Cache | None,
    report: ReportProgress,
) -> Derived:
    """Derive a robot file from an expanded xacro file; say what the file leaves out by default."""
    near = source.urdf
    source = replace(
        source, urdf=urdf, packages=expanded.packages, content=expanded.urdf, near=near
    )
    try:
        derived = derive_robot(source, out, seed=seed, cache=cache, report=report)
    except (RobotError, UrdfError) as error:  # the URDF is not written
        off = f"; {near.name} leaves parts out by default: {expanded.off}" if expanded.off else ""
        raise type(error)(str(error).replace(str(urdf), str(near)) + off) from error
    notes = [*expanded.notes, *derived.assumptions]
    if expanded.off:
        notes.append(f"xacro: {near.name} leaves parts out by default: {expanded.off}")
    return replace(derived, assumptions=tuple(notes))


def _refuse_existing(path: Path) -> None:
    if path.exists():
        raise RobotError(f"{path}: exists already; remove it, or choose another file")


def _write(
    files: Mapping[Path, str],
    out: Path,
    cache: Cache | None,
    inspect: Callable[[Sequence[Robot]], None],
) -> None:
    """Write files, the robot file last; remove all if it cannot be read back and inspected."""
    written: list[Path] = []
    folders = [folder for folder in (out.parent, *out.parent.parents) if not folder.exists()]
    try:
        for path, text in files.items():
            write_atomic(path, text.encode())
            written.append(path)
        inspect(load_arms(out, cache=cache))
    except BaseException as error:  # also on an interrupt
        for path in written:
            path.unlink(missing_ok=True)
        for folder in folders:
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
        if isinstance(error, OSError):
            raise RobotError(f"{error.filename}: cannot be written ({error.strerror})") from error
        raise
