"""What a person meets at the prompt is short and says what it is."""

from __future__ import annotations

import numpy as np

from momapos import load_robot, load_scene
from momapos.reachability.map import ReachMap
from momapos.types import Motion


def test_records_that_hold_models_and_arrays_have_a_short_repr() -> None:
    scene, robot = load_scene("kitchen_small"), load_robot("fetch")
    fridge = scene.object("fridge")
    motion = Motion(np.zeros((500, 7)), np.zeros((50, 7)), np.zeros(50), np.zeros((50, 4, 4)))
    values = np.zeros((4, 5, 3, 3, 2), np.int8)
    reach = ReachMap(values, 0.0, 0.05, np.zeros(2), np.zeros((2, 3)))
    for thing, words in (
        (scene, ["'kitchen_small'", f"{len(scene.objects)} objects"]),
        (fridge, ["'fridge'"]),
        (fridge.model, ["links", "movable joints"]),
        (robot, ["'fetch'", "arm joints"]),
        (motion, ["500 states", "50 in it"]),
        (reach, ["4 x 5 x 3 x 3 x 2 values"]),
    ):
        text = repr(thing)
        assert text.startswith(f"<{type(thing).__name__}"), text
        assert all(word in text for word in words), text
        assert len(text) < 100 + len(str(robot.path)), text
