"""Filmstrips: what happened can be seen."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image
from tests.execution.toy import toy
from tests.verification.door_case import BASE

from momapos.errors import InputError
from momapos.execution.film import COLUMNS, HEIGHT, WIDTH, Film
from momapos.geometry.transforms import pose_planar


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
