"""Read the files of an untrusted MJCF model: one tree without file names, and the meshes.

MuJoCo opens any file that a model names. It therefore gets a tree with includes expanded and only
the elements of a room, and the content of meshes that were found inside the root.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from momapos.core import FileFormatError, read_bytes_bounded, read_xml, resolved
from momapos.model.urdf import MAX_MESH_BYTES

from .imported_room import find_inside

MAX_BYTES = 20_000_000
"""Maximum size of an XML file [bytes]."""
MAX_ALL_MESH_BYTES = 500_000_000
MAX_INCLUDES = 500
MAX_DEPTH = 100
"""Maximum nesting of elements [-]."""
MAX_ELEMENTS = 200_000
"""Maximum number of elements, counted as often as they are replicated [-]."""
MESHES = (".obj", ".stl", ".msh")
"""Mesh formats that MuJoCo reads."""
_SECTIONS = {"compiler", "default", "asset", "worldbody", "equality"}
_WORLD = {"body", "geom", "joint", "freejoint", "site", "frame", "replicate", "inertial"}
_DEFAULTS = {"default", "geom", "joint", "site", "mesh", "equality"}
_MOTORS = {"motor", "position", "velocity", "intvelocity", "general"}
"""Actuators of joints, whose limits are the efforts of a robot."""
_COMPILER = {"angle", "eulerseq", "autolimits", "inertiafromgeom"}
"""Settings that define the meaning of numbers; others concern files or speed."""
_UNUSED = {"material", "hfield", "user"}
"""Attributes that name dropped elements."""
_SETTINGS = {"option", "size", "visual", "statistic"}
"""Sections without content of a room."""
OWN_TEXT = "momapos"
"""Name of the custom text for what MJCF cannot express."""
_NAMES = {
    "name", "class", "childclass", "mesh", "file", "joint1", "joint2", "data", "model",
}  # fmt: skip
"""Attributes that are not numbers."""
_NOT_FINITE = {"nan", "inf", "infinity"}
_SOFT = {"composite", "flexcomp", "flex", "skin"}


@dataclass(frozen=True)
class Mjcf:
    """A model without file names."""

    tree: Element
    meshes: dict[str, bytes]
    """Content of each mesh file, by its name in the tree."""
    files: dict[str, Path]
    """Path of each mesh file, by its name in the tree."""
    dropped: Counter[str] = field(default_factory=Counter)
    driven: tuple[str, ...] = ()
    """Names of actuated joints."""
    own_text: str | None = None
    """Additions of our own writer."""


def read_mjcf(path: Path, root: Path, *, actuators: bool = False) -> Mjcf:
    """Read an MJCF model with all its files.

    Args:
        path: The file.
        root: Folder that no file may leave.
        actuators: Whether the tree has the actuators of joints.

    Raises:
        FileFormatError: The file is invalid; one line says what is wrong and where.
    """
    tree = read_xml(path, MAX_BYTES)
    if tree.tag != "mujoco":
        raise FileFormatError(f"{path}: the root element is <{tree.tag}>; MJCF needs <mujoco>")
    root = resolved(root)
    _expand(tree, path, root)
    _check_element_count(tree, path)
    dropped: Counter[str] = Counter()
    driven = _driven(tree)
    meshdir = _last(tree, "meshdir") or _last(tree, "assetdir")
    flat = (_last(tree, "strippath") or "false") == "true"
    kept = _pruned(tree, dropped, path)
    if actuators:
        dropped["actuators"] -= _add_motors(tree, kept, path)
    meshes, files = _meshes(kept, path, root, meshdir, flat=flat)
    SubElement(kept, "compiler", boundmass="1e-6", boundinertia="1e-9")  # bodies may have none
    own = [
        text.get("data") for text in tree.iterfind("custom/text") if text.get("name") == OWN_TEXT
    ]
    return Mjcf(kept, meshes, files, dropped, driven, own[0] if own else None)


def _expand(tree: Element, path: Path, root: Path) -> None:
    """Replace includes by the content of their files."""
    seen = {resolved(path)}
    waiting = [(tree, path.parent, 0)]
    while waiting:
        parent, folder_of_parent, depth = waiting.pop()
        if depth > MAX_DEPTH:
            raise FileFormatError(f"{path}: elements are nested deeper than {MAX_DEPTH}")
        children, pending = [], [(child, folder_of_parent) for child in reversed(parent)]
        while pending:
            child, folder = pending.pop()
            if child.tag != "include":
                children.append(child)
                waiting.append((child, folder, depth + 1))
                continue
            name = child.get("file", "")
            # MuJoCo searches next to the model first, then next to the including file.
            file = find_inside(name, [path.parent / name, folder / name], root, path)
            if file in seen:
                raise FileFormatError(f"{path}: {name!r:.200} is included twice")
            seen.add(file)
            if len(seen) > MAX_INCLUDES:
                raise FileFormatError(f"{path}: includes more than {MAX_INCLUDES} files")
            pending += [(part, file.parent) for part in reversed(read_xml(file, MAX_BYTES))]
        parent[:] = children


def _check_element_count(tree: Element, path: Path) -> None:
    """Refuse too many elements, counted as often as they are replicated."""
    total = 0
    waiting = [(tree, 1)]
    while waiting and total <= MAX_ELEMENTS:
        element, times = waiting.pop()
        total += times
        if element.tag == "replicate":
            times *= _count(element, path)
        waiting += [(child, times) for child in element]
    if total > MAX_ELEMENTS:
        raise FileFormatError(f"{path}: more than {MAX_ELEMENTS} elements; use fewer")


def _count(element: Element, path: Path) -> int:
    text = element.get("count", "")
    if not (text.isascii() and text.isdigit() and 0 < len(text) < 7):
        raise FileFormatError(
            f"{path}: count={text!r:.40} of a <replicate> must be a number from 1 to 999999"
        )
    return int(text)


def _last(tree: Element, key: str) -> str | None:
    """Return the valid compiler setting, which is the last one."""
    found = [e.get(key) for e in tree.findall("compiler") if e.get(key) is not None]
    return found[-1] if found else None


def _driven(tree: Element) -> tuple[str, ...]:
    """Return the names of joints that actuators drive directly or through a tendon."""
    tendons: dict[str | None, list[str | None]] = {
        tendon.get("name"): [part.get("joint") for part in tendon.iter("joint")]
        for section in tree.findall("tendon")
        for tendon in section
    }
    names: list[str | None] = []
    for section in tree.findall("actuator"):
        for motor in section:
            names += [motor.get("joint"), motor.get("jointinparent")]
            names += tendons.get(motor.get("tendon"), [])
    return tuple(dict.fromkeys(name for name in names if name))


def _pruned(tree: Element, dropped: Counter[str], path: Path) -> Element:
    """Return the parts of a model that make up a room, and count the others."""
    kept = Element("mujoco", {key: value for key, value in tree.items() if key == "model"})
    for section in tree:
        if section.tag in _SETTINGS:
            continue
        if section.tag not in _SECTIONS:
            for what in section:
                if what.get("name") == OWN_TEXT:
                    continue
                dropped[_word(section.tag, what.tag)] += 1
        elif section.tag == "compiler":
            words = {key: value for key, value in section.items() if key in _COMPILER}
            SubElement(kept, "compiler", words)
        else:
            kept.append(_section(section, dropped, path))
    return kept


def _add_motors(tree: Element, kept: Element, path: Path) -> int:
    """Add the actuators of joints to the kept tree; return their number."""
    section = SubElement(kept, "actuator")
    for motor in tree.iterfind("actuator/*"):
        if motor.tag in _MOTORS and motor.get("joint"):
            words = {key: value for key, value in motor.items() if key not in _UNUSED}
            _check_finite(motor, words, path)
            SubElement(section, motor.tag, words)
    return len(section)


def _section(section: Element, dropped: Counter[str], path: Path) -> Element:
    top = Element(section.tag, dict(section.items()))
    waiting = [(section, top)]
    while waiting:
        source, target = waiting.pop()
        for child in source:
            if not isinstance(child.tag, str) or not _wanted(section.tag, child, dropped, path):
                continue
            words = {key: value for key, value in child.items() if key not in _UNUSED}
            _check_finite(child, words, path)
            waiting.append((child, SubElement(target, child.tag, words)))
    return top


def _check_finite(element: Element, words: dict[str, str], path: Path) -> None:
    """Refuse numbers that are not finite, about which MuJoCo only warns."""
    for key in words.keys() - _NAMES:
        if any(word.lstrip("+-") in _NOT_FINITE for word in words[key].lower().split()):
            raise FileFormatError(
                f"{path}: {key}={words[key]!r:.80} in <{element.tag}> must be finite numbers"
            )


def _wanted(section: str, element: Element, dropped: Counter[str], path: Path) -> bool:
    """Return whether an element of a section is kept; count it otherwise."""
    tag, kind = element.tag, element.get("type")
    if section == "default":
        return tag in _DEFAULTS | _MOTORS  # elements with other defaults are counted themselves
    if section == "worldbody" and tag == "attach":
        raise FileFormatError(
            f"{path}: attaches another model; combine both in one file first, for example with "
            "mujoco.MjSpec.from_file(FILE).to_xml()"
        )
    if tag == "geom" and (kind in ("hfield", "sdf") or element.get("hfield")):
        dropped[f"geoms of type {kind or 'hfield'}"] += 1
        return False
    if tag in {"worldbody": _WORLD, "asset": {"mesh"}, "equality": {"joint"}}[section]:
        return True
    dropped[_word(section, tag)] += 1
    return False


def _word(section: str, tag: str) -> str:
    """Return the report's name of a dropped element."""
    if tag in _SOFT or section in ("deformable",):
        return "soft bodies"
    if section == "equality":
        return f"equality constraints ({tag})"
    if section in ("worldbody", "asset"):
        return f"{tag}s"
    names = {
        "actuator": "actuators", "tendon": "tendons", "sensor": "sensors",
        "contact": "contact pairs and exclusions", "keyframe": "keyframes",
        "extension": "plugins", "custom": "custom data",
    }  # fmt: skip
    return names.get(section, f"elements of <{section}>")


def _meshes(
    tree: Element, path: Path, root: Path, meshdir: str | None, *, flat: bool
) -> tuple[dict[str, bytes], dict[str, Path]]:
    """Read the meshes of a tree, and rename them in it."""
    content: dict[str, bytes] = {}
    files: dict[str, Path] = {}
    total = 0
    for mesh in _mesh_elements(tree):
        name = mesh.get("file")
        if name is None:
            continue
        if flat:
            name = name.replace("\\", "/").rpartition("/")[2]
        suffix = Path(name).suffix.lower()
        if suffix not in MESHES:
            raise FileFormatError(f"{path}: mesh {name!r:.200} must be one of {', '.join(MESHES)}")
        if mesh.get("name") is None:
            mesh.set("name", Path(name).stem)
        file = find_inside(name, [path.parent / (meshdir or "") / name], root, path)
        data = read_bytes_bounded(file, MAX_MESH_BYTES)
        total += len(data)
        if total > MAX_ALL_MESH_BYTES:
            raise FileFormatError(
                f"{path}: its meshes have more than {MAX_ALL_MESH_BYTES / 1e6:g} MB"
            )
        key = f"mesh{len(content)}{suffix}"
        content[key], files[key] = data, file
        mesh.set("file", key)
        mesh.attrib.pop("content_type", None)
    return content, files


def _mesh_elements(tree: Element) -> Iterator[Element]:
    for section in tree.findall("asset"):
        yield from section.findall("mesh")
