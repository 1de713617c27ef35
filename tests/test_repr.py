"""Laws of the repr of records: short, and with the essential numbers."""

from __future__ import annotations

import numpy as np

from momapos.model.records.plans import Motion, PlacementPlan, Task
from momapos.model.records.scans import Cloud, Frame
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_motions import MotionConfig, task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.reachability.reach_map import ReachMap


def test_records_that_hold_models_and_arrays_have_a_short_repr(
    kitchen: Scene, fetch: Robot
) -> None:
    fridge = kitchen.object("fridge")
    motion = Motion(np.zeros((500, 7)), np.zeros((50, 7)), np.zeros(50), np.zeros((50, 4, 4)))
    task = Task("open", "fridge", "door_hinge", 1.0)
    plan = PlacementPlan(
        "scene.json", "fetch", "fetch.urdf", "base_link", "grip", task, "solved",
        tuple("abcdefg"), motion=motion, base_path=np.zeros((900, 3)),
    )  # fmt: skip
    frame = Frame("0001", np.zeros((480, 640, 3), np.uint8), None, np.eye(3), np.eye(4))
    cloud = Cloud(np.zeros((9000, 3)), np.zeros((9000, 3)), np.zeros((9000, 3), np.uint8))
    opening = make_task(kitchen, "open", "fridge", "door_hinge")
    held = task_motion(kitchen, fetch, opening, MotionConfig())
    values = np.zeros((4, 5, 3, 3, 2), np.int8)
    reach = ReachMap(values, 0.0, 0.05, np.zeros(2), np.zeros((2, 3)))
    for record, words in (
        (kitchen, ["'kitchen_small'", f"{len(kitchen.objects)} objects"]),
        (fridge, ["'fridge'"]),
        (fridge.model, ["links", "movable joints"]),
        (fetch, ["'fetch'", "arm joints"]),
        (motion, ["500 states", "50 in it"]),
        (plan, ["fetch", "open fridge/door_hinge", "solved"]),
        (frame, ["'0001'", "640 x 480 pixels", "no depth"]),
        (cloud, ["9000 points"]),
        (held, ["open fridge", "grasps", "steps"]),
        (reach, ["4 x 5 x 3 x 3 x 2 values"]),
    ):
        text = repr(record)
        assert text.startswith(f"<{type(record).__name__}"), text
        assert all(word in text for word in words), text
        assert len(text) < 100 + len(str(fetch.path)), text
