"""Pictures one after the other as a file that plays: GIF for pages, MP4 for talks."""

from __future__ import annotations

import io
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.core import InputError, require

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import UInt8

STRIP, GIF, MP4 = ".png", ".gif", ".mp4"
"""How names of strips and films end."""
COLORS = 128
"""Of a picture of a GIF [-]."""
QUALITY = {"crf": "23", "preset": "veryfast"}
"""Of H.264: clean edges at about 50 kB a second of a quiet picture."""


def check_film(path: Path) -> None:
    """Make sure before the work that a file can become a strip of pictures or a film.

    Raises:
        InputError: Its name ends otherwise.
        MissingExtraError: What writes it is not installed.
    """
    if path.suffix.lower() not in (STRIP, GIF, MP4):
        raise InputError(
            f"{path}: a strip of pictures is a PNG, a film a GIF or an MP4; name it so"
        )
    if path.suffix.lower() == MP4:
        with require("film"):
            import av  # noqa: F401


def encoded(pictures: Iterable[UInt8[np.ndarray, "h w 3"]], ending: str, rate: float) -> bytes:
    """Pictures as the content of a file.

    Args:
        pictures: One after the other, all of one size, which is even for an MP4; at least one.
        ending: `GIF` or `MP4`.
        rate: Pictures a second [1/s].

    Raises:
        MissingExtraError: What writes them is not installed.
    """
    return _mp4(pictures, rate) if ending == MP4 else _gif(pictures, rate)


def _gif(pictures: Iterable[UInt8[np.ndarray, "h w 3"]], rate: float) -> bytes:
    with require("physics"):
        from PIL import Image
    first, *others = (Image.fromarray(picture).quantize(COLORS) for picture in pictures)
    content = io.BytesIO()
    first.save(
        content, "GIF", save_all=True, append_images=others, loop=0, duration=round(1000 / rate)
    )
    return content.getvalue()


def _mp4(pictures: Iterable[UInt8[np.ndarray, "h w 3"]], rate: float) -> bytes:
    with require("film"):
        import av
    content, stream = io.BytesIO(), None
    with av.open(content, "w", format="mp4") as file:
        for picture in pictures:
            if stream is None:
                stream = file.add_stream("libx264", Fraction(rate), options=QUALITY)
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"  # what every player shows
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        if stream is not None:
            file.mux(stream.encode())
    return content.getvalue()
