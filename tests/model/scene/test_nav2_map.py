"""Cells of maps are free, occupied or unknown as map_server reads them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import UInt8
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from momapos.core.errors import MomaposError
from momapos.model.scene.formats.nav2_map import MapGrid, is_map, read_map

YAML = """image: map.pgm
mode: trinary
resolution: 0.05
origin: [-1.0, 2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
GRAYS = np.array([[0, 89, 90, 204, 205, 206, 254, 255]], np.uint8)
"""Pixels on both sides of the thresholds: 0.65 is 89.25, 0.196 is 205.02."""


def grid(folder: Path, pixels: UInt8[np.ndarray, "..."], **changes: object) -> MapGrid:
    """Write and read a map; changes replace or, if None, drop keys of its YAML file."""
    lines = [line for line in YAML.splitlines() if line.partition(":")[0] not in changes]
    lines += [f"{key}: {value}" for key, value in changes.items() if value is not None]
    (folder / "map.yaml").write_text("\n".join(lines))
    name = str(changes.get("image", "map.pgm"))
    Image.fromarray(pixels).save(folder / name)
    return read_map(folder / "map.yaml", folder)


def words(found: MapGrid) -> str:
    """Return a letter for each cell of the first row: free, occupied or unknown."""
    return "".join(
        "f" if a else "o" if b else "u"
        for a, b in zip(found.free[0], found.occupied[0], strict=True)
    )


def test_thresholds_decide_in_mode_trinary(tmp_path: Path) -> None:
    assert words(grid(tmp_path, GRAYS)) == "oouuufff"
    assert words(grid(tmp_path, 255 - GRAYS, negate=1)) == "oouuufff"
    assert words(grid(tmp_path, GRAYS, mode=None, free_thresh=0.3, occupied_thresh=0.3)) == (
        "oooffffff"[:3] + "fffff"
    )


def test_mode_scale_has_unknown_cells_in_between_and_where_it_is_transparent(
    tmp_path: Path,
) -> None:
    assert words(grid(tmp_path, GRAYS, mode="scale")) == "oouuufff"
    pixels = np.stack([GRAYS] * 3 + [np.full_like(GRAYS, 255)], -1)
    pixels[0, [0, 7], 3] = 254
    assert words(grid(tmp_path, pixels, mode="scale", image="map.png")) == "uouuuffu"


def test_mode_raw_reads_percent(tmp_path: Path) -> None:
    raw = np.array([[0, 19, 20, 64, 65, 100, 101, 255]], np.uint8)
    assert words(grid(tmp_path, raw, mode="raw")) == "ffuuoouu"


def test_mode_trinary_averages_the_opacity_with_the_colors(tmp_path: Path) -> None:
    """As map_server does: an opaque gray of 205 counts as (3 x 205 + 255) / 4."""
    pixels = np.stack([GRAYS] * 3 + [np.full_like(GRAYS, 255)], -1)
    assert words(grid(tmp_path, pixels, image="map.png")) == "ouufffff"
    clear = pixels.copy()
    clear[..., 3] = 0
    assert words(grid(tmp_path, clear, image="map.png"))[-1] == "u"


def test_colors_are_averaged(tmp_path: Path) -> None:
    pixels = np.array([[[255, 0, 0], [255, 255, 255], [30, 0, 0]]], np.uint8)
    assert words(grid(tmp_path, pixels, image="map.png")) == "ofo"


def test_text_and_binary_and_deep_images_are_the_same(tmp_path: Path) -> None:
    expected = words(grid(tmp_path, GRAYS))
    values = " ".join(map(str, GRAYS[0]))
    (tmp_path / "map.pgm").write_text(f"P2\n# made by hand\n{GRAYS.size} 1\n255\n{values}\n")
    assert words(read_map(tmp_path / "map.yaml", tmp_path)) == expected
    deep = b"".join((257 * int(v)).to_bytes(2, "big") for v in GRAYS[0])
    (tmp_path / "map.pgm").write_bytes(b"P5\n%d 1\n65535\n" % GRAYS.size + deep)
    assert words(read_map(tmp_path / "map.yaml", tmp_path)) == expected


def test_rows_count_up_from_the_origin_which_may_be_turned(tmp_path: Path) -> None:
    pixels = np.full((4, 6), 255, np.uint8)
    pixels[3, 0] = 0  # bottom left
    found = grid(tmp_path, pixels, origin="[-1.0, 2.0, 1.5707963267948966]")
    assert_array_equal(np.argwhere(found.occupied), [[0, 0]])
    assert_allclose(found.to_world(np.array([[0.0, 0.0], [6.0, 4.0]])), [[-1, 2], [-1.2, 2.3]])
    points = np.array([[0.5, 0.7], [-3.0, 1.0]])
    assert_allclose(found.to_world(found.to_cells(points)), points)


def test_maps_are_distinguished_from_other_yaml_by_their_keys() -> None:
    assert is_map(YAML)
    assert is_map("# made by slam_toolbox\n" + YAML)
    assert not is_map("resolution: 1\nworld:\n  image: 2\n")
    assert not is_map('{"a": "\nimage: 1\nresolution: 2\n"}')


BAD = {
    "no image": ({"image": "gone.pgm"}, "'gone.pgm' does not exist below"),
    "an image elsewhere": ({"image": "../map.pgm"}, "leaves"),
    "an absolute image": ({"image": "/etc/hostname"}, "leaves"),
    "no cells": ({"resolution": 0}, "resolution must be from 0.001 to 10 m per pixel, not 0"),
    "cells without end": ({"resolution": "1e9"}, "resolution must be"),
    "no number": ({"resolution": "small"}, "resolution must be a number, not 'small'"),
    "NaN": ({"resolution": ".nan"}, "resolution must be a number"),
    "a short origin": ({"origin": "[0, 0]"}, "origin must be 3 finite numbers"),
    "a far origin": ({"origin": "[0, 99999, 0]"}, "more than 10 km away"),
    "thresholds swapped": ({"free_thresh": 0.9}, "free_thresh the smaller, not 0.9 and 0.65"),
    "a threshold of percent": ({"occupied_thresh": 65}, "from 0 to 1"),
    "another mode": ({"mode": "binary"}, "mode must be one of trinary, scale, raw, not 'binary'"),
    "negate of 2": ({"negate": 2}, "negate must be 0 or 1, not 2"),
    "no resolution": ({"resolution": None}, "a map needs resolution"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_maps_are_refused_in_one_line(tmp_path: Path, case: str) -> None:
    changes, message = BAD[case]
    grid(tmp_path, GRAYS)
    lines = [line for line in YAML.splitlines() if line.partition(":")[0] not in changes]
    lines += [f"{key}: {value}" for key, value in changes.items() if value is not None]
    (tmp_path / "map.yaml").write_text("\n".join(lines))
    with pytest.raises(MomaposError, match=message) as raised:
        read_map(tmp_path / "map.yaml", tmp_path)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not an image"),
        (b"<svg></svg>", "not an image"),
        (b"P5\n9 9\n255\n123", "a damaged image"),
        (b"P5\n999999 999999\n255\n", "more than 16,000,000 pixels"),
        (b"P5\n9000 9000\n255\n", "9000 x 9000 pixels"),
        (b"P2\n2 1\n255\n0 word\n", "a damaged image"),
    ],
)
def test_bad_images_are_refused_in_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "map.yaml").write_text(YAML)
    (tmp_path / "map.pgm").write_bytes(content)
    with pytest.raises(MomaposError, match=message) as raised:
        read_map(tmp_path / "map.yaml", tmp_path)
    assert "\n" not in str(raised.value)
    assert math.isfinite(len(str(raised.value)))
