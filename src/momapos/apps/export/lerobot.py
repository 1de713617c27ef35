"""Write episodes as a LeRobot dataset (format v3.0, huggingface/lerobot).

Numbers and images are in Parquet, one file for each episode. The schema's metadata tell Hugging
Face's `datasets` which columns are images, and pandas which one is an index.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import require, write_atomic

from .episodes import PART, RATE, Episode, check_alike

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

VERSION = "v3.0"
FILES_PER_FOLDER = 1000
"""Number of Parquet files per chunk [-]."""
STATE, ACTION, OBJECT = "observation.state", "action", "observation.part"
_INDICES = ("frame_index", "episode_index", "index", "task_index")
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_STRIDE = 10
"""Every tenth image counts for the statistics of colors [-]."""


@dataclass
class _Statistics:
    """Smallest and largest value, mean and standard deviation of a feature, frame by frame."""

    low: Any = np.inf
    high: Any = -np.inf
    total: Any = 0.0
    squares: Any = 0.0
    count: int = 0
    """Values per channel [-]."""
    frames: int = 0

    def add(self, values: Float[np.ndarray, "t n"], frames: int) -> None:
        """Add rows of values."""
        self.low, self.high = (
            np.minimum(self.low, values.min(0)),
            np.maximum(self.high, values.max(0)),
        )
        self.total, self.squares = self.total + values.sum(0), self.squares + (values**2).sum(0)
        self.count, self.frames = self.count + len(values), self.frames + frames

    def members(self, shape: tuple[int, ...]) -> dict[str, Any]:
        """Return the members of the file."""
        mean = self.total / self.count
        spread = np.sqrt(np.maximum(self.squares / self.count - mean**2, 0.0))
        values = {"min": self.low, "max": self.high, "mean": mean, "std": spread}
        return {
            **{name: np.reshape(value, shape).tolist() for name, value in values.items()},
            "count": [self.frames],
        }


@dataclass
class _Set:
    """What is known about the episodes written so far."""

    tasks: dict[str, int] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    """One row for each episode."""
    frames: int = 0
    stats: dict[str, _Statistics] = field(default_factory=dict)


def write_lerobot(episodes: Iterable[tuple[str, Episode]], folder: Path) -> int:
    """Write a dataset into a folder; return the number of episodes.

    Args:
        episodes: Names for messages, and episodes of one robot.
        folder: An empty folder.

    Raises:
        MissingExtraError: pyarrow or Pillow is not installed.
        InputError: The episodes are of several robots.
    """
    made, first = _Set(), None
    for where, episode in episodes:
        first = first or episode
        check_alike(first, episode, where)
        _write_episode(made, episode, folder)
    if first is None:
        return 0
    _write_meta(made, first, folder)
    return len(made.rows)


def _write_episode(made: _Set, episode: Episode, folder: Path) -> None:
    with require("parquet"):
        import pyarrow as pa
    number, size = len(made.rows), len(episode)
    task = made.tasks.setdefault(episode.instruction, len(made.tasks))
    numbers = {STATE: episode.state, ACTION: episode.action, OBJECT: episode.part}
    columns: dict[str, Any] = {
        name: pa.FixedSizeListArray.from_arrays(pa.array(rows.ravel()), rows.shape[1])
        for name, rows in numbers.items()
    }
    for name, rows in numbers.items():
        made.stats.setdefault(name, _Statistics()).add(rows.astype(float), size)
    columns |= _image_columns(made, episode)
    index = made.frames + np.arange(size)
    columns["timestamp"] = pa.array((np.arange(size) / RATE).astype(np.float32))
    for name, rows in zip(
        _INDICES,
        (np.arange(size), np.full(size, number), index, np.full(size, task)),
        strict=True,
    ):
        columns[name] = pa.array(rows.astype(np.int64))
    for name in ("timestamp", *_INDICES):
        rows = columns[name].to_numpy()[:, None].astype(float)
        made.stats.setdefault(name, _Statistics()).add(rows, size)
    table = pa.table(columns)
    known = {"huggingface": json.dumps({"info": {"features": _hf_features(_features(episode))}})}
    chunk, file = divmod(number, FILES_PER_FOLDER)
    _write_parquet(
        table.replace_schema_metadata(known),
        folder / _DATA.format(chunk_index=chunk, file_index=file),
    )
    made.rows.append({
        "episode_index": number, "tasks": [episode.instruction], "length": size,
        "data/chunk_index": chunk, "data/file_index": file,
        "dataset_from_index": made.frames, "dataset_to_index": made.frames + size,
        "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
    })  # fmt: skip
    made.frames += size


def _image_columns(made: _Set, episode: Episode) -> dict[str, Any]:
    """Return a column of PNG files for each camera."""
    if not episode.cameras:
        return {}
    import pyarrow as pa

    files: dict[str, list[bytes]] = {camera: [] for camera in episode.cameras}
    for k, images in enumerate(episode.images()):
        for camera, image in images.items():
            files[camera].append(png_of(image))
            if k % _STRIDE == 0:
                colors = image.reshape(-1, 3) / 255.0
                made.stats.setdefault(image_key(camera), _Statistics()).add(colors, 1)
    kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    return {
        image_key(camera): pa.array([{"bytes": one, "path": None} for one in rows], kind)
        for camera, rows in files.items()
    }


def image_key(camera: str) -> str:
    """Return the name of a camera's feature."""
    return f"observation.images.{camera}"


def png_of(image: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """Return an image as a PNG file."""
    with require("scan"):
        from PIL import Image
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", compress_level=3)
    return file.getvalue()


def _features(episode: Episode) -> dict[str, dict[str, Any]]:
    """Return the description of all columns."""
    width, height = episode.size
    names = list(episode.names)
    image = {
        "dtype": "image",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
    }
    numbers = {STATE: names, ACTION: names, OBJECT: list(PART)}
    one = {"shape": [1], "names": None}
    return {
        **{
            key: {"dtype": "float32", "shape": [len(of)], "names": of}
            for key, of in numbers.items()
        },
        **{image_key(camera): image for camera in episode.cameras},
        "timestamp": {"dtype": "float32", **one},
        **{key: {"dtype": "int64", **one} for key in _INDICES},
    }


def _hf_features(features: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the columns as the metadata of `datasets` describe them."""

    def kind(one: dict[str, Any]) -> dict[str, Any]:
        if one["dtype"] == "image":
            return {"_type": "Image"}
        value = {"dtype": one["dtype"], "_type": "Value"}
        if one["shape"] == [1]:
            return value
        return {"feature": value, "length": one["shape"][0], "_type": "Sequence"}

    return {name: kind(one) for name, one in features.items()}


def _write_meta(made: _Set, first: Episode, folder: Path) -> None:
    """Write what describes the whole set."""
    import pyarrow as pa

    features = _features(first)
    info = {
        "codebase_version": VERSION, "robot_type": first.robot, "total_episodes": len(made.rows),
        "total_frames": made.frames, "total_tasks": len(made.tasks),
        "chunks_size": FILES_PER_FOLDER, "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 500, "fps": round(RATE),
        "splits": {"train": f"0:{len(made.rows)}"}, "data_path": _DATA, "video_path": None,
        "features": features,
    }  # fmt: skip
    _write_json(info, folder / "meta" / "info.json")
    image_shape = (3, 1, 1)
    stats = {
        name: one.members(image_shape if features[name]["dtype"] == "image" else (-1,))
        for name, one in made.stats.items()
    }
    _write_json(stats, folder / "meta" / "stats.json")
    tasks = pa.table(
        {
            "task_index": pa.array(list(made.tasks.values()), pa.int64()),
            "task": pa.array(list(made.tasks)),
        }
    )
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": list(_pandas_columns())}
    known = {"pandas": json.dumps({**pandas, "pandas_version": "2.0.0"})}
    _write_parquet(tasks.replace_schema_metadata(known), folder / "meta" / "tasks.parquet")
    _write_parquet(
        pa.Table.from_pylist(made.rows),
        folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet",
    )


def _pandas_columns() -> Iterator[dict[str, Any]]:
    for name, kind, stored in (("task_index", "int64", "int64"), ("task", "unicode", "object")):
        yield {
            "name": name, "field_name": name, "pandas_type": kind, "numpy_type": stored,
            "metadata": None,
        }  # fmt: skip


def _write_json(data: object, path: Path) -> None:
    write_atomic(path, json.dumps(data, indent=1).encode())


def _write_parquet(table: Any, path: Path) -> None:
    from pyarrow import parquet

    file = io.BytesIO()
    parquet.write_table(table, file)
    write_atomic(path, file.getvalue())
