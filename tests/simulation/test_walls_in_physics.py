"""Walls of a room are solid in physics."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from tests.cupboards import BAR, SLIDE, carcass, furniture_room, tray

from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import make_task
from momapos.simulation.simulated_room import add_room


def distances(scene: Scene, middle: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return how far a ray goes from a point in each direction; -1 without end [m]."""
    spec = mujoco.MjSpec()
    add_room(spec, scene, make_task(scene, "open", "cupboard"), None)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hit = np.zeros(1, np.int32)
    return np.array([
        mujoco.mj_ray(model, data, middle, d, None, 1, -1, hit, None) for d in directions
    ])  # fmt: skip


def test_walls_along_the_floor_end_every_ray_at_the_floors_edge(tmp_path: Path) -> None:
    half, middle = np.array([2.0, 3.0]), np.array([-2.0, 0.0, 1.5])
    floor = middle[:2] + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    room = furniture_room(tmp_path, [carcass(), tray(BAR), SLIDE])
    scene = Scene(room.name, room.objects, floor_polygon=floor).with_walls()
    angle = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
    directions = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    edge = (half / np.maximum(np.abs(directions[:, :2]), 1e-9)).min(1)
    np.testing.assert_allclose(distances(scene, middle, directions), edge, atol=1e-6)
    assert (distances(scene.furniture, middle, directions) == -1).all()
