"""Keep reachability maps: built at the first use, then read from the cache."""

from __future__ import annotations

import json
import logging
import math
import os
import struct
import time
import zlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import (
    Cache,
    FileFormatError,
    MomaposError,
    content_key,
    default_cache_dir,
    read_bytes_bounded,
)
from momapos.model.robots import MAX_REACH, Robot

from .arm_axes import arm_frame, is_flooded, no_map
from .arm_length import ArmLength, arm_length
from .calibrate import calibrated
from .construct import build_map, default_config
from .flood import WAY
from .reach_map import MAX_VALUES, ReachConfig, ReachMap
from .threads import Progress, silent

if TYPE_CHECKING:
    from jaxtyping import Int8

log = logging.getLogger(__name__)
VERSION = 3
"""Of maps: where it is raised, those that were built or stored before are not used."""
_BUILD = 3
"""Of how maps are put together and held against inverse kinematics: where it is raised, those that
the cache keeps of before are built anew. Maps beside robot files are known by their key alone."""
_TURNS_LAST = 4
"""Of a file in which turns of the tool lie side by side; in those of `VERSION` they come first."""
_MAGIC = b"momapos-reach\n"
MAX_BYTES = 50_000_000
"""Maps of arms have some 1 MB."""
_MAX_HEADER = 10_000
_MAX_BEARINGS = 64
LIMIT = 140.0
"""Processor time that building a map may take where an answer waits for it [s]."""
_PART, _MOST_OF_PART = 1 << 14, 1 << 18
"""Bytes of compressed values that are read at once, and what they become at most."""
_FIELDS = (
    "low", "cell", "axis_xy", "line_tool", "threshold", "key", "build_seconds", "across_tool",
)  # fmt: skip
_MAX_TURNS = 64
_TURNED = 6
"""Axes of the values of a map that tells turns of the tool apart, which is the first of them."""


def map_key(robot: Robot, config: ReachConfig) -> str:
    """Key of a robot's map: all that it is built from, as numbers.

    URDF, SRDF, meshes, arm joints and tool enter as the chain and the collision shapes they give,
    so that a comment in a file changes nothing and a mesh on the disk does.
    """
    chain = robot.chain
    spheres = robot.spheres.arrays
    # Bounds of the base, left out, follow from its boxes; hulls matter where they decide, all but
    # how near they may be. What lies beside what follows from the vertices.
    shapes: list[np.ndarray] = list(spheres[:12])
    if spheres.exact.any() or spheres.base_exact.any():
        shapes += [*spheres.hulls[:6], spheres.exact, spheres.base_exact]
    coupling = (chain.dof, chain.ratio) if chain.coupled else ()
    arrays = (
        chain.h, chain.d, chain.slides, *coupling, chain.lower, chain.upper, chain.tool_offset,
        chain.tool_rotation, robot.approach_axis, *shapes,
    )  # fmt: skip
    # A micrometer more or less is another machine's rounding, not another robot.
    rounded = (np.round(a, 6) + 0.0 if a.dtype.kind == "f" else a for a in arrays)
    settings = asdict(config)
    if is_flooded(robot, arm_frame(chain, robot.approach_axis)):
        settings["way"] = WAY
    else:
        del settings["states"]
    return content_key("reach", VERSION, sorted(settings.items()), *rounded)


def encode(reach_map: ReachMap) -> bytes:
    """A map as bytes: magic, length of the header, header (JSON), values (int8, zlib).

    Turns of the tool that are told apart are mostly alike: side by side they take a third less.
    """
    header = {name: getattr(reach_map, name) for name in _FIELDS}
    header = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in header.items()}
    stored = reach_map.values if reach_map.turned is None else reach_map.turned
    header = {k: v for k, v in header.items() if v is not None}
    header |= {"version": VERSION, "shape": stored.shape}
    if stored.ndim == _TURNED:
        header["version"] = _TURNS_LAST
        stored = stored.reshape(len(stored), -1).T
    text = json.dumps(header).encode()
    values = zlib.compress(stored.tobytes(), 6)
    return _MAGIC + struct.pack("<I", len(text)) + text + values


def decode(data: bytes) -> ReachMap:
    """Read what `encode` wrote.

    The kernels that look values up trust the shape and the frame, so these are checked here.

    Raises:
        FileFormatError: It is not that.
    """
    try:
        if not data.startswith(_MAGIC):
            raise ValueError("it does not begin as one")
        (length,) = struct.unpack_from("<I", data, len(_MAGIC))
        begin = len(_MAGIC) + 4
        if length > _MAX_HEADER:
            raise ValueError(f"its header has {length} bytes")
        header = json.loads(data[begin : begin + length])
        if not isinstance(header, dict) or header.get("version") not in (VERSION, _TURNS_LAST):
            raise ValueError(f"it is not of version {VERSION} or {_TURNS_LAST}")
        shape = _shape(header)
        values = _inflated(memoryview(data)[begin + length :], math.prod(shape))
        if header["version"] == _TURNS_LAST and len(shape) == _TURNED:
            values = np.ascontiguousarray(values.reshape(-1, shape[0]).T)
        return _map(header, values.reshape(shape))
    except (ValueError, RecursionError, struct.error, zlib.error) as error:
        raise FileFormatError(f"not a usable reachability map ({error})") from error


def _inflated(packed: memoryview, size: int) -> Int8[np.ndarray, " size"]:
    """Values from their compressed form, by parts that stay in the processor's cache."""
    wrong = ValueError("it does not hold as many values as its header says")
    out, inflate, done = np.empty(size, np.int8), zlib.decompressobj(), 0
    for begin in range(0, len(packed), _PART):
        rest: bytes | memoryview = packed[begin : begin + _PART]
        while rest and not inflate.eof:
            part = np.frombuffer(inflate.decompress(rest, _MOST_OF_PART), np.int8)
            if done + len(part) > size:
                raise wrong
            out[done : done + len(part)] = part
            done, rest = done + len(part), inflate.unconsumed_tail
    if done != size or not inflate.eof:
        raise wrong
    return out


def _shape(header: Mapping[str, Any]) -> tuple[int, ...]:
    shape = header.get("shape")
    if (
        not isinstance(shape, list)
        or len(shape) not in (5, _TURNED)
        or not all(type(n) is int and 1 <= n <= MAX_VALUES for n in shape)
        or min(shape[-5:-1]) < 2
        or shape[-1] > _MAX_BEARINGS
        or (len(shape) == _TURNED and not 2 <= shape[0] <= _MAX_TURNS)
        or math.prod(shape) > MAX_VALUES
    ):
        raise ValueError(f"it cannot have the shape {shape!r:.80}")
    return tuple(shape)


def _map(header: Mapping[str, Any], values: np.ndarray) -> ReachMap:
    def numbers(name: str, shape: tuple[int, ...], most: float) -> np.ndarray:
        try:
            array = np.array(header.get(name), float)
        except (TypeError, ValueError, OverflowError):
            array = np.array(np.nan)
        if array.shape != shape or not (np.abs(array) <= most).all():
            raise ValueError(f"its {name} is no usable number")
        return array

    cell, line = float(numbers("cell", (), 1.0)), numbers("line_tool", (2, 3), MAX_REACH)
    if cell < 1e-3 or abs(np.linalg.norm(line[0]) - 1.0) > 1e-6:
        raise ValueError("its cell or line_tool is no usable number")
    key = header.get("key")
    if not isinstance(key, str):
        raise ValueError("its key is no text")
    across = numbers("across_tool", (3,), 1.0 + 1e-6) if values.ndim == _TURNED else None
    if across is not None and abs(np.linalg.norm(across) - 1.0) > 1e-6:
        raise ValueError("its across_tool is no usable number")
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
    """The map that lies beside a robot's file, where there is one and it is of this robot.

    That of one arm of several is named so: `NAME.ARM.reach`.
    """
    path = robot.path.with_suffix(f".{robot.arm}.reach" if robot.arm else ".reach")
    if not os.path.lexists(path):
        return None
    try:
        found = decode(read_bytes_bounded(path, MAX_BYTES))
    except FileFormatError as error:
        log.warning("%s: %s; it is not used", path, error)
        return None
    return found if found.key == key else None


class MapTakesLong(MomaposError):
    """Building a map has taken all the processor time that it may."""


def load_reach(
    robot: Robot,
    cache_dir: Path | None = None,
    progress: Progress | None = None,
    *,
    limit: float = LIMIT,
) -> ReachMap | ArmLength:
    """The map of a robot as `load_reach_map` has it, or its arm's length where it can have none.

    Args:
        robot: The robot.
        cache_dir: Folder of the cache; the user's by default.
        progress: Called with the share that is done, in [0, 1], while the map is built.
        limit: Processor time that building it may take [s]; the arm's length is taken beyond.
    """
    why = no_map(robot)
    if not why:
        try:
            return load_reach_map(robot, cache_dir, progress, limit=limit)
        except MapTakesLong as error:
            why = str(error)
    stand_in = arm_length(robot, why)
    log.warning("%s", stand_in.note)
    return stand_in


def load_reach_map(
    robot: Robot,
    cache_dir: Path | None = None,
    progress: Progress | None = None,
    *,
    config: ReachConfig | None = None,
    limit: float = math.inf,
) -> ReachMap:
    """The map of a robot: shipped with it, from the cache, or built and kept there.

    Args:
        robot: The robot.
        cache_dir: Folder of the cache; the user's by default.
        progress: Called with the share that is done, in [0, 1], while the map is built.
        config: How finely; as `build_true_map` does where None.
        limit: Processor time that building it may take [s].

    Raises:
        MapTakesLong: It takes more, or has taken as much before.
    """
    key = map_key(robot, config or default_config(robot))
    ready = shipped(robot, key)
    if ready is not None:
        return ready
    cache = Cache(cache_dir or default_cache_dir())
    entry, late = f"reach-{_BUILD}-{key}", f"reach-{_BUILD}-{key}-takes-long"
    data = cache.get(entry)
    if data is not None:
        try:
            return decode(data)
        except FileFormatError as error:
            log.warning("%s: %s; building it again", cache.path(entry), error)
    try:
        if _taken(cache.get(late)) >= limit:
            raise _takes_long(robot, limit)
        within = _within(limit, progress or silent, robot)
        if config is None:
            built = build_true_map(robot, progress=within, key=key)
        else:
            built = build_map(robot, config, progress=within, key=key)
    except MapTakesLong:
        _keep(cache, late, b"%g" % limit, robot)
        raise
    _keep(cache, entry, encode(built), robot)
    return built


def build_true_map(robot: Robot, *, progress: Progress | None = None, key: str = "") -> ReachMap:
    """Build the map of a robot as `default_config` has it, see `build_map`, and calibrate it."""
    built = build_map(robot, default_config(robot), progress=progress, key=key)
    return calibrated(built, robot)


def _within(limit: float, progress: Progress, robot: Robot) -> Progress:
    """Progress that ends the work once it has taken so much processor time [s]."""
    began = time.process_time()

    def report(share: float) -> None:
        if share < 1.0 and time.process_time() - began > limit:
            raise _takes_long(robot, limit)
        progress(share)

    return report


def _takes_long(robot: Robot, limit: float) -> MapTakesLong:
    arm = f" --arm {robot.arm}" if robot.arm else ""
    return MapTakesLong(
        f"it is not built within {limit:.0f} s of processor time, while 'momapos reach build "
        f"{robot.path}{arm}' takes what it takes"
    )


def _taken(kept: bytes | None) -> float:
    """Processor time that building has taken without an end, as kept [s]; 0 where it is unknown."""
    try:
        return float(kept or b"0")
    except ValueError:
        return 0.0


def _keep(cache: Cache, entry: str, data: bytes, robot: Robot) -> None:
    try:
        cache.put(entry, data)
    except OSError as error:
        log.warning("the reachability map of %s cannot be kept: %s", robot.name, error)
