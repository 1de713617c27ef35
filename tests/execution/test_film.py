"""Filmstrips: what happened can be seen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image
from tests import optional
from tests.execution.toy import toy
from tests.verification.door_case import BASE

from momapos.errors import InputError
from momapos.execution.film import COLUMNS, FILM_HEIGHT, HEIGHT, WIDTH, Film
from momapos.execution.film_canvas import Shot, frame_shot
from momapos.execution.shapes import Kind
from momapos.geometry.transforms import pose_planar
from momapos.scene.scene import SceneObject


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


@optional.needs("EGL", optional.draws_off_screen())
def test_a_film_moves_and_is_light_and_can_be_read(tmp_path: Path) -> None:
    film = Film()
    toy(tmp_path).run(watch=film)
    film.write(tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as moving:
        assert moving.size == (1280, 720)
        assert moving.n_frames > 3
        pictures = []
        for k in (0, moving.n_frames - 1):
            moving.seek(k)
            pictures.append(np.asarray(moving.convert("L"), float))
    first, last = pictures
    assert np.abs(first - last).mean() > 1.0
    assert first.mean() > 128  # light
    caption = first[FILM_HEIGHT:]
    assert caption.max() - caption.min() > 150  # dark on white


def test_a_wall_before_the_camera_hides_nothing(tmp_path: Path) -> None:
    run, free, walled = toy(tmp_path), Film(), Film()
    run.run(watch=free)
    before = shot_of(free)
    (x, y, _), far = before.camera.lookat, 0.6 * before.camera.distance
    walls = tuple(
        SceneObject.box(f"wall{k}", size, (x + a * far, y + b * far, 2.0), category="wall")
        for k, (a, b, size) in enumerate(
            ((-1, 0, (0.1, 2 * far, 4.0)), (1, 0, (0.1, 2 * far, 4.0)),
             (0, -1, (2 * far, 0.1, 4.0)), (0, 1, (2 * far, 0.1, 4.0)))
        )
    )  # fmt: skip
    run.scene = replace(run.scene, objects=(*run.scene.objects, *walls))
    run.run(watch=walled)
    shot, world = shot_of(walled), walled.world
    assert world is not None
    assert len(shot.through) > 0
    assert all(world.kinds[k] == Kind.ROOM for k in shot.through)
    assert shot.camera.distance == pytest.approx(before.camera.distance, rel=0.05)


def shot_of(film: Film) -> Shot:
    """How a run is seen."""
    assert film.world is not None
    data = mujoco.MjData(film.world.model)
    return frame_shot(film.world, data, [q for _, _, q in film.states])


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
