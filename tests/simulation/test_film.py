"""Filmstrips and films show the run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image
from tests import optional
from tests.simulation.toy import toy

from momapos.core.errors import InputError
from momapos.model.scene.scene_object import SceneObject
from momapos.simulation.film import (
    COLUMNS,
    FILM_HEIGHT,
    FORCE_COLOR,
    HEIGHT,
    WIDTH,
    Overlay,
    Shot,
    canvas,
    frame_shot,
    write_film,
)
from momapos.simulation.geoms import Kind
from momapos.simulation.run_trace import RunTrace


@pytest.mark.slow
@optional.needs("EGL", optional.draws_off_screen())
def test_a_filmstrip_shows_the_run(tmp_path: Path) -> None:
    trace = RunTrace()
    toy(tmp_path).run(watch=trace)
    write_film(trace, tmp_path / "film.png", frames=COLUMNS)
    with Image.open(tmp_path / "film.png") as picture:
        strip = picture.convert("RGB")
    assert strip.width >= COLUMNS * WIDTH
    first, last = (
        strip.crop((left, 20, left + WIDTH, HEIGHT)) for left in (0, strip.width - WIDTH)
    )
    assert first.tobytes() != last.tobytes()
    assert len(strip.resize((60, 30)).getcolors(10_000)) > 20


@pytest.mark.slow
@optional.needs("EGL", optional.draws_off_screen())
def test_a_film_moves_is_bright_and_has_a_readable_caption(tmp_path: Path) -> None:
    trace = RunTrace()
    toy(tmp_path).run(watch=trace)
    write_film(trace, tmp_path / "film.gif", ending="done")
    with Image.open(tmp_path / "film.gif") as moving:
        assert moving.size == (1280, 720)
        assert moving.n_frames > 3
        pictures = []
        for k in (0, moving.n_frames - 1):
            moving.seek(k)
            pictures.append(np.asarray(moving.convert("L"), float))
    first, last = pictures
    assert np.abs(first - last).mean() > 1.0
    assert first.mean() > 128  # bright
    caption = first[FILM_HEIGHT:]
    assert caption.max() - caption.min() > 150  # white on dark


@pytest.mark.slow
def test_a_wall_in_front_of_the_camera_hides_nothing(tmp_path: Path) -> None:
    run, free, walled = toy(tmp_path), RunTrace(), RunTrace()
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
    shot, world = shot_of(walled), walled.acts[0].world
    assert len(shot.through) > 0
    assert all(world.kinds[k] == Kind.ROOM for k in shot.through)
    assert shot.camera.distance == pytest.approx(before.camera.distance, rel=0.05)


def shot_of(trace: RunTrace) -> Shot:
    """Return the camera of a run."""
    (act,) = trace.acts
    data = mujoco.MjData(act.world.model)
    return frame_shot(act.world, data, [state.q for state in act.states])


def test_without_off_screen_rendering_one_line_names_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trace = RunTrace()
    toy(tmp_path).run(watch=trace)
    monkeypatch.setenv("DISPLAY", ":none")
    monkeypatch.setattr(mujoco, "GLContext", no_canvas)
    with pytest.raises(InputError, match=r"install EGL \(Debian: libegl1") as caught:
        write_film(trace, tmp_path / "film.png", frames=COLUMNS)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "film.png").exists()


def no_canvas(width: int, height: int) -> None:
    """Raise as on a machine without a rendering library."""
    raise RuntimeError(f"no canvas of {width} x {height}")


@pytest.mark.slow
@optional.needs("EGL", optional.draws_off_screen())
def test_the_force_arrow_is_drawn_over_what_hides_the_hand(tmp_path: Path) -> None:
    trace = RunTrace()
    toy(tmp_path).run(watch=trace)
    world = trace.acts[0].world
    shot, pictures = shot_of(trace), []
    inside = world.data.geom_xpos[np.flatnonzero(world.kinds == Kind.PART)[0]].copy()
    with canvas(world.model, 320, 240) as draw:
        for force in (0.0, 20.0):
            over = Overlay(np.zeros((0, 2)), inside, np.array([0.0, 0.0, force]))
            pictures.append(draw(world.data, shot.camera, shot.through, over))
    changed = (pictures[0] != pictures[1]).any(2)
    rows, columns = np.nonzero(changed)
    assert (pictures[1][changed] == FORCE_COLOR).all()
    assert np.ptp(rows) > 2 * np.ptp(columns)  # upright


def test_a_film_without_a_motion_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no motion was executed"):
        write_film(RunTrace(), tmp_path / "film.png")
