"""Load reachability maps: shipped with the robot, from the cache, or built at first use."""

from __future__ import annotations

import fcntl
import json
import logging
import math
import os
import struct
import time
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import (
    Cache,
    FileFormatError,
    MomaposError,
    as_path,
    content_key,
    default_cache_dir,
    expect,
    read_bytes_bounded,
)
from momapos.core.geometry import invert, pose_planar
from momapos.model.collision import FREE, check_states
from momapos.model.kinematics import IkModel, bounded, chain_arrays, solve_ik
from momapos.model.robots import MAX_REACH, Robot

from .arm_axes import arm_frame, is_flooded, no_map
from .construct import build_map, default_config
from .flood import FLOOD_VERSION
from .grid import DEPTH, OUTSIDE, STEPS
from .reach_map import MAX_VALUES, Progress, ReachConfig, ReachMap, silent

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int8


BEST_EXTENSION = 0.6
"""Share of the arm's length with the highest score [-]."""
_BLOCK = 2_000_000
"""Tool poses that are scored together [-]."""


@dataclass(frozen=True, eq=False)
class ArmLength:
    """Scores base poses by distance alone: it rules out only base poses that are too far.

    Inverse kinematics decides about the others.
    """

    shoulder: Float[np.ndarray, "3"]
    """Mean position of the first turning axis, in the base frame [m]."""
    travel: Float[np.ndarray, "3"]
    """Travel of that axis to both sides along x, y and z [m]."""
    length: float
    """Upper bound of the tool's distance from that axis [m]."""
    note: str
    """Why there is no map, in one line."""

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Return the worst score along each grasp's waypoints, for each base pose."""
        bases, points = np.asarray(bases, float), Ts_world_tool[..., :3, 3]
        out = np.empty((len(bases), len(points)), np.float32)
        block = max(1, _BLOCK // max(1, points[..., 0].size))
        for lo in range(0, len(bases), block):
            T = invert(pose_planar(bases[lo : lo + block]))
            local = np.einsum("nij,gwj->ngwi", T[:, :3, :3], points) + T[:, None, None, :3, 3]
            off = np.maximum(np.abs(local - self.shoulder) - self.travel, 0.0)
            share = np.linalg.norm(off, axis=-1) / self.length
            score = np.where(share <= 1.0, 1.0 - 0.9 * np.abs(share - BEST_EXTENSION), 0.0)
            out[lo : lo + block] = score.min(-1)
        return out


def by_arm_length(robot: Robot, why: str) -> ArmLength:
    """Build the scorer of a robot by its arm's length, with the reason why it has no map."""
    chain, first = robot.chain, robot.chain.first_turn
    slides = chain.half_travel[:first, None] * np.abs(chain.h[:first])
    shoulder = chain.d[: first + 1].sum(0) + chain.middle[:first] @ chain.h[:first]
    note = f"{robot.name} has no reachability map: {why}; planning is slower without one"
    return ArmLength(shoulder, slides.sum(0), robot.reach, note)


NEAR_OFFSET, NEAR_TURN = 0.17, 0.3
"""Largest offset of poses near the reach from reached ones, along each axis [m], [rad]."""


def reachable(
    robot: Robot, Ts_base_tool: Float[np.ndarray, "m 4 4"], ik: IkModel | None = None
) -> Bool[np.ndarray, " m"]:
    """Check which tool poses have an IK solution without collision with the robot or the floor."""
    ik = ik or robot.ik
    out = np.zeros(len(Ts_base_tool), bool)
    boxes = (np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0, bool))
    block = max(1, 40_000 // ik.max_solutions)
    for lo in range(0, len(out), block):
        q, count = solve_ik(robot.chain, ik, Ts_base_tool[lo : lo + block])
        valid = np.arange(q.shape[1]) < count[:, None]
        codes = check_states(
            np.ascontiguousarray(q[valid]),
            np.zeros(3),
            chain_arrays(robot.chain),
            robot.spheres.arrays,
            boxes,
            False,
            0.0,
        )
        free = np.zeros(valid.shape, bool)
        free[valid] = codes == FREE
        out[lo : lo + block] = free.any(1)
    return out


def random_poses(
    robot: Robot, rng: np.random.Generator, count: int
) -> Float[np.ndarray, "count 4 4"]:
    """Draw tool poses of any direction uniformly from the ball around the shoulder."""
    from scipy.spatial.transform import Rotation

    chain = robot.chain
    lower, upper = bounded(chain)
    q = rng.uniform(lower, upper, (100_000, chain.size))
    first = chain.first_turn
    shoulder = chain.d[: first + 1].sum(0) + chain.middle[:first] @ chain.h[:first]
    radius = np.linalg.norm(chain.tool_poses(q)[:, :3, 3] - shoulder, axis=1).max()
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    Ts = np.zeros((count, 4, 4))
    Ts[:, :3, 3] = shoulder + direction * radius * np.cbrt(rng.random((count, 1)))
    Ts[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    Ts[:, 3, 3] = 1.0
    return Ts


def poses_near_reach(
    robot: Robot, rng: np.random.Generator, count: int
) -> Float[np.ndarray, "count 4 4"]:
    """Draw tool poses near reached ones: up to 30 cm and half a radian off.

    About half of them are reachable, so errors at the boundary of a map show.
    """
    from scipy.spatial.transform import Rotation

    lower, upper = bounded(robot.chain)
    Ts = robot.chain.tool_poses(rng.uniform(lower, upper, (count, robot.chain.size)))
    Ts[:, :3, 3] += rng.uniform(-NEAR_OFFSET, NEAR_OFFSET, (count, 3))
    turn = Rotation.from_rotvec(rng.uniform(-NEAR_TURN, NEAR_TURN, (count, 3)))
    Ts[:, :3, :3] = turn.as_matrix() @ Ts[:, :3, :3]
    return Ts


log = logging.getLogger(__name__)
CALIBRATION_POSES = 6000
"""Number of tool poses near the reach that calibrate a map [-]."""
MAX_MISSED, MAX_FALSE_POSITIVES = 0.006, 0.02
"""Largest share of the reachable poses that the map may miss, and largest increase of the poses
that it accepts by unreachable ones [-]. About 4000 of the poses are reachable, so the standard
error of 0.6 % is 0.12 %: three of these remain to 1 %."""
THRESHOLD_MARGIN = 0.01
"""The threshold is set this far below the value of the last line that it accepts [1/8 cell]."""


def calibrated(reach_map: ReachMap, robot: Robot) -> ReachMap:
    """Lower a map's threshold until it misses at most `MAX_MISSED` of the reachable poses.

    Poses near the reach that the map rejects are checked by IK, with redundant joints locked at 33
    values. The threshold is lowered past the reachable ones, by at most a cell and as far as
    `MAX_FALSE_POSITIVES` allows. A map that misses few poses already is returned unchanged.
    """
    Ts = poses_near_reach(robot, np.random.default_rng(1), CALIBRATION_POSES)
    values = _values(reach_map, Ts)
    rejected = np.flatnonzero(values <= reach_map.threshold)
    rejected = rejected[np.argsort(-values[rejected], kind="stable")]
    true = reachable(robot, Ts[rejected], robot.finer.ik)
    accepted = CALIBRATION_POSES - len(rejected)
    missed = int(true.sum()) - np.cumsum(true)
    near = values[rejected] > max(reach_map.threshold - STEPS, OUTSIDE)
    allowed = near & (np.cumsum(~true) <= MAX_FALSE_POSITIVES * accepted)
    if true.sum() <= MAX_MISSED * (accepted + true.sum()) or not allowed.any():
        return reach_map
    enough = np.flatnonzero(allowed & (missed <= MAX_MISSED * (accepted + true.sum())))
    last = enough[0] if len(enough) else np.flatnonzero(allowed)[-1]
    if not len(enough):
        share = missed[last] / (accepted + true.sum())
        log.warning("the reachability map of %s misses %.1f %%", robot.title, 100 * share)
    return replace(reach_map, threshold=float(values[rejected[last]] - THRESHOLD_MARGIN))


def _values(reach_map: ReachMap, Ts: Float[np.ndarray, "m 4 4"]) -> Float[np.ndarray, " m"]:
    """Look up the stored values of tool poses, up to four cells inside [1/8 cell]."""
    lowest = OUTSIDE - 1.0
    return replace(reach_map, threshold=lowest).score(Ts) * DEPTH + lowest


VERSION = 3
"""Map version, part of the key; raising it invalidates all shipped and cached maps."""
_BUILD = 3
"""Version of construction and calibration, part of the cache entry's name; raising it rebuilds
cached maps. Shipped maps are identified by their key alone."""
_TURNS_LAST = 4
"""Version of files whose last axis is the tool turn; in files of `VERSION` it is the first."""
_MAGIC = b"momapos-reach\n"
MAX_BYTES = 50_000_000
"""Largest map file that is read [bytes]; maps have about 1 MB."""
_MAX_HEADER = 10_000
_MAX_AZIMUTHS = 64
BUILD_TIME_LIMIT = 140.0
"""Processor time for building a map while a plan waits for it [s]."""
_CHUNK, _MAX_INFLATED_CHUNK = 1 << 14, 1 << 18
"""Compressed bytes per step of decompression, and the most bytes that one step returns."""
_FIELDS = (
    "low", "cell", "axis_xy", "line_tool", "threshold", "key", "build_seconds", "across_tool",
)  # fmt: skip
_MAX_TURNS = 64
_NDIM_WITH_TURNS = 6
"""Number of axes of the values if the map stores several tool turns, along the first axis."""


def map_key(robot: Robot, config: ReachConfig) -> str:
    """Return the content key of a robot's map: a hash of all numbers that it is built from.

    URDF, SRDF, meshes, arm joints and tool enter as the resulting chain and collision shapes. So an
    edited comment in a file keeps the key, and an edited mesh changes it. A hand that is not fully
    open has the map of the open hand.
    """
    robot = robot.fully_open or robot
    chain = robot.chain
    spheres = robot.spheres.arrays
    # The bounds of the base follow from its boxes. Hulls enter only if some pair uses them, without
    # their adjacency, which follows from the vertices, and without their clearances.
    shapes: list[np.ndarray] = list(spheres[:12])
    if spheres.exact.any() or spheres.base_exact.any():
        shapes += [*spheres.hulls[:6], spheres.exact, spheres.base_exact]
    coupling = (chain.dof, chain.ratio) if chain.coupled else ()
    arrays = (
        chain.h, chain.d, chain.slides, *coupling, chain.lower, chain.upper, chain.tool_offset,
        chain.tool_rotation, robot.approach_axis, *shapes,
    )  # fmt: skip
    # Rounded to a micrometer: the last digits differ between machines.
    rounded = (np.round(a, 6) + 0.0 if a.dtype.kind == "f" else a for a in arrays)
    settings = asdict(config)
    if is_flooded(robot, arm_frame(chain, robot.approach_axis)):
        settings["way"] = FLOOD_VERSION
    else:
        del settings["states"]
    return content_key("reach", VERSION, sorted(settings.items()), *rounded)


def encode(reach_map: ReachMap) -> bytes:
    """Encode a map: magic, length of the header, header (JSON), values (int8, zlib).

    The tool turn is stored as the last axis: its values are similar, which compresses to a third
    less.
    """
    header = {name: getattr(reach_map, name) for name in _FIELDS}
    header = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in header.items()}
    stored = reach_map.values if reach_map.turned is None else reach_map.turned
    header = {k: v for k, v in header.items() if v is not None}
    header |= {"version": VERSION, "shape": stored.shape}
    if stored.ndim == _NDIM_WITH_TURNS:
        header["version"] = _TURNS_LAST
        stored = stored.reshape(len(stored), -1).T
    text = json.dumps(header).encode()
    values = zlib.compress(stored.tobytes(), 6)
    return _MAGIC + struct.pack("<I", len(text)) + text + values


def decode(data: bytes) -> ReachMap:
    """Decode a map that `encode` wrote.

    Shape and frame are checked here, because the lookup kernels trust them.

    Raises:
        FileFormatError: The data is no map.
    """
    try:
        if not data.startswith(_MAGIC):
            raise ValueError("the magic is missing")
        (length,) = struct.unpack_from("<I", data, len(_MAGIC))
        begin = len(_MAGIC) + 4
        if length > _MAX_HEADER:
            raise ValueError(f"the header has {length} bytes; at most {_MAX_HEADER}")
        header = json.loads(data[begin : begin + length])
        if not isinstance(header, dict) or header.get("version") not in (VERSION, _TURNS_LAST):
            raise ValueError(f"the version must be {VERSION} or {_TURNS_LAST}")
        shape = _shape(header)
        values = _inflated(memoryview(data)[begin + length :], math.prod(shape))
        if header["version"] == _TURNS_LAST and len(shape) == _NDIM_WITH_TURNS:
            values = np.ascontiguousarray(values.reshape(-1, shape[0]).T)
        return _map(header, values.reshape(shape))
    except (ValueError, RecursionError, struct.error, zlib.error) as error:
        raise FileFormatError(f"not a usable reachability map ({error})") from error


def _inflated(packed: memoryview, size: int) -> Int8[np.ndarray, " size"]:
    """Decompress the values in chunks that fit the processor's cache."""
    wrong_size = ValueError(f"the number of values is not {size}, as the header's shape requires")
    out, inflate, done = np.empty(size, np.int8), zlib.decompressobj(), 0
    for begin in range(0, len(packed), _CHUNK):
        rest: bytes | memoryview = packed[begin : begin + _CHUNK]
        while rest and not inflate.eof:
            chunk = np.frombuffer(inflate.decompress(rest, _MAX_INFLATED_CHUNK), np.int8)
            if done + len(chunk) > size:
                raise wrong_size
            out[done : done + len(chunk)] = chunk
            done, rest = done + len(chunk), inflate.unconsumed_tail
    if done != size or not inflate.eof:
        raise wrong_size
    return out


def _shape(header: Mapping[str, Any]) -> tuple[int, ...]:
    shape = header.get("shape")
    if (
        not isinstance(shape, list)
        or len(shape) not in (5, _NDIM_WITH_TURNS)
        or not all(type(n) is int and 1 <= n <= MAX_VALUES for n in shape)
        or min(shape[-5:-1]) < 2
        or shape[-1] > _MAX_AZIMUTHS
        or (len(shape) == _NDIM_WITH_TURNS and not 2 <= shape[0] <= _MAX_TURNS)
        or math.prod(shape) > MAX_VALUES
    ):
        raise ValueError(f"the shape {shape!r:.80} is impossible")
    return tuple(shape)


def _map(header: Mapping[str, Any], values: np.ndarray) -> ReachMap:
    def numbers(name: str, shape: tuple[int, ...], limit: float) -> np.ndarray:
        try:
            array = np.array(header.get(name), float)
        except (TypeError, ValueError, OverflowError):
            array = np.array(np.nan)
        if array.shape != shape or not (np.abs(array) <= limit).all():
            count = f"{math.prod(shape)} number{'s' if shape else ''}"
            raise ValueError(f"{name} must be {count} within +-{limit:g}")
        return array

    cell, line = float(numbers("cell", (), 1.0)), numbers("line_tool", (2, 3), MAX_REACH)
    if cell < 1e-3:
        raise ValueError(f"cell must be at least 0.001 m, not {cell:g} m")
    key = header.get("key")
    if not isinstance(key, str):
        raise ValueError("key must be a string")
    across = numbers("across_tool", (3,), 1.0 + 1e-6) if values.ndim == _NDIM_WITH_TURNS else None
    for name, direction in (("line_tool", line[0]), ("across_tool", across)):
        if direction is not None and abs(np.linalg.norm(direction) - 1.0) > 1e-6:
            raise ValueError(f"the direction in {name} must have length 1")
    return ReachMap(
        values if across is None else values.max(0),
        float(numbers("low", (), 2 * MAX_REACH)),
        cell,
        numbers("axis_xy", (2,), 2 * MAX_REACH),
        line,
        float(numbers("threshold", (), 1000.0)),
        key,
        float(numbers("build_seconds", (), 1e9)),
        values if across is not None else None,
        across,
    )


def shipped(robot: Robot, key: str) -> ReachMap | None:
    """Return the map next to the robot's file, None if there is none with this key.

    A robot with several arms has one file per arm: `NAME.ARM.reach`.
    """
    path = robot.path.with_suffix(f".{robot.arm}.reach" if robot.arm else ".reach")
    if not os.path.lexists(path):
        return None
    try:
        found = decode(read_bytes_bounded(path, MAX_BYTES))
    except FileFormatError as error:
        log.warning("%s: %s; the file is ignored", path, error)
        return None
    return found if found.key == key else None


class MapBuildTimeoutError(MomaposError):
    """Building a map has used up its processor time."""


def load_reach(
    robot: Robot,
    cache_dir: Path | None = None,
    progress: Progress | None = None,
    *,
    limit: float = BUILD_TIME_LIMIT,
) -> ReachMap | ArmLength:
    """Load the map of a robot, see `load_reach_map`; fall back to the arm's length without one.

    Args:
        robot: The robot.
        cache_dir: Folder of the cache; the user's by default.
        progress: Called with the completed share, in [0, 1], while the map is built.
        limit: Processor time for building the map [s]; afterwards the arm's length is used.
    """
    why = no_map(robot)
    if not why:
        try:
            return load_reach_map(robot, cache_dir, progress, limit=limit)
        except MapBuildTimeoutError as error:
            why = str(error)
    fallback = by_arm_length(robot, why)
    log.warning("%s", fallback.note)
    return fallback


def has_reach(robot: Robot, cache_dir: Path | None = None) -> bool:
    """Check that `load_reach` builds nothing: there is a map, or there cannot be one."""
    if no_map(robot):
        return True
    robot = robot.fully_open or robot
    key, cache = map_key(robot, default_config(robot)), Cache(cache_dir)
    if shipped(robot, key) is not None or cache.path(_entry(key)).exists():
        return True
    return _failed_limit(cache.get(f"{_entry(key)}{_LATE}")) >= BUILD_TIME_LIMIT


_LATE = "-takes-long"


def _entry(key: str) -> str:
    """Return the cache entry of a map."""
    return f"reach-{_BUILD}-{key}"


@contextmanager
def _alone(cache: Cache, entry: str) -> Iterator[None]:
    """Let one process at a time build a map; the others wait for it."""
    path = cache.path(f"{entry}-lock")
    with ExitStack() as stack:
        with suppress(OSError):  # the cache cannot be written: each builds its own
            path.parent.mkdir(parents=True, exist_ok=True)
            fcntl.flock(stack.enter_context(path.open("w")), fcntl.LOCK_EX)
            stack.callback(path.unlink, missing_ok=True)
        yield


def load_reach_map(
    robot: Robot,
    cache_dir: str | Path | None = None,
    progress: Progress | None = None,
    *,
    config: ReachConfig | None = None,
    limit: float = math.inf,
) -> ReachMap:
    """Load the map of a robot: the shipped one, the cached one, or build and cache it.

    Args:
        robot: The robot.
        cache_dir: Folder of the cache; the user's by default.
        progress: Called with the completed share, in [0, 1], while the map is built.
        config: Resolution; None builds the map that `build_true_map` builds.
        limit: Processor time for building the map [s].

    Raises:
        MapBuildTimeoutError: Building takes longer than `limit`, or did so before.
    """
    expect("robot", robot, Robot, "load_robot reads one")
    robot = robot.fully_open or robot
    if config is not None:
        expect("config", config, ReachConfig)
    folder = default_cache_dir() if cache_dir is None else as_path("cache_dir", cache_dir)
    key = map_key(robot, config or default_config(robot))
    ready = shipped(robot, key)
    if ready is not None:
        return ready
    cache = Cache(folder)
    found = _cached(cache, _entry(key))
    if found is not None:
        return found
    with _alone(cache, _entry(key)):
        return _cached(cache, _entry(key)) or _built(robot, config, key, cache, progress, limit)


def _cached(cache: Cache, entry: str) -> ReachMap | None:
    """Return the map in the cache; None if there is none, or none that can be read."""
    data = cache.get(entry)
    if data is None:
        return None
    try:
        return decode(data)
    except FileFormatError as error:
        log.warning("%s: %s; rebuilding the map", cache.path(entry), error)
        return None


def _built(
    robot: Robot, config: ReachConfig | None, key: str, cache: Cache, progress: Progress | None,
    limit: float,
) -> ReachMap:  # fmt: skip
    """Build a map and cache it; see `load_reach_map`."""
    entry, late = _entry(key), f"{_entry(key)}{_LATE}"
    try:
        if _failed_limit(cache.get(late)) >= limit:
            raise _timeout(robot, limit)
        limited = _with_limit(limit, progress or silent, robot)
        if config is None:
            built = build_true_map(robot, progress=limited, key=key)
        else:
            built = build_map(robot, config, progress=limited, key=key)
    except MapBuildTimeoutError:
        _put(cache, late, b"%g" % limit, robot)
        raise
    _put(cache, entry, encode(built), robot)
    return built


def build_true_map(robot: Robot, *, progress: Progress | None = None, key: str = "") -> ReachMap:
    """Build the map of a robot at its default resolution, and calibrate its threshold."""
    built = build_map(robot, default_config(robot), progress=progress, key=key)
    return calibrated(built, robot)


def _with_limit(limit: float, progress: Progress, robot: Robot) -> Progress:
    """Return a progress callback that raises once the processor time exceeds `limit` [s]."""
    began = time.process_time()

    def report(share: float) -> None:
        if share < 1.0 and time.process_time() - began > limit:
            raise _timeout(robot, limit)
        progress(share)

    return report


def _timeout(robot: Robot, limit: float) -> MapBuildTimeoutError:
    arm = f" --arm {robot.arm}" if robot.arm else ""
    return MapBuildTimeoutError(
        f"building it takes more than {limit:.0f} s of processor time; "
        f"'momapos reach build {robot.path}{arm}' builds it without a limit"
    )


def _failed_limit(cached: bytes | None) -> float:
    """Return the processor time within which building failed before [s], 0 if unknown."""
    try:
        return float(cached or b"0")
    except ValueError:
        return 0.0


def _put(cache: Cache, entry: str, data: bytes, robot: Robot) -> None:
    try:
        cache.put(entry, data)
    except OSError as error:
        log.warning("cannot cache the reachability map of %s: %s", robot.name, error)


_POSES = 100_000
"""Tool poses that are drawn together [-]; their IK takes seconds, all else less than 0.1 s."""


@dataclass(frozen=True)
class ReachEvaluation:
    """Agreement of a map with exact inverse kinematics on random tool poses."""

    count: int
    accuracy: float
    """Share of poses on which both agree [-]."""
    false_positives: float
    """Share of the poses that the map accepts that are unreachable [-]."""
    misses: float
    """Share of the reachable poses that the map rejects [-]."""
    reachable: float
    """Share of the poses that are reachable [-]."""
    bytes: int
    """Size of the map's file."""
    build_seconds: float


def evaluate(
    reach_map: ReachMap,
    robot: Robot,
    rng: np.random.Generator,
    count: int = 20_000,
    ik: IkModel | None = None,
    *,
    near: bool = False,
) -> ReachEvaluation:
    """Compare a map with exact inverse kinematics, self-collision and floor included.

    Args:
        reach_map: The map of the robot.
        robot: The robot.
        rng: Draws the poses.
        count: Number of poses [-].
        ik: The reference IK; None for the robot's own.
        near: Draw poses near the reach instead of from the whole ball around the shoulder.
    """
    draw = poses_near_reach if near else random_poses
    agreed, accepted, true = 0, 0, 0
    for first in range(0, count, _POSES):
        Ts = draw(robot, rng, min(_POSES, count - first))
        reached, scored = reachable(robot, Ts, ik), reach_map.score(Ts) > 0
        agreed += int((reached == scored).sum())
        accepted, true = accepted + int(scored.sum()), true + int(reached.sum())
    both = (accepted + true - (count - agreed)) / 2
    return ReachEvaluation(
        count,
        agreed / count,
        1 - both / max(accepted, 1),
        1 - both / max(true, 1),
        true / count,
        len(encode(reach_map)),
        reach_map.build_seconds,
    )
