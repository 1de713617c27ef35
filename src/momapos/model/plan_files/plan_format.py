"""Read and write plan files (momapos-plan, versions 1 and 2)."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import msgspec
import numpy as np

from momapos.core import (
    FileFormatError,
    InputError,
    as_path,
    expect,
    read_bytes_bounded,
    read_text_bounded,
    resolved,
    write_file,
)
from momapos.model.records import (
    Assumption,
    BaseRegion,
    Candidates,
    CostTerm,
    Hold,
    JointVerb,
    KeyObjects,
    Motion,
    NearestMiss,
    Outline,
    Overrides,
    PlacementPlan,
    PoseVerb,
    Status,
    Task,
    Tolerance,
)
from momapos.model.robots import MAX_SRDF_BYTES, portable

from . import plan_members as members

if TYPE_CHECKING:
    from jaxtyping import Float


MAX_UNIT_ERROR = 1e-3
"""Largest error of the length of a unit vector in a file [-]."""


def holds_to_dict(holds: tuple[Hold, ...]) -> dict[str, Any]:
    """Return the members of a plan file that describe holds; none if there are no holds."""
    if not holds:
        return {}
    return {
        "holds": [[hold.first, hold.last] for hold in holds],
        "turn_axes": [hold.turn_axis for hold in holds],
        "families": [hold.family for hold in holds],
        "hold_words": [hold.words for hold in holds],
    }


def read_holds(motion: members.Manipulation, path: Path) -> tuple[Hold, ...]:
    """Check and return the holds: ordered state ranges, with unit axes or none."""
    axes = motion.turn_axes or [None] * len(motion.holds)
    bounds = [-1, *(state for hold in motion.holds for state in hold), len(motion.q)]
    in_order = all(a < b for a, b in zip(bounds[:-1:2], bounds[1::2], strict=True)) and all(
        first <= last for first, last in motion.holds
    )
    if not in_order:
        raise FileFormatError(
            f"{path}: manipulation.holds must be ordered, disjoint [first, last] of states 0 to "
            f"{len(motion.q) - 1}"
        )
    if len(axes) != len(motion.holds) or not all(
        axis is None or abs(math.hypot(*axis) - 1.0) < MAX_UNIT_ERROR for axis in axes
    ):
        raise FileFormatError(
            f"{path}: manipulation.turn_axes must be a unit vector or null for each of "
            f"{len(motion.holds)} holds"
        )
    families = motion.families or [""] * len(motion.holds)
    if len(families) != len(motion.holds) or any(len(name) > 40 for name in families):
        raise FileFormatError(f"{path}: manipulation.families must be a word for each hold")
    words = motion.hold_words or [""] * len(motion.holds)
    if len(words) != len(motion.holds) or any(len(text) > 400 for text in words):
        raise FileFormatError(f"{path}: manipulation.hold_words must be a line for each hold")
    holds = zip(motion.holds, axes, families, words, strict=True)
    return tuple(Hold(*hold, axis, family, text) for hold, axis, family, text in holds)


def motion_to_dict(motion: Motion | None) -> dict[str, Any]:
    """Return the members of a plan file that describe the arm's motion."""
    if motion is None:
        return {"approach": [], "approach_times": None, "manipulation": None, "home": None}
    return {
        "approach": motion.approach.tolist(),
        "approach_times": _list(motion.approach_times),
        "manipulation": {
            "q": motion.q.tolist(),
            "object_q": motion.object_q.tolist(),
            **({} if motion.base is None else {"base": motion.base.tolist()}),
            **({} if motion.latch_q is None else {"latch_q": motion.latch_q.tolist()}),
            "times": _list(motion.times),
            "T_world_tool": motion.Ts_world_tool.tolist(),
            **holds_to_dict(motion.holds),
        },
        "home": _list(motion.home),
    }


def _list(values: Float[np.ndarray, "..."] | None) -> Any:
    return None if values is None else values.tolist()


def read_motion(data: members.Plan, path: Path) -> Motion | None:
    """Check and return the arm's motion; None if the plan has none."""
    motion, n = data.manipulation, len(data.joints)
    if motion is None:
        return None
    approach = read_array(data.approach, (n,), path, "approach")
    q = read_array(motion.q, (n,), path, "manipulation.q")
    object_q = read_array(motion.object_q, (), path, "manipulation.object_q")
    Ts_world_tool = read_array(motion.T_world_tool, (4, 4), path, "manipulation.T_world_tool")
    latch_q = None
    if motion.latch_q is not None:
        latch_q = read_array(motion.latch_q, (), path, "manipulation.latch_q")
        if len(latch_q) != len(q):
            raise FileFormatError(f"{path}: manipulation.latch_q must have {len(q)} values")
    base = None
    if motion.base is not None:
        base = read_array(motion.base, (3,), path, "manipulation.base", "x, y and yaw")
        base[:, 2] = np.unwrap(base[:, 2])
        if len(base) != len(q):
            raise FileFormatError(f"{path}: manipulation.base must have {len(q)} poses")
    if not len(q) == len(object_q) == len(Ts_world_tool):
        raise FileFormatError(
            f"{path}: manipulation has {len(q)} q, {len(object_q)} object_q and "
            f"{len(Ts_world_tool)} T_world_tool; each state needs one of each"
        )
    return Motion(
        approach=approach,
        q=q,
        object_q=object_q,
        Ts_world_tool=Ts_world_tool,
        approach_times=_times(data.approach_times, len(approach), path, "approach_times"),
        times=_times(motion.times, len(motion.q), path, "manipulation.times"),
        holds=read_holds(motion, path),
        latch_q=latch_q,
        base=base,
        home=None if data.home is None else read_array(data.home, (n,), path, "home"),
    )


def _times(
    times: list[float] | None, count: int, path: Path, key: str
) -> Float[np.ndarray, " m"] | None:
    if times is None:
        return None
    values = read_array(times, (), path, key)
    if len(values) != count or (np.diff(values) < 0).any():
        raise FileFormatError(f"{path}: {key} must be {count} non-decreasing times [s]")
    return values


def read_array(
    rows: Sequence[Any], shape: tuple[int, ...], path: Path, key: str, each: str = "one per joint"
) -> Float[np.ndarray, "..."]:
    """Return rows of numbers as an array.

    Args:
        rows: The rows.
        shape: Shape of each row; () for numbers.
        path: The plan file, for messages.
        key: Name of the member, for messages.
        each: What the numbers of a row stand for.

    Raises:
        FileFormatError: The rows have another shape.
    """
    if not rows:
        return np.empty((0, *shape))
    size = " x ".join(map(str, shape))
    try:
        array = np.array(rows, float)
    except ValueError as error:
        raise FileFormatError(f"{path}: {key} has rows of different length; need {size}") from error
    if array.shape[1:] != shape:
        found = " x ".join(map(str, array.shape[1:]))
        raise FileFormatError(
            f"{path}: {key} has rows of {found} numbers; need {size}"
            + (f", {each}" if len(shape) == 1 else "")
        )
    return array


def candidates_to_dict(candidates: Candidates) -> dict[str, Any]:
    """Return the member of a plan file; the nearest miss only if there is one."""
    found: dict[str, Any] = {
        "sampled": candidates.sampled,
        "checked": candidates.checked,
        "rejections": dict(candidates.rejections),
    }
    if candidates.nearest is not None:
        pose = dict(zip(("x", "y", "yaw"), candidates.nearest.base_pose, strict=True))
        found["nearest"] = {"base_pose": pose, "reason": candidates.nearest.reason}
    return found


def read_candidates(data: members.PlanCandidates) -> Candidates:
    """Return the record of the member of a plan file."""
    miss = data.nearest
    nearest = None
    if miss is not None:
        pose = miss.base_pose
        nearest = NearestMiss((pose.x, pose.y, pose.yaw), miss.reason)
    return Candidates(data.sampled, data.checked, data.rejections, nearest)


MAX_HASHED_BYTES = 50_000_000
MAX_PARENTS = 3
"""Files in up to this many folders above the plan get relative names [-]."""


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    return sha256_of(read_bytes_bounded(path, MAX_HASHED_BYTES, error=InputError))


def sha256_of(data: bytes) -> str:
    """Return the SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def portable_name(name: str, plan: Path, what: str) -> str:
    """Return a plan's name for a file: relative if the file is near, otherwise absolute.

    Raises:
        InputError: The file does not exist, so the plan could not be verified.
    """
    target, folder = Path(os.path.abspath(name)), resolved(plan).parent
    if not target.is_file():
        raise InputError(
            f"{plan}: {what} {name!r} does not exist; load it from a file, so that the plan can be "
            "verified"
        )
    near = [folder, *list(folder.parents)[:MAX_PARENTS]]
    shared = [parent for parent in near if parent.parent != parent]
    if any(target.is_relative_to(parent) for parent in shared):
        relative = Path(os.path.relpath(target, folder))
        if (folder / relative).exists() and (folder / relative).samefile(target):
            return relative.as_posix()
    return str(target)


FORMAT, TOUR = "momapos-plan", "momapos-tour"
VERSION, MOVING_VERSION = 1, 2
"""Version of a plan at one base pose, and of a plan whose base moves."""
MAX_BYTES = 20_000_000
"""Largest plan file; 20,000 states, the limit of the exact check, take about 10 MB [bytes]."""


def plan_to_dict(plan: PlacementPlan) -> dict[str, Any]:
    """Convert a plan to the dictionary of its file; paths stay as they are."""
    return {
        "format": FORMAT,
        "version": MOVING_VERSION if plan.moves_base else VERSION,
        "scene": plan.scene,
        "scene_joints": {name: dict(joints) for name, joints in plan.scene_joints.items()},
        "scene_hypotheses": {name: dict(taken) for name, taken in plan.scene_hypotheses.items()},
        "robot": {
            "name": plan.robot_name,
            "urdf": plan.robot_urdf,
            "base_link": plan.base_link,
            "tool_link": plan.tool_link,
            "file": plan.robot_file,
            "srdf": plan.robot_srdf,
            "rest": dict(plan.robot_rest),
            "arm": plan.robot_arm,
            "drive": plan.robot_drive,
            **(
                {}
                if plan.robot_min_turning_radius is None
                else {"min_turning_radius": plan.robot_min_turning_radius}
            ),
        },
        "task": _task_to_dict(plan.task),
        "resistance": {
            name: {joint: one.members() for joint, one in known.items()}
            for name, known in plan.resistance.items()
        },
        **({"overrides": _overrides_to_dict(plan.overrides)} if plan.overrides.any else {}),
        "status": plan.status,
        **({} if plan.assumption is None else {"assumption": asdict(plan.assumption)}),
        "loads": None if plan.loads is None else asdict(plan.loads),
        "feasible_to": plan.feasible_to,
        "feasible_from": _pose_to_dict(plan.feasible_from),
        "feasible_sure": plan.feasible_sure,
        **({"advice": plan.advice} if plan.advice else {}),
        "start": _pose_to_dict(plan.start),
        "base_pose": _pose_to_dict(plan.base_pose),
        "base_path": None if plan.base_path is None else plan.base_path.tolist(),
        "joints": list(plan.joints),
        **motion_to_dict(plan.motion),
        "navigation_cost": plan.navigation_cost,
        "cost": {name: asdict(term) for name, term in plan.cost.items()},
        "candidates": candidates_to_dict(plan.candidates),
        "importance": None
        if plan.key_objects is None
        else {**asdict(plan.key_objects), "names": list(plan.key_objects.names)},
        "timing": dict(plan.timing),
        "region": {
            **asdict(plan.region),
            "keep_in": _outlines(plan.region.keep_in),
            "keep_out": _outlines(plan.region.keep_out),
        },
        "tolerance": None if plan.tolerance is None else asdict(plan.tolerance),
        "notes": list(plan.notes),
        "method": plan.method,
        "seed": plan.seed,
        "versions": dict(plan.versions),
    }


def _overrides_to_dict(overrides: Overrides) -> dict[str, Any]:
    known = {
        name: {joint: one.members() for joint, one in joints.items()}
        for name, joints in overrides.resistance.items()
    }
    return {"resistance": known, "mass": dict(overrides.mass), "assumed": dict(overrides.assumed)}


def _outlines(areas: tuple[Outline, ...]) -> list[list[list[float]]]:
    return [[list(corner) for corner in area] for area in areas]


def _task_to_dict(task: Task) -> dict[str, Any]:
    members = asdict(task)
    members["object"] = task.object or None
    for name in ("follower", "poses", "level", "speed"):
        if not members[name]:
            del members[name]
    return members


def _pose_to_dict(pose: tuple[float, float, float] | None) -> dict[str, float] | None:
    return None if pose is None else dict(zip(("x", "y", "yaw"), pose, strict=True))


def write_plan(plan: PlacementPlan, path: str | Path) -> None:
    """Write a plan atomically.

    Names of nearby files are relative to the plan's folder, so that the folders can be moved
    together; others are absolute. If the robot file adds to the URDF (such as a base that carries
    the arm), the extended URDF is written next to the plan as NAME.robot.urdf.

    Raises:
        InputError: The plan contains NaN or names a missing file, or the file cannot be written.
    """
    expect("plan", plan, PlacementPlan)
    path = as_path("path", path)
    data = plan_to_dict(plan)
    path.parent.mkdir(parents=True, exist_ok=True)
    data["scene"] = portable_name(plan.scene, path, "the scene")
    amended = None
    if plan.robot_amended is None:
        data["robot"]["urdf"] = portable_name(plan.robot_urdf, path, "the robot's URDF")
        digest = sha256(Path(plan.robot_urdf))
    else:
        amended = path.with_name(f"{path.stem}.robot.urdf")
        content = portable(plan.robot_amended, path.parent, str(path))
        data["robot"]["urdf"], digest = amended.name, sha256_of(content.encode())
    if plan.robot_file is not None and plan.robot_file.endswith(".toml"):
        data["robot"]["file"] = portable_name(plan.robot_file, path, "the robot file")
    if plan.robot_srdf is not None:
        srdf = portable_name(plan.robot_srdf, path, "the robot's SRDF")
        data["robot"]["srdf"] = srdf if amended is None else amended.with_suffix(".srdf").name
    data["hashes"] = {"scene": sha256(Path(plan.scene)), "robot": digest}
    try:
        text = json.dumps(data, allow_nan=False)
    except ValueError as error:
        raise InputError(f"{path}: not written; the plan contains NaN or infinity") from error
    if amended is not None:
        write_file(amended, content)
        if plan.robot_srdf is not None:  # readers without the robot file look for it there
            srdf = read_text_bounded(Path(plan.robot_srdf), MAX_SRDF_BYTES, error=InputError)
            write_file(amended.with_suffix(".srdf"), srdf)
    write_file(path, f"{text}\n")


def format_of(path: Path) -> Any:
    """Return a file's "format", or None; nothing else is checked."""
    content = read_bytes_bounded(path, MAX_BYTES).removeprefix(b"\xef\xbb\xbf")
    try:
        return msgspec.json.decode(content, type=members.PlanHead).format
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


def read_plan(path: str | Path) -> PlacementPlan:
    """Read a plan file.

    Paths that exist relative to its folder become absolute, others stay as they are.

    Raises:
        FileFormatError: The file is not a usable plan.
    """
    path = as_path("path", path)
    content = _content(path)
    head = _decode(content, members.PlanHead, path)
    if head.format == TOUR:
        raise FileFormatError(
            f"{path}: a tour of several plans; give one of its plans, or use verify, run, view or "
            "export"
        )
    if head.format != FORMAT:
        raise FileFormatError(
            f'{path}: not a plan; "format" must be {FORMAT!r}, not {head.format!r:.60}'
        )
    if head.version not in (VERSION, MOVING_VERSION) or isinstance(head.version, bool):
        raise FileFormatError(
            f"{path}: version {head.version!r:.60} of the plan format is not supported; this "
            f"momapos reads versions {VERSION} and {MOVING_VERSION}"
        )
    data = _decode(content, members.Plan, path)
    _check(data, path, head.version)
    return _record(data, path)


def check_unchanged(path: Path, scene: Path, urdf: Path) -> None:
    """Check that scene and URDF have not changed since a plan was written, by their SHA-256.

    Old plans without hashes pass. Files that scene and URDF name in turn are not checked.

    Args:
        path: The plan file.
        scene: Path of the plan's scene.
        urdf: Path of the plan's URDF.

    Raises:
        InputError: One of them has changed.
    """
    for what, file in changed_files(path, scene, urdf).items():
        raise InputError(
            f"{path}: the {what} ({file}) has changed since the plan was written; plan again"
        )


def changed_files(path: Path, scene: Path, urdf: Path) -> dict[str, Path]:
    """Return which of scene and robot have changed since a plan was written, with their files.

    Args:
        path, scene, urdf: See `check_unchanged`.
    """
    hashes = _decode(_content(path), members.Hashes, path).hashes
    return {
        what: file
        for what, file in (("scene", scene), ("robot", urdf))
        if what in hashes and hashes[what] != sha256(file)
    }


def _content(path: Path) -> bytes:
    content = read_bytes_bounded(path, MAX_BYTES).removeprefix(b"\xef\xbb\xbf")
    if not content.strip():
        raise FileFormatError(f"{path}: is empty; a plan is a JSON object")
    return content


def _decode(content: bytes, kind: type[Any], path: Path) -> Any:
    try:
        return msgspec.json.decode(content, type=kind)
    except (msgspec.ValidationError, InputError) as error:
        raise FileFormatError(f"{path}: not a usable plan: {error}") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise FileFormatError(
            f"{path}: invalid JSON ({error}); a plan is a JSON object without NaN"
        ) from error


def _check(data: members.Plan, path: Path, version: int) -> None:
    """Check what the types do not express."""

    def need(met: bool, message: str) -> None:
        if not met:
            raise FileFormatError(f"{path}: {message}")

    names = {
        "scene": data.scene, "robot.urdf": data.robot.urdf, "robot.base_link": data.robot.base_link,
        "robot.tool_link": data.robot.tool_link, "task.object": data.task.object or "-",
        "robot.file": data.robot.file or "-", "robot.srdf": data.robot.srdf or "-",
    }  # fmt: skip
    for key, name in names.items():
        need(0 < len(name) <= 4000 and "\0" not in name, f"{key} must be a name")
    need(
        data.robot.drive != "car" or data.robot.min_turning_radius is not None,
        "robot.min_turning_radius is missing; a robot with the drive 'car' needs it [m]",
    )
    moves_base = data.manipulation is not None and data.manipulation.base is not None
    need(
        version == MOVING_VERSION or not moves_base,
        f"manipulation.base needs version {MOVING_VERSION}, not {version}",
    )
    need(
        not moves_base or data.robot.drive is not None,
        "robot.drive is missing; a plan whose base moves needs it",
    )
    need(len(set(data.joints)) == len(data.joints), "joints contains a joint twice")
    need(
        (data.task.verb in get_args(PoseVerb)) == bool(data.task.poses) == (not data.task.object),
        "task.poses must be the tool poses of reach or follow, whose task.object is null",
    )
    need(data.task.to is None or math.isfinite(data.task.to), "task.to must be finite")
    moves = data.task.verb in get_args(JointVerb)
    need(
        moves or data.task.joint is None,
        f"task.joint must be null to {data.task.verb}, which moves a whole object",
    )
    need(
        (data.task.joint is not None or not moves)
        and (data.task.to is not None or data.task.joint is None),
        "task.joint must name the moving joint, and task.to its target value",
    )
    if data.status in ("solved", "assumed"):
        what = f"{'a solved' if data.status == 'solved' else 'an assumed'} plan needs"
        need(bool(data.joints), f"joints is empty; {what} the arm's joints")
        need(data.base_pose is not None, f"base_pose is missing; {what} one")
        need(data.manipulation is not None, f"manipulation is missing; {what} one")


def _record(data: members.Plan, path: Path) -> PlacementPlan:
    robot = data.robot
    folder = resolved(path).parent
    return PlacementPlan(
        scene=_located(data.scene, folder),
        robot_name=robot.name,
        robot_urdf=_located(robot.urdf, folder),
        base_link=robot.base_link,
        tool_link=robot.tool_link,
        task=Task(**msgspec.structs.asdict(data.task) | {"object": data.task.object or ""}),
        status=_status(data),
        joints=tuple(data.joints),
        base_pose=_triple(data.base_pose),
        motion=read_motion(data, path),
        navigation_cost=data.navigation_cost,
        cost={name: CostTerm(**msgspec.structs.asdict(term)) for name, term in data.cost.items()},
        candidates=read_candidates(data.candidates),
        key_objects=_key_objects(data.importance),
        timing=data.timing,
        method=data.method,
        seed=data.seed,
        versions=data.versions,
        start=_triple(data.start),
        base_path=None
        if data.base_path is None
        else read_array(data.base_path, (3,), path, "base_path", "x, y, yaw"),
        robot_file=_robot_file(robot.file, folder),
        robot_srdf=None if robot.srdf is None else _located(robot.srdf, folder),
        robot_rest=robot.rest,
        robot_arm=robot.arm,
        robot_drive=robot.drive,
        robot_min_turning_radius=robot.min_turning_radius,
        scene_joints=data.scene_joints,
        scene_hypotheses=data.scene_hypotheses,
        assumption=None
        if data.assumption is None
        else Assumption(**msgspec.structs.asdict(data.assumption)),
        resistance=data.resistance,
        overrides=data.overrides,
        loads=data.loads,
        feasible_to=data.feasible_to,
        feasible_from=_triple(data.feasible_from),
        feasible_sure=data.feasible_sure,
        advice=data.advice,
        tolerance=None
        if data.tolerance is None
        else Tolerance(**msgspec.structs.asdict(data.tolerance)),
        region=BaseRegion(**msgspec.structs.asdict(data.region)),
        notes=data.notes,
    )


def _status(data: members.Plan) -> Status:
    """Return the status; earlier versions wrote `solved` also for a less probable joint."""
    less_probable = any(i for taken in data.scene_hypotheses.values() for i in taken.values())
    return "assumed" if data.status == "solved" and less_probable else data.status


def _triple(pose: members.PlanPose | None) -> tuple[float, float, float] | None:
    return None if pose is None else (pose.x, pose.y, pose.yaw)


def _robot_file(name: str | None, folder: Path) -> str | None:
    """Return the path of a robot file, or the name of a library robot."""
    return name if name is None or not name.endswith(".toml") else _located(name, folder)


def _key_objects(data: members.PlanImportance | None) -> KeyObjects | None:
    if data is None:
        return None
    return KeyObjects(data.scorer, data.alpha, tuple(data.names), data.scores, data.rounds)


def _located(name: str, folder: Path) -> str:
    return os.path.normpath(folder / name) if _is_file(folder / name) else name


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # not a valid file name
        return False
