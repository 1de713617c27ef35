"""Read scene files of several kinds, and write momapos scenes.

The content determines the kind: a JSON object is a momapos scene, a JSON list a BestMan scene, XML
a URDF, which is a scene of one object, and YAML a map of Nav2.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import numpy as np

from momapos.core import (
    USER_CACHE,
    Cache,
    ChosenName,
    FileFormatError,
    InputError,
    SceneError,
    as_path,
    expect,
    keys_of,
    parse_json,
    read_record,
    read_text_bounded,
    resolved,
    unknown_name,
    write_file,
)
from momapos.model.records import JointResistance
from momapos.model.urdf import Geometry, Mesh, Urdf

from . import bestman
from .contents import check_supports
from .formats import foreign_kind, is_map, obj_text, urdf_text
from .map_room import read_map_scene, with_map
from .model_copies import model_files
from .object_reader import (
    FLOOR_EDGE,
    ObjectModels,
    ObjectReader,
    confidence_to_json,
    hypotheses_to_json,
    size_hint,
    usual_edge,
)
from .scene import Scene, checked_outline
from .scene_members import BESTMAN_KEYS, MAX_OBJECTS, SceneFile, SceneWall, ignored_keys, place_of
from .scene_names import FORMAT, MAX_BYTES, find_scene
from .scene_object import (
    SceneObject,
    Wall,
    check_crossing,
    wall_name,
    walls_around,
)

if TYPE_CHECKING:
    from jaxtyping import Float


ALONG_FLOOR = "floor"


def read_walls(
    given: Literal["floor"] | Sequence[SceneWall] | None,
    floor: Float[np.ndarray, "k 2"] | None,
    where: str,
) -> tuple[Wall, ...]:
    """Return the walls of a scene file.

    Args:
        given: "floor", or the walls of the file; None for no walls.
        floor: Outline of the floor [m].
        where: Start of messages.

    Raises:
        SceneError: A wall is too short or long, two walls cross, or there is no floor to follow.
    """
    if given is None:
        return ()
    if isinstance(given, str):
        if floor is None:
            raise SceneError(
                f'{where}: "{ALONG_FLOOR}" needs the outline of the floor; add "floor": '
                "[[x, y], ...], or list the walls"
            )
        return _named(where, walls_around, floor)
    walls = tuple(
        _named(f"{where}: {wall_name(i)}", Wall, one.start, one.to, one.height, one.thickness)
        for i, one in enumerate(given)
    )
    check_crossing(walls, where)
    return walls


def _named(where: str, make: Any, *arguments: Any) -> Any:
    """Make walls; the message of an error starts with `where`."""
    try:
        return make(*arguments)
    except InputError as error:
        raise SceneError(f"{where}: {error}".replace("Wall.", "")) from error


def walls_to_json(walls: Sequence[Wall], floor: Float[np.ndarray, "k 2"] | None) -> Any:
    """Return walls as a scene file has them."""
    if floor is not None and tuple(walls) == walls_around(floor):
        return ALONG_FLOOR
    return [
        {"from": list(w.start), "to": list(w.end), "height": w.height, "thickness": w.thickness}
        for w in walls
    ]


MAX_ROOM = (50.0, 50.0, 10.0)
"""Maximum size of a room with its floor [m]: clearance uses a grid of 10 cm, driving one of
5 cm."""
MAX_FILLED_VOLUME = 50_000.0
"""Maximum volume of all collision elements, each with `FILL_MARGIN` around it [m^3]; a grid lists
them."""
FILL_MARGIN = 0.3


def check_room_size(scene: Scene) -> None:
    """Refuse rooms that are too large for the planner's grids.

    Raises:
        SceneError: The room is larger than `MAX_ROOM`, or its elements fill more than
            `MAX_FILLED_VOLUME`; the message names the farthest object.
        UrdfError: A mesh of an object is invalid.
    """
    bounds = np.array([item.bounds for item in scene.objects]).reshape(-1, 2, 3)
    corners = bounds.reshape(-1, 3)
    if scene.floor_polygon is not None:
        corners = np.vstack([corners, np.pad(scene.floor_polygon, ((0, 0), (0, 1)))])
    if not len(corners):
        return
    size = np.ptp(corners, axis=0)
    if (size > MAX_ROOM).any():
        far = corners - np.median(corners, axis=0)
        worst = int(np.abs(far / MAX_ROOM).max(1).argmax()) // 2
        raise SceneError(
            f"{scene.path}: the room measures {' x '.join(f'{v:.4g}' for v in size)} m; at most "
            f"{' x '.join(f'{v:g}' for v in MAX_ROOM)} m are supported; check "
            + _suspect(scene, worst)
        )
    elements = np.array([sum(map(len, item.model.hulls.values())) for item in scene.objects])
    filled = float(elements @ np.prod(np.ptp(bounds, axis=1) + 2 * FILL_MARGIN, axis=1))
    if filled > MAX_FILLED_VOLUME:
        raise SceneError(
            f"{scene.path}: its {elements.sum()} collision elements fill {filled:.3g} m^3 with "
            f"{FILL_MARGIN:g} m around each; at most {MAX_FILLED_VOLUME:g} m^3 are supported; use "
            "fewer elements"
        )


def _suspect(scene: Scene, index: int) -> str:
    """Return the object at an index, or the floor, with a hint at the unit of its size."""
    if index < len(scene.objects):
        item = scene.objects[index]
        name, size = repr(item.name), np.ptp(item.bounds, axis=0)
        usual = usual_edge(item.category, item.name, jointed=bool(item.model.joints))
    else:
        assert scene.floor_polygon is not None
        name, size, usual = "the floor", np.ptp(scene.floor_polygon, axis=0), FLOOR_EDGE
    hint = size_hint(size.tolist(), usual)
    measures = " x ".join(f"{v:.4g}" for v in size)
    return f"{name}, which measures {measures} m; {hint}" if hint else name


_NAME_LENGTH = 60
"""Maximum length of an object's name in a file name [-]."""
_DIGEST_LENGTH = 12
"""Number of digits of the hash of a file's content in its name [-]."""


def box_edges(urdf: Urdf) -> tuple[float, ...] | None:
    """Return the edges of a model that is one box around its origin [m]; None for others."""
    shapes = urdf.links[urdf.root].collisions
    if len(urdf.links) > 1 or len(shapes) != 1 or shapes[0].kind != "box":
        return None
    return shapes[0].size if np.array_equal(shapes[0].T_link_geometry, np.eye(4)) else None


def save_model(name: str, urdf: Urdf, folder: Path) -> Path:
    """Write a model without a file as a URDF with OBJ meshes; return the URDF.

    The names of the files contain a hash of their content, so that saving again changes no file
    that another scene uses.

    Args:
        name: Name of the object.
        urdf: The model.
        folder: Folder of the files, created if necessary.

    Raises:
        SceneError: A file cannot be written.
    """
    plain = re.sub(r"[^A-Za-z0-9._-]", "_", name)[:_NAME_LENGTH]
    files: dict[Mesh, Path] = {}

    def saved(shape: Geometry) -> Geometry:
        if not isinstance(shape.mesh, Mesh):
            return shape
        if shape.mesh not in files:
            files[shape.mesh] = Path(_write(folder, plain, ".obj", obj_text(shape.mesh)).name)
        return replace(shape, mesh=files[shape.mesh])

    links = {key: link.with_shapes(saved) for key, link in urdf.links.items()}
    return _write(folder, plain, ".urdf", urdf_text(replace(urdf, links=links)))


def _write(folder: Path, plain: str, suffix: str, text: str) -> Path:
    content = text.encode()
    digest = hashlib.sha256(content).hexdigest()[:_DIGEST_LENGTH]
    file = folder / f"{plain}_{digest}{suffix}"
    write_file(file, content, error=SceneError)
    return file


VERSION = 1


def load_scene(
    source: str | Path,
    *,
    root: str | Path | None = None,
    cache: Cache | None = USER_CACHE,
    visual_collisions: bool = True,
) -> Scene:
    """Load a scene.

    Args:
        source: Name of a built-in kitchen, or a file: a momapos scene, a BestMan scene, the URDF of
            a single object, which is placed on the floor at the origin, or a map of Nav2.
        root: Folder that no path in the scene may leave; by default the file's folder, for a
            BestMan scene the parent folder that contains `Asset`.
        cache: Stores expensive geometry; None to always compute it.
        visual_collisions: Whether visual shapes stand in where an object has no collision shapes,
            with a warning; if not, such an object is an error.

    Raises:
        UnknownNameError, FileFormatError, SceneError, UrdfError: The scene is invalid; one line
            says what is wrong and where.
    """
    path = find_scene(as_path("source", source) if not isinstance(source, str) else source)
    root = None if root is None else as_path("root", root)
    text = read_text_bounded(path, MAX_BYTES)
    if not text.strip():
        raise FileFormatError(f"{path}: is empty")
    start, kind = text.lstrip("\ufeff \t\r\n")[:1], foreign_kind(text)
    if is_map(text):
        scene = read_map_scene(path, root)
        check_room_size(scene)
        return scene
    if kind is not None:
        raise FileFormatError(
            f"{path}: is in the format {kind}; convert it first with "
            f"'momapos scene convert {path} {path.stem}.json'"
        )
    models = ObjectModels(root, cache, visual_collisions)
    if start == "<":
        scene = _read_single(path, models)
    elif start in ("{", "["):
        data = _parse_json(text, path)
        read = _read_bestman if bestman.is_bestman(data) else _read_momapos
        scene = read(data, path, models)
    else:
        raise FileFormatError(
            f"{path}: neither a scene (JSON: a momapos scene or a BestMan list), nor a URDF, nor a "
            "map (YAML with image, resolution and origin)"
        )
    _check_unique_names(scene)
    check_room_size(scene)
    return replace(scene, warnings=(*scene.warnings, *models.notes))


def _parse_json(text: str, path: Path) -> Any:
    def refuse(constant: str) -> NoReturn:
        raise FileFormatError(f"{path}: contains {constant}, which is not a finite number")

    try:
        return parse_json(text, constant=refuse)
    except (json.JSONDecodeError, RecursionError, ValueError) as error:
        raise FileFormatError(f"{path}: invalid JSON ({error})") from error


def _check_unique_names(scene: Scene) -> None:
    seen: dict[str, int] = {}
    for index, item in enumerate(scene.objects):
        if item.name in seen:
            raise SceneError(
                f"{scene.path}: objects {seen[item.name]} and {index} are both named "
                f"{item.name!r}; names must be unique"
            )
        seen[item.name] = index


def _read_single(path: Path, models: ObjectModels) -> Scene:
    """Read a URDF as a scene of one object that stands on the floor."""
    model = models(path, 1.0)
    category = bestman.category_of("", str(resolved(path)))
    plain = path.stem.lower() not in ("mobility", "model", "robot", "object")
    name = path.stem if plain else category
    item = SceneObject(name, category, np.eye(4), model)
    T = np.eye(4)
    T[2, 3] = -item.bounds[0, 2]
    return Scene(name, (SceneObject(name, category, T, model),), path)


def _read_bestman(data: Sequence[Any], path: Path, models: ObjectModels) -> Scene:
    if len(data) > MAX_OBJECTS:
        raise FileFormatError(f"{path}: more than {MAX_OBJECTS} objects")
    entries = bestman.read_entries(data, path)
    models.root = models.root or bestman.find_root(path)
    objects, warnings = bestman.read_objects(entries, models.root, models)
    ignored = ignored_keys(data, BESTMAN_KEYS, f"{path}")
    warnings = (*map(str, ignored), *warnings)
    return Scene(path.stem, objects, path, warnings=warnings, ignored_keys=ignored)


def _read_momapos(data: Mapping[str, Any], path: Path, models: ObjectModels) -> Scene:
    if data.get("format") != FORMAT:
        raise FileFormatError(
            f'{path}: not a scene; a momapos scene has "format": {FORMAT!r}, '
            f"this file has {data.get('format')!r:.60}"
        )
    if data.get("version") != VERSION:
        raise FileFormatError(
            f"{path}: version {data.get('version')!r:.60} of the scene format; "
            f"this momapos reads version {VERSION}"
        )
    models.root = root = resolved(models.root or path.parent)
    ignored = ignored_keys(data, keys_of(SceneFile), f"{path}")
    file = read_record(data, SceneFile, partial(place_of, data, where=f"{path}"), SceneError)
    _check_resistance_keys(data, f"{path}")
    objects = tuple(
        ObjectReader(item, f"{path}: object {index}", path.parent, root, models).read()
        for index, item in enumerate(file.objects)
    )
    check_supports(objects, f"{path}")
    floor = None
    if file.floor is not None:
        floor = np.array(checked_outline(file.floor, f"{path}: floor"))
    scene = Scene(
        name=file.name or path.stem,
        path=path,
        objects=objects,
        floor_polygon=floor,
        start=None if (at := file.start) is None else np.array([at.x, at.y, at.yaw]),
        areas={
            name: checked_outline(corners, f"{path}: areas: {name!r}")
            for name, corners in file.areas.items()
        },
        warnings=tuple(map(str, ignored)),
        ignored_keys=ignored,
    ).with_walls(read_walls(file.walls, floor, f"{path}: walls"))
    return scene if file.map is None else with_map(scene, file.map, root)


def _check_resistance_keys(data: Mapping[str, Any], path: str) -> None:
    """Refuse unknown members of resistances: a force that is not read would be assumed."""
    known = [one.name for one in fields(JointResistance)]
    for index, item in enumerate(data["objects"]):
        for joint, members in item.get("resistance", {}).items():
            for key in set(members).difference(known):
                place = place_of(data, ("objects", index, "resistance", ChosenName(joint)), path)
                raise unknown_name("key", key, known, place)


def save_scene(scene: Scene, path: str | Path) -> Scene:
    """Write a scene in the momapos format atomically.

    Models that were made from meshes are written to `<stem>_files` next to it.

    Returns:
        The scene of that file, so that plans in it can be verified.

    Raises:
        SceneError: A URDF or mesh is outside the file's folder, so the file could not be read
            again; the message suggests another folder.
    """
    expect("scene", scene, Scene)
    path = as_path("path", path)
    entries = [_object(item, path) for item in scene.objects if item.wall is None]
    objects = ",\n".join(f"  {json.dumps(entry)}" for entry in entries)
    head = {"format": FORMAT, "version": VERSION, "name": scene.name}
    text = json.dumps(head)[:-1]
    members = room_members(scene)
    if scene.walls:
        members["walls"] = walls_to_json(scene.walls, scene.floor_polygon)
    for key, value in members.items():
        text += f',\n "{key}": {json.dumps(value)}'
    write_file(path, f'{text},\n "objects": [\n{objects}\n ]}}\n', error=SceneError)
    return replace(scene, path=path)


def room_members(scene: Scene) -> dict[str, Any]:
    """Return the members of a scene file about the room: floor, start and areas, if known."""
    members: dict[str, Any] = {}
    if scene.floor_polygon is not None:
        members["floor"] = np.asarray(scene.floor_polygon, float).tolist()
    if scene.start is not None:
        members["start"] = dict(zip(("x", "y", "yaw"), map(float, scene.start), strict=True))
    if scene.areas:
        members["areas"] = dict(scene.areas)
    return members


def object_members(item: SceneObject) -> dict[str, Any]:
    """Return the members of a scene file about an object, without its pose and model."""
    members: dict[str, Any] = {"category": item.category}
    if item.model.closed:
        members["closed"] = dict(item.model.closed)
    if item.mass is not None:
        members["mass"] = item.mass
    if item.on is not None:
        members["on"] = item.on or None
    if item.resistance:
        members["resistance"] = {name: one.members() for name, one in item.resistance.items()}
    if item.latch is not None:
        members["latch"] = item.latch.members()
    if item.confidence is not None:
        members["confidence"] = confidence_to_json(item.confidence)
    if item.hypotheses:
        members["hypotheses"] = {
            name: hypotheses_to_json(rows) for name, rows in item.hypotheses.items()
        }
    return members


def _object(item: SceneObject, path: Path) -> dict[str, Any]:
    folder = resolved(path).parent
    T, urdf = item.T_world_object, item.model.urdf
    from scipy.spatial.transform import Rotation

    wxyz = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
    entry: dict[str, Any] = {
        "name": item.name,
        "pose": {"xyz": (T[:3, 3] + 0.0).tolist(), "wxyz": (wxyz + 0.0).tolist()},
        **object_members(item),
    }
    if urdf.path is None:
        edges = box_edges(urdf)
        if edges is not None:
            return {**entry, "box": list(edges)}
        file = save_model(item.name, urdf, folder / f"{path.stem}_files")
        return {**entry, "urdf": f"{file.parent.name}/{file.name}", "joints": dict(item.joints)}
    for file in model_files(item.model):
        if not resolved(file).is_relative_to(folder):
            raise SceneError(
                f"object {item.name!r} needs {file}, which is not below {folder}; "
                "write the scene into a folder above it, or copy the files"
            )
    relative = resolved(urdf.path).relative_to(folder).as_posix()
    return {**entry, "urdf": relative, "scale": urdf.scale, "joints": dict(item.joints)}
