"""Write episodes as an HDF5 file in robomimic's layout."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import require

from .episodes import PART, RATE, Episode, check_alike


def write_hdf5(episodes: Iterable[tuple[str, Episode]], path: Path) -> int:
    """Write `data/demo_0` and so on: actions, states, obs, rewards, dones; return their number.

    Observations are robot0_joint_pos, robot0_base, robot0_gripper, object, and CAMERA_image. The
    language instruction and the success are attributes of each demo.

    Args:
        episodes: Names for messages, and episodes of one robot.
        path: The file, which is replaced.

    Raises:
        MissingExtraError: h5py is not installed.
        InputError: The episodes are of several robots.
    """
    with require("hdf5"):
        import h5py
    first, count, total = None, 0, 0
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        for where, episode in episodes:
            first = first or episode
            check_alike(first, episode, where)
            _write_demo(data.create_group(f"demo_{count}"), episode)
            count, total = count + 1, total + len(episode)
        data.attrs["total"] = total
        data.attrs["env_args"] = json.dumps({
            "env_name": "momapos", "type": 1,
            "env_kwargs": {
                "robots": None if first is None else first.robot, "control_freq": RATE,
                "columns": [] if first is None else list(first.names), "object": list(PART),
            },
        })  # fmt: skip
        file.create_group("mask").create_dataset(
            "train", data=np.array([f"demo_{k}".encode() for k in range(count)], "S")
        )
    return count


def _write_demo(demo: Any, episode: Episode) -> None:
    state, joints = episode.state, episode.state.shape[1] - 4
    demo.attrs["num_samples"] = len(episode)
    demo.attrs["language_instruction"] = episode.instruction
    demo.attrs["success"] = episode.success
    demo.create_dataset("actions", data=episode.action)
    demo.create_dataset("states", data=np.concatenate([state, episode.part], axis=1))
    last = np.arange(len(episode)) == len(episode) - 1
    demo.create_dataset("rewards", data=(last & episode.success).astype(np.float32))
    demo.create_dataset("dones", data=last.astype(np.int64))
    parts = {
        "robot0_joint_pos": state[:, :joints], "robot0_base": state[:, joints : joints + 3],
        "robot0_gripper": state[:, joints + 3 :], "object": episode.part,
    }  # fmt: skip
    width, height = episode.size
    for name, rows in (("obs", parts), ("next_obs", {k: _next(v) for k, v in parts.items()})):
        group = demo.create_group(name)
        for key, values in rows.items():
            group.create_dataset(key, data=values)
        for camera in episode.cameras:
            group.create_dataset(
                f"{camera}_image", (len(episode), height, width, 3), np.uint8, compression="gzip",
                chunks=(1, height, width, 3),
            )  # fmt: skip
    for k, images in enumerate(episode.images()):
        for camera, image in images.items():
            demo["obs"][f"{camera}_image"][k] = image
            for before in {max(k - 1, 0), k if k == len(episode) - 1 else max(k - 1, 0)}:
                demo["next_obs"][f"{camera}_image"][before] = image


def _next(rows: np.ndarray) -> np.ndarray:
    """Return the rows one frame later; the last row stays."""
    return np.concatenate([rows[1:], rows[-1:]])
