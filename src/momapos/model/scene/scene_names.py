"""Names of built-in kitchens and of objects; looking one up imports nothing heavy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from momapos.core import FileFormatError, parse_json, unknown_name

FORMAT = "momapos-scene"
LIBRARY = Path(__file__).parent / "library"
MAX_BYTES = 20_000_000
_SUFFIXES = (".json", ".urdf", ".xml")


def builtin_names() -> tuple[str, ...]:
    """Return the names of the built-in kitchens."""
    return tuple(sorted(path.stem for path in LIBRARY.glob("*.json")))


def find_scene(source: str | Path) -> Path:
    """Return the scene file of a built-in kitchen's name or a path.

    Raises:
        UnknownNameError: The source is neither; the message suggests similar names.
        FileFormatError: The file does not exist.
    """
    text = str(source)
    names = builtin_names()
    if text in names:
        return LIBRARY / f"{text}.json"
    path = Path(source)
    try:
        is_folder, is_file = path.is_dir(), path.is_file()
        is_special = path.exists() and not (is_folder or is_file)
    except OSError as error:  # for example a name that is too long
        raise FileFormatError(f"{text:.80}: no such scene file ({error.strerror})") from error
    if is_special:
        raise FileFormatError(f"{path}: is a fifo, a socket or a device; give a regular file")
    if is_folder:
        raise FileFormatError(f"{path}: is a folder; give a scene file in it")
    if not is_file:
        if path.suffix.lower() in _SUFFIXES or len(path.parts) > 1:
            raise FileFormatError(f"{path}: no such scene file")
        raise unknown_name("kitchen", text, names, "the built-in ones (or give a scene file)")
    return path


def refuse_unknown_object(path: Path, name: str) -> None:
    """Refuse an object that a momapos scene does not contain, before reading its models.

    Other errors in the file are left to its reader, and so are other kinds of scenes, because
    their readers make the object names.

    Raises:
        UnknownNameError: The object does not exist; the message suggests similar names.
    """
    data = _glance(path)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        return
    objects = data.get("objects")
    if not isinstance(objects, list) or not all(isinstance(item, dict) for item in objects):
        return
    names = [item.get("name") for item in objects]
    if all(isinstance(known, str) for known in names) and name not in names:
        raise unknown_name("object", name, names, f"scene {data.get('name', path.stem)}")


def builtin_size(name: str) -> tuple[int, int]:
    """Return the numbers of objects and of movable joints of a built-in kitchen."""
    from defusedxml import ElementTree

    items = json.loads((LIBRARY / f"{name}.json").read_text(encoding="utf-8"))["objects"]
    models = [ElementTree.parse(LIBRARY / item["urdf"]) for item in items if "urdf" in item]
    kinds = [joint.get("type") for model in models for joint in model.iter("joint")]
    return len(items), sum(kind != "fixed" for kind in kinds)


def _glance(path: Path) -> Any:
    try:
        if path.stat().st_size > MAX_BYTES:
            return None
        return parse_json(path.read_text(encoding="utf-8", errors="replace"))
    except (OSError, ValueError, RecursionError):
        return None
