"""Reading of map files: anything that is not a reachability map is refused."""

from __future__ import annotations

import json
import os
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from momapos.core.errors import FileFormatError
from momapos.model.robots.robot import Robot
from momapos.planning.reachability.map_store import MAX_BYTES, decode, encode, shipped
from momapos.planning.reachability.reach_map import ReachMap

VALUES = np.arange(48, dtype=np.int8).reshape(2, 3, 2, 2, 2)
LINE = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, 0.1]])
MAP = ReachMap(VALUES, 0.1, 0.05, np.array([0.2, 0.0]), LINE, 1.0, "key", 2.0)


def changed(**changes: Any) -> bytes:
    """Encode the map with changed members in its header; None removes a member."""
    data = encode(MAP)
    begin = data.index(b"{")
    (length,) = struct.unpack_from("<I", data, begin - 4)
    header = json.loads(data[begin : begin + length]) | changes
    text = json.dumps({k: v for k, v in header.items() if v is not None}).encode()
    return data[: begin - 4] + struct.pack("<I", len(text)) + text + data[begin + length :]


def with_header(text: bytes) -> bytes:
    return encode(MAP).split(b"{")[0][:-4] + struct.pack("<I", len(text)) + text


def test_decoding_inverts_encoding() -> None:
    for again in (decode(encode(MAP)), decode(changed())):
        np.testing.assert_array_equal(again.values, VALUES)
        np.testing.assert_array_equal(again.line_tool, LINE)
        assert encode(again) == encode(MAP)


BAD: dict[str, bytes] = {
    "nothing": b"",
    "cut in the magic": encode(MAP)[:10],
    "cut in the length": encode(MAP)[:16],
    "cut in the header": encode(MAP)[:40],
    "cut in the values": encode(MAP)[:-3],
    "a deep header": with_header(b"[" * 9000),
    "a long header": with_header(b" " * 20_000),
    "a list": with_header(b"[]"),
    "no key": changed(key=None),
    "no version": changed(version=None),
    "no shape": changed(shape=None),
    "no cell": changed(cell=None),
    "a key that is an object": changed(key={"a": 1}),
    "a string for a shape": changed(shape="12345"),
    "a shape of strings": changed(shape=["2", 3, 2, 2, 2]),
    "a shape of booleans": changed(shape=[True, 24, 2, 1, 1]),
    "a shape with one height": changed(shape=[1, 6, 2, 2, 2]),
    "a shape whose size overflows": changed(shape=[2**32, 2**32, 2, 2, 2]),
    "a huge shape": changed(shape=[10**400, 3, 2, 2, 2]),
    "another shape": changed(shape=[2, 3, 2, 2, 3]),
    "many azimuths": changed(shape=[2, 2, 2, 2, 100]),
    "a huge number": changed(low=10**400),
    "infinity": changed(low=1e999),
    "a cell of size 0": changed(cell=0.0),
    "a direction of length 0": changed(line_tool=[[0, 0, 0], [0, 0, 0]]),
    "a far axis": changed(axis_xy=[1e9, 0]),
    "a zip bomb": changed() [: changed().index(b"}") + 1] + zlib.compress(bytes(10**7)),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_data_that_is_not_a_map_is_refused(case: str) -> None:
    with pytest.raises(FileFormatError, match="not a usable reachability map") as caught:
        decode(BAD[case])
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("kind", ["fifo", "folder", "sparse", "circle", "damaged"])
def test_a_damaged_file_next_to_a_robot_is_ignored(
    tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture, ranger: Robot
) -> None:
    robot = replace(ranger, path=tmp_path / "r.toml")
    path = tmp_path / "r.reach"
    assert shipped(robot, "key") is None
    assert not caplog.messages
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "circle":
        path.symlink_to(path)
    else:
        path.write_bytes(BAD["no key"])
        if kind == "sparse":
            os.truncate(path, MAX_BYTES + 1)
    assert shipped(robot, "key") is None
    assert len(caplog.messages) == 1
