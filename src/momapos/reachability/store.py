"""Keep reachability maps: built at the first use, then read from the cache."""

from __future__ import annotations

import json
import logging
import struct
import zlib
from dataclasses import asdict
from pathlib import Path

import numpy as np

from momapos.cache import Cache, content_key, default_cache_dir
from momapos.errors import FileFormatError
from momapos.reachability.construct import Progress, build_map, default_config
from momapos.reachability.map import ReachConfig, ReachMap
from momapos.robots.robot import Robot

log = logging.getLogger(__name__)
VERSION = 2
"""Changes whenever maps are built or stored differently."""
_MAGIC = b"momapos-reach\n"
_MAX_VALUES = 500_000_000
_FIELDS = ("low", "cell", "axis_xy", "line_tool", "threshold", "key", "build_seconds")


def map_key(robot: Robot, config: ReachConfig) -> str:
    """Key of a robot's map: all that it is built from, as numbers.

    URDF, SRDF, meshes, arm joints and tool enter as the chain and the collision shapes they give,
    so that a comment in a file changes nothing and a mesh on the disk does.
    """
    chain = robot.chain
    *shapes, _, _ = robot.spheres.arrays()  # the last, bounds of the base, follow from its boxes
    arrays = (
        chain.h, chain.d, chain.prismatic, chain.lower, chain.upper, chain.tool_offset,
        chain.tool_rotation, robot.approach_axis, *shapes,
    )  # fmt: skip
    # A micrometre more or less is another machine's rounding, not another robot.
    rounded = (np.round(a, 6) + 0.0 if a.dtype.kind == "f" else a for a in arrays)
    return content_key("reach", VERSION, sorted(asdict(config).items()), *rounded)


def encode(reach_map: ReachMap) -> bytes:
    """A map as bytes: magic, length of the header, header (JSON), values (int8, zlib)."""
    header = {name: getattr(reach_map, name) for name in _FIELDS}
    header = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in header.items()}
    header |= {"version": VERSION, "shape": reach_map.values.shape}
    text = json.dumps(header).encode()
    values = zlib.compress(reach_map.values.tobytes(), 6)
    return _MAGIC + struct.pack("<I", len(text)) + text + values


def decode(data: bytes) -> ReachMap:
    """Read what `encode` wrote.

    Raises:
        FileFormatError: It is not that.
    """
    try:
        if not data.startswith(_MAGIC):
            raise ValueError("not a reachability map")
        (length,) = struct.unpack_from("<I", data, len(_MAGIC))
        begin = len(_MAGIC) + 4
        header = json.loads(data[begin : begin + length])
        if header["version"] != VERSION:
            raise ValueError(f"version {header['version']}, this is {VERSION}")
        shape = tuple(int(n) for n in header["shape"])
        size = int(np.prod(shape))
        if len(shape) != 5 or min(shape) < 1 or size > _MAX_VALUES:
            raise ValueError(f"shape {shape}")
        inflate = zlib.decompressobj()
        raw = inflate.decompress(data[begin + length :], size + 1)
        if len(raw) != size or not inflate.eof:
            raise ValueError("wrong amount of values")
        axis, line = np.array(header["axis_xy"], float), np.array(header["line_tool"], float)
        names = ("low", "cell", "threshold", "build_seconds")
        numbers = np.array([header[name] for name in names], float)
        finite = all(np.isfinite(part).all() for part in (axis, line, numbers))
        if axis.shape != (2,) or line.shape != (2, 3) or not finite or numbers[1] <= 0:
            raise ValueError("frame")
    except (ValueError, KeyError, TypeError, OverflowError, struct.error, zlib.error) as error:
        raise FileFormatError(f"not a usable reachability map ({error})") from error
    return ReachMap(
        np.frombuffer(raw, np.int8).reshape(shape),
        float(numbers[0]),
        float(numbers[1]),
        axis,
        line,
        float(numbers[2]),
        str(header["key"]),
        float(numbers[3]),
    )


def shipped(robot: Robot, key: str) -> ReachMap | None:
    """The map that lies beside a robot's file, where there is one and it is of this robot."""
    path = robot.path.with_suffix(".reach")
    try:
        found = decode(path.read_bytes())
    except FileNotFoundError:
        return None
    except (FileFormatError, OSError) as error:
        log.warning("%s: %s; it is not used", path, error)
        return None
    return found if found.key == key else None


def load_reach_map(
    robot: Robot,
    cache_dir: Path | None = None,
    progress: Progress | None = None,
    *,
    config: ReachConfig | None = None,
) -> ReachMap:
    """The map of a robot: shipped with it, from the cache, or built and kept there.

    Args:
        robot: The robot.
        cache_dir: Folder of the cache; the user's by default.
        progress: Called with the share that is done, in [0, 1], while the map is built.
        config: How finely; `default_config(robot)` where None.
    """
    config = config or default_config(robot)
    key = map_key(robot, config)
    ready = shipped(robot, key)
    if ready is not None:
        return ready
    cache = Cache(cache_dir or default_cache_dir())
    entry = f"reach-{key}"
    data = cache.get(entry)
    if data is not None:
        try:
            return decode(data)
        except FileFormatError as error:
            log.warning("%s: %s; building it again", cache.path(entry), error)
    built = build_map(robot, config, progress=progress, key=key)
    try:
        cache.put(entry, encode(built))
    except OSError as error:
        log.warning("the reachability map of %s cannot be kept: %s", robot.name, error)
    return built
