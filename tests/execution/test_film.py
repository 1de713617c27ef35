"""Filmstrips: what happened can be seen."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image
from tests.execution.toy import toy

from momapos.errors import InputError
from momapos.execution.film import COLUMNS, HEIGHT, WIDTH, Film


def test_a_filmstrip_shows_the_run_or_says_in_one_line_why_not(tmp_path: Path) -> None:
    film = Film()
    toy(tmp_path).run(watch=film)
    try:
        film.write(tmp_path / "film.png", frames=COLUMNS)
    except InputError as error:
        if "EGL" not in str(error):
            raise
        return
    with Image.open(tmp_path / "film.png") as picture:
        strip = picture.convert("RGB")
    assert strip.width >= COLUMNS * WIDTH
    first, last = (
        strip.crop((left, 20, left + WIDTH, HEIGHT)) for left in (0, strip.width - WIDTH)
    )
    assert first.tobytes() != last.tobytes()
    assert len(strip.resize((60, 30)).getcolors(10_000)) > 20


def test_a_film_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing was executed"):
        Film().write(tmp_path / "film.png")
