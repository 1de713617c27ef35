"""Films contain their images at their rate."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests import optional

from momapos.core.errors import InputError, MissingExtraError
from momapos.simulation.film import GIF, MP4, check_film, encode_film

RATE = 10.0
IMAGES = [np.full((48, 64, 3), shade, np.uint8) for shade in (20, 120, 220)]


def test_a_gif_has_all_images_at_their_rate() -> None:
    with Image.open(io.BytesIO(encode_film(iter(IMAGES), GIF, RATE))) as film:
        assert film.n_frames == len(IMAGES)
        assert film.info["duration"] == 1000 / RATE
        film.seek(2)
        assert film.convert("L").getpixel((5, 5)) == 220


def test_an_mp4_has_all_images_at_their_rate() -> None:
    av = optional.module("av")
    with av.open(io.BytesIO(encode_film(iter(IMAGES), MP4, RATE))) as film:
        stream = film.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.average_rate == RATE
        shades = [frame.to_ndarray(format="rgb24").mean() for frame in film.decode(video=0)]
    np.testing.assert_allclose(shades, [20, 120, 220], atol=4)


def test_an_unusable_film_file_is_refused_before_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingExtraError, match=r"pip install av"):
        check_film(Path("film.mp4"))
    with pytest.raises(InputError, match="unknown suffix"):
        check_film(Path("film.mov"))
    for name in ("film.gif", "film.PNG"):
        check_film(Path(name))
