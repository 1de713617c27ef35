"""Encode images as a GIF or an MP4."""

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
"""Suffixes of filmstrips and films."""
COLORS = 128
"""Number of colors of a GIF [-]."""
QUALITY = {"crf": "23", "preset": "veryfast"}
"""H.264 options: sharp edges at about 50 kB/s for a still scene."""


def check_film(path: Path) -> None:
    """Check that a filmstrip or film can be written to a file.

    Raises:
        InputError: The suffix is unknown.
        MissingExtraError: The encoder is not installed.
    """
    if path.suffix.lower() not in (STRIP, GIF, MP4):
        raise InputError(
            f"{path}: unknown suffix {path.suffix!r}; use .png for a filmstrip, "
            ".gif or .mp4 for a film"
        )
    if path.suffix.lower() == MP4:
        with require("film"):
            import av  # noqa: F401


def encode_film(pictures: Iterable[UInt8[np.ndarray, "h w 3"]], ending: str, rate: float) -> bytes:
    """Encode images as the content of a film.

    Args:
        pictures: At least one image, all of the same size, which is even for an MP4.
        ending: `GIF` or `MP4`.
        rate: Frame rate [1/s].

    Raises:
        MissingExtraError: The encoder is not installed.
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
                stream.pix_fmt = "yuv420p"  # supported by every player
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        if stream is not None:
            file.mux(stream.encode())
    return content.getvalue()
