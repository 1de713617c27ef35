"""Filmstrips: what happened can be seen."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image
from tests import optional
from tests.execution.toy import toy
from tests.verification.door_case import BASE

from momapos.errors import InputError
from momapos.execution.film import COLUMNS, HEIGHT, WIDTH, Film
from momapos.geometry.transforms import pose_planar


@optional.needs("EGL", optional.draws_off_screen())
def test_a_filmstrip_shows_the_run(tmp_path: Path) -> None:
    film = Film()
    toy(tmp_path).run(watch=film)
    film.write(tmp_path / "film.png", frames=COLUMNS)
    with Image.open(tmp_path / "film.png") as picture:
        strip = picture.convert("RGB")
    assert strip.width >= COLUMNS * WIDTH
    first, last = (
        strip.crop((left, 20, left + WIDTH, HEIGHT)) for left in (0, strip.width - WIDTH)
    )
    assert first.tobytes() != last.tobytes()
    assert len(strip.resize((60, 30)).getcolors(10_000)) > 20


def test_without_a_canvas_one_line_says_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = Film()
    toy(tmp_path).run(watch=film)
    monkeypatch.setenv("DISPLAY", ":none")
    monkeypatch.setattr(mujoco, "GLContext", no_canvas)
    with pytest.raises(InputError, match="it needs EGL, as libegl1") as caught:
        film.write(tmp_path / "film.png", frames=COLUMNS)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "film.png").exists()


def no_canvas(width: int, height: int) -> None:
    """A machine without a library to draw with."""
    raise RuntimeError(f"no canvas of {width} x {height}")


def test_the_drive_that_led_there_comes_first_in_the_film(tmp_path: Path) -> None:
    film = Film()
    toy(tmp_path).run(watch=film)
    x, y, yaw = BASE
    film.drive(
        np.array([0.0, 2.0, 4.0]),
        np.array([[x - 1.0, y - 0.5, 0.3], [x - 0.5, y, yaw + 0.2], [x, y, yaw]]),
    )
    states = film.driven(2)
    world = film.world
    assert world is not None
    assert [(time, stage) for time, stage, _ in states] == [(0.0, "drive"), (2.0, "drive")]
    for (_, _, q), pose in zip(states, film.poses[0], strict=False):
        world.data.qpos[:] = q
        mujoco.mj_forward(world.model, world.data)
        base, T = world.data.body("base"), pose_planar(pose)
        np.testing.assert_allclose(base.xpos, T[:3, 3], atol=1e-6)
        np.testing.assert_allclose(base.xmat.reshape(3, 3), T[:3, :3], atol=1e-6)


def test_a_film_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing was executed"):
        Film().write(tmp_path / "film.png")
