"""Read scene files of several kinds, and write momapos scenes.

The content determines the kind: a JSON object is a momapos scene, a JSON list a BestMan scene, XML
a URDF, which is a scene of one object, and YAML a map of Nav2.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from momapos.core import (
    Cache,
    FileFormatError,
    SceneError,
    as_path,
    expect,
    read_text_bounded,
    unknown_name,
    write_atomic,
)
from momapos.core.geometry import pose_wxyz
from momapos.model.scene.formats import foreign_kind, is_map
from momapos.model.urdf import Articulated, box_urdf

from . import bestman
from .code_models import box_edges, save_model
from .confidence import confidence_to_json, read_confidence
from .floor_areas import MAX_DISTANCE, read_areas, read_floor, read_numbers, read_start
from .hypotheses import hypotheses_to_json, read_hypotheses
from .latches import read_latch
from .map_room import read_map_scene, with_map
from .model_copies import model_files
from .object_models import ObjectModels
from .resistance_members import read_resistance
from .room_limits import check_room_size
from .scene import Scene, SceneObject
from .scene_keys import BESTMAN_KEYS, SCENE_KEYS, ignored_keys
from .scene_names import FORMAT, MAX_BYTES, find_scene
from .usual_sizes import size_hint, usual_edge
from .wall_files import read_walls, walls_to_json

if TYPE_CHECKING:
    from jaxtyping import Float

VERSION = 1
MAX_OBJECTS = 2_000
"""Maximum number of objects; relations between all pairs of them take about 5 s [-]."""
MIMIC_TOLERANCE = 1e-3
"""Largest difference between a mimic joint's value in a file and that of its leader [rad], [m]."""
MAX_EDGE = 1e3  # maximum edge of a box [m]


def load_scene(
    source: str | Path,
    *,
    root: str | Path | None = None,
    cache: Cache | None = None,
    visual_collisions: bool = True,
) -> Scene:
    """Load a scene.

    Args:
        source: Name of a built-in kitchen, or a file: a momapos scene, a BestMan scene, the URDF of
            a single object, which is placed on the floor at the origin, or a map of Nav2.
        root: Folder that no path in the scene may leave; by default the file's folder, for a
            BestMan scene the parent folder that contains `Asset`.
        cache: Stores expensive geometry.
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
        return json.loads(text.lstrip("\ufeff"), parse_constant=refuse)
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
    category = bestman.category_of("", str(path.resolve()))
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
    items = data.get("objects")
    if not isinstance(items, list) or len(items) > MAX_OBJECTS:
        raise FileFormatError(f"{path}: 'objects' must be a list of at most {MAX_OBJECTS}")
    models.root = root = (models.root or path.parent).resolve()
    ignored = ignored_keys(data, SCENE_KEYS, f"{path}")
    objects = []
    for index, item in enumerate(items):
        where = f"{path}: object {index}"
        if not isinstance(item, dict):
            raise FileFormatError(f"{where} must be a JSON object")
        objects.append(_ObjectReader(item, where, path.parent, root, models).read())
    floor = read_floor(data.get("floor"), f"{path}: floor")
    walls = read_walls(data.get("walls"), floor, f"{path}: walls")
    scene = Scene(
        name=_text(data.get("name", path.stem), f"{path}: name"),
        path=path,
        objects=tuple(objects),
        floor_polygon=floor,
        start=read_start(data.get("start"), f"{path}: start"),
        areas=read_areas(data.get("areas", {}), f"{path}: areas"),
        warnings=tuple(map(str, ignored)),
        ignored_keys=ignored,
    ).with_walls(walls)
    if data.get("map") is None:
        return scene
    return with_map(scene, _text(data["map"], f"{path}: map"), root)


class _ObjectReader:
    """One object of a momapos scene."""

    def __init__(
        self, item: Mapping[str, Any], where: str, folder: Path, root: Path, models: ObjectModels
    ) -> None:
        self.item, self.folder, self.root, self.models = item, folder, root, models
        self.name = _text(item.get("name"), f"{where}: name")
        self.where = f"{where} ({self.name!r})"

    def read(self) -> SceneObject:
        category = self.item.get("category", "")
        if not isinstance(category, str):
            raise SceneError(f"{self.where}: category must be a string")
        model = self.model()
        joints, names = self.joint_values("joints", model), list(model.joints)
        closed = self.joint_values("closed", model)
        if closed:
            model = model.changed(closed=closed)
        found = read_hypotheses(self.item.get("hypotheses", {}), names, self.where)
        sure = read_confidence(self.item.get("confidence"), names, self.where)
        followers = {name: j.mimic.joint if j.mimic else "" for name, j in model.joints.items()}
        known = read_resistance(self.item.get("resistance", {}), followers, self.where)
        item = SceneObject(self.name, category, self.pose(), model, joints, found, sure, known)
        return replace(item, latch=read_latch(self.item.get("latch"), model, self.where))

    def pose(self) -> Float[np.ndarray, "4 4"]:
        pose = self.item.get("pose")
        if not isinstance(pose, dict):
            raise SceneError(f"{self.where}: pose must be {{'xyz': [...], 'wxyz': [...]}}")
        xyz = read_numbers(pose.get("xyz"), 3, f"{self.where}: pose.xyz")
        wxyz = read_numbers(pose.get("wxyz", [1, 0, 0, 0]), 4, f"{self.where}: pose.wxyz")
        if np.abs(xyz).max() > MAX_DISTANCE:
            raise SceneError(f"{self.where}: pose.xyz is more than 10 km away")
        length = float(np.linalg.norm(wxyz))
        if not 0.9 < length < 1.1:
            raise SceneError(f"{self.where}: pose.wxyz has length {length:g}; it must be 1")
        return pose_wxyz(tuple(xyz), tuple(wxyz))

    def model(self) -> Articulated:
        if ("urdf" in self.item) == ("box" in self.item):
            raise SceneError(f"{self.where}: needs either 'urdf' or 'box'")
        if "box" in self.item:
            size = read_numbers(self.item["box"], 3, f"{self.where}: box")
            if size.min() <= 0 or size.max() > MAX_EDGE:
                category = str(self.item.get("category", ""))
                usual = usual_edge(category, self.name, jointed=False)
                hint = size_hint(size.tolist(), usual) if size.min() > 0 else ""
                raise SceneError(
                    f"{self.where}: box edges must be between 0 and {MAX_EDGE:g} m, not "
                    f"{', '.join(f'{v:g}' for v in size)}" + (f"; {hint}" if hint else "")
                )
            x, y, z = map(float, size)
            return Articulated(box_urdf(self.name, (x, y, z)))
        scale = float(read_numbers([self.item.get("scale", 1.0)], 1, f"{self.where}: scale")[0])
        if not 1e-3 <= scale <= 1e3:
            raise SceneError(f"{self.where}: scale must be between 0.001 and 1000, not {scale:g}")
        return self.models(self.file(), scale)

    def file(self) -> Path:
        text = _text(self.item["urdf"], f"{self.where}: urdf")
        try:
            file = (self.folder / text).resolve()
            inside, exists = file.is_relative_to(self.root), file.is_file()
        except (OSError, RuntimeError, ValueError) as error:  # too long, or links in a circle
            raise SceneError(f"{self.where}: urdf {text!r:.80} cannot be looked up") from error
        if Path(text).is_absolute() or not inside:
            raise SceneError(
                f"{self.where}: urdf {text!r} leaves the scene's folder {self.root}; "
                "paths are relative and stay inside it"
            )
        if not exists:
            raise SceneError(f"{self.where}: urdf {text!r} does not exist below {self.folder}")
        return self.folder / text

    def joint_values(self, key: str, model: Articulated) -> dict[str, float]:
        joints = self.item.get(key, {})
        if not isinstance(joints, dict):
            raise SceneError(f"{self.where}: {key} must be {{name: value}}")
        values = {}
        for name, value in joints.items():
            if name not in model.joints:
                raise unknown_name("movable joint", name, model.joints, self.where)
            number = float(read_numbers([value], 1, f"{self.where}: {key}: {name!r}")[0])
            joint = model.joint(name)
            if not joint.lower - 1e-6 <= number <= joint.upper + 1e-6:
                raise SceneError(
                    f"{self.where}: {key}: {name!r} is {number:g}, its limits are "
                    f"{joint.lower:g} to {joint.upper:g}"
                )
            values[name] = number
        return self.without_mimics(key, values, model)

    def without_mimics(
        self, key: str, values: Mapping[str, float], model: Articulated
    ) -> dict[str, float]:
        """Return values without those of mimic joints, which must agree with their leaders."""
        there = model.all_values(values)
        for name, value in values.items():
            mimic = model.joint(name).mimic
            if mimic is not None and abs(there[name] - value) > MIMIC_TOLERANCE:
                raise SceneError(
                    f"{self.where}: {key}: {name!r} is {value:g}, but it follows {mimic.joint!r} "
                    f"and is at {there[name]:g}; set {mimic.joint!r} instead"
                )
        return {name: v for name, v in values.items() if model.joint(name).mimic is None}


def _text(value: object, where: str) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= 1000 or not value.isprintable():
        raise SceneError(f"{where} must be a printable string of 1 to 1000 characters")
    return value


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
    write_text_atomic(path, f'{text},\n "objects": [\n{objects}\n ]}}\n')
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


def write_text_atomic(path: Path, text: str) -> None:
    """Write a text file atomically.

    Raises:
        SceneError: The file cannot be written.
    """
    try:
        write_atomic(path, text.encode())
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror})") from error


def _object(item: SceneObject, path: Path) -> dict[str, Any]:
    folder = path.resolve().parent
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
        if not file.resolve().is_relative_to(folder):
            raise SceneError(
                f"object {item.name!r} needs {file}, which is not below {folder}; "
                "write the scene into a folder above it, or copy the files"
            )
    relative = urdf.path.resolve().relative_to(folder).as_posix()
    return {**entry, "urdf": relative, "scale": urdf.scale, "joints": dict(item.joints)}
