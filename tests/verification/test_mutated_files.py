"""Randomly damaged files are read or rejected in one line, quickly and without other output."""

from __future__ import annotations

import json
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from door_case import JOINTS, make_case

from momapos.core.errors import MAX_MESSAGE_LENGTH, MomaposError
from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.planning.reachability.map_store import decode, encode
from momapos.planning.reachability.reach_map import ReachMap
from momapos.verification.plan_check import verify_files

COUNT = 60
"""Files of each kind [-]."""
SECONDS = 10
NUMBERS = [
    b"0", b"-1", b"1", b"3", b"-0.3", b"0.2", b"100", b"1e-9", b"1e-300", b"1e5", b"1e30", b"-2e9",
    b"nan", b"9999999999",
]  # fmt: skip
NAMES = [
    b"base", b"door", b"palm", b"box", b"sphere", b"mesh", b"fixed", b"prismatic", b"continuous",
    b"hinge", b"elbow", b"tool", b"size", b"omni", b"origin", b"limit",
]  # fmt: skip
WORDS = [
    *NUMBERS, *NAMES, b"1e308", b"-1e999", b"NaN", b"null", b"true", b"[]", b"{}", b'""',
    b"9" * 400, b"9" * 5000, b"a" * 2000, b"[" * 2000, b"<a>" * 100, b"\0", b"\xff\xfe",
    b"../../../etc/passwd", b"&#10;", b'"', b"<", b">", b",", b" ", b"\n", b"utf-16", b"0.0.1",
]  # fmt: skip
TOML = f"""name = "toy"
urdf = "robot.urdf"
base_link = "base"
tool_link = "tool"
arm_joints = {json.dumps(JOINTS)}
gripper_links = ["palm"]
home = [0, 0.1, 0.2, 0, 0.1, 0]
[base]
footprint = [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]
drive = "differential"
max_speed = 0.5
[tool]
approach_axis = [0, 0, 1]
closing_axis = [0, 1, 0]
opening = 0.08
"""
SRDF = """<?xml version="1.0" encoding="utf-8"?>
<robot name="toy"><disable_collisions link1="base" link2="shoulder" reason="Adjacent"/></robot>
"""


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage a file in one or two places: bytes, pieces, and mostly numbers and words."""
    gentle = rng.random() < 0.6
    for _ in range(rng.integers(1, 3)):
        at, end = np.sort(rng.integers(0, len(data) + 1, 2))
        word = WORDS[rng.integers(len(WORDS))]
        kind = 5 if gentle else rng.integers(7)
        if kind == 0 and at < len(data):
            data = data[:at] + bytes([rng.integers(256)]) + data[at + 1 :]
        elif kind == 1:
            data = data[:at] + data[min(end, at + 50) :]
        elif kind == 2:
            data = data[:end] + data[at : at + 500] + data[end:]
        elif kind == 3:
            data = data[:at] + word + data[at:]
        elif kind == 4:
            data = data[: max(at, 1)]
        else:  # in place of a number or a word
            begin = stop = min(at, len(data) - 1)
            while begin > 0 and data[begin - 1 : begin] not in b' ,[]<>"=:\n':
                begin -= 1
            while stop < len(data) and data[stop : stop + 1] not in b' ,[]<>"=:\n':
                stop += 1
            if data[begin : begin + 1].strip(b"-.0123456789") == b"":
                word = NUMBERS[rng.integers(len(NUMBERS))]
            elif gentle:
                word = NAMES[rng.integers(len(NAMES))]
            data = data[:begin] + word + data[stop:]
    return data


def replaced(text: str, rng: np.random.Generator) -> str:
    """Replace one value of a JSON text."""
    data = json.loads(text)
    values: list[Any] = [
        0, -1, 1e9, 1e308, 10**400, None, True, "", "a" * 2000, [], {}, [[]], [None], "../x", -0.5,
        "nan", [1e9] * 3, [[0.0] * 6] * 3, {"x": 0},
    ]  # fmt: skip
    node: Any = data
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = keys[rng.integers(len(keys))]
        child = node[key]
        if not isinstance(child, dict | list) or not child or rng.random() < 0.2:
            node[key] = values[rng.integers(len(values))]
            return json.dumps(data)
        node = child


@contextmanager
def limited(what: str) -> Iterator[None]:
    """Raise if the block takes too long or a library warns."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"{what}: hangs")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def files(folder: Path) -> dict[str, tuple[bytes, Callable[[], Any]]]:
    """Return valid files by name, each with a function that reads it."""
    plan = make_case().write(folder)
    (folder / "robot.toml").write_text(TOML)
    (folder / "robot.srdf").write_text(SRDF)
    line = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.1]])
    values = np.arange(96, dtype=np.int8).reshape(2, 3, 2, 2, 4)
    reach = ReachMap(values, 0.0, 0.05, np.zeros(2), line, 0.0, "key")
    (folder / "robot.reach").write_bytes(encode(reach))
    bestman = [
        {"obj_name": "c", "model_path": "Asset/c.urdf", "object_position": [0, "1/2", 0],
         "object_orientation": [0, 0, "math.pi"], "scale": 1},
        {"obj_name": "d", "model_path": "Asset/gone.urdf", "object_position": [1, 1, 1],
         "object_orientation": [0, 0, 0], "scale": "2"},
    ]  # fmt: skip
    (folder / "bestman.json").write_text(json.dumps(bestman))
    (folder / "Asset").mkdir()
    (folder / "Asset" / "c.urdf").write_bytes((folder / "cupboard.urdf").read_bytes())
    acts: dict[str, Callable[[], Any]] = {
        "plan.json": lambda: verify_files(plan),
        "scene.json": lambda: load_scene(folder / "scene.json"),
        "bestman.json": lambda: load_scene(folder / "bestman.json"),
        "cupboard.urdf": lambda: Articulated(read_urdf(folder / "cupboard.urdf")).boxes,
        "robot.urdf": lambda: load_robot(folder / "robot.toml").spheres,
        "robot.toml": lambda: load_robot(folder / "robot.toml").ik,
        "robot.srdf": lambda: load_robot(folder / "robot.toml"),
        "robot.reach": lambda: decode((folder / "robot.reach").read_bytes()).score(np.eye(4)),
    }
    return {name: ((folder / name).read_bytes(), act) for name, act in acts.items()}


KINDS = [
    "plan.json", "scene.json", "bestman.json", "cupboard.urdf", "robot.urdf", "robot.toml",
    "robot.srdf", "robot.reach",
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_read_or_rejected_in_one_line(
    kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    valid, act = files(tmp_path)[kind]
    act()
    rng = np.random.default_rng(KINDS.index(kind))
    rejected = 0
    for number in range(COUNT):
        text = valid.decode() if kind.endswith(".json") and number % 2 else None
        content = damaged(valid, rng) if text is None else replaced(text, rng).encode()
        (tmp_path / kind).write_bytes(content)
        try:
            with limited(f"{kind} {number}"):
                act()
        except MomaposError as error:
            rejected += 1
            message = str(error)
            assert 10 < len(message) <= MAX_MESSAGE_LENGTH
            for noise in ("NoneType", "object has no", "unhashable", "subscriptable", "Traceback"):
                assert noise not in message
    assert COUNT // 4 < rejected <= COUNT, "too little damage for a meaningful test"
    assert capfd.readouterr() == ("", "")
    assert not caplog.messages
