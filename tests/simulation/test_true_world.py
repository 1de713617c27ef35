"""Plans for the believed scene are executed in the true one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.simulation.toy import Toy, gripping
from tests.verification.door_case import BASE, HINGE, OPEN, cupboard_urdf

from momapos.core.errors import InputError
from momapos.model.records.plans import Task
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.simulation.config import ExecutionConfig
from momapos.simulation.execute import AttemptOutcome, attempt
from momapos.simulation.true_worlds import moved, true_world

HANDLE = np.array([0.095, 0.25, 0.8])


def really(folder: Path, text: str) -> Scene:
    """Return a room with a cupboard of another file and name."""
    file = folder / "real.urdf"
    file.write_text(text)
    return Scene("truth", (SceneObject.from_urdf("chest", file, (0.4, 0.0, 0.8)),))


def backward(*, shift: float = 0.0) -> str:
    """Return the cupboard with a shifted hinge that opens toward negative values."""
    text = cupboard_urdf().replace('name="hinge"', 'name="real"')
    text = text.replace('axis xyz="0 0 1"', 'axis xyz="0 0 -1"')
    text = text.replace('lower="0" upper="1.2"', 'lower="-1.2" upper="0"')
    x = -0.215 + shift
    text = text.replace('origin xyz="-0.215 -0.29 0"', f'origin xyz="{x} -0.29 0"')
    text = text.replace('origin xyz="0 0.29 0"', f'origin xyz="{-shift} 0.29 0"')
    return text.replace('origin xyz="-0.09 0.54', f'origin xyz="{-0.09 - shift} 0.54')


def run(toy: Toy, there: Scene) -> AttemptOutcome:
    hand = toy.motion.Ts_world_tool[0, :3, 3]
    world = true_world(there, toy.scene, toy.task, hand)
    return attempt(
        toy.scene, toy.robot, BASE, toy.motion, toy.task, ExecutionConfig(), true_world=world
    )


def test_the_part_at_the_hand_opens_as_far_regardless_of_its_name_and_values(
    tmp_path: Path,
) -> None:
    toy = gripping(tmp_path)
    done = run(toy, really(tmp_path, backward())).execution
    assert done.success, done.reason
    assert done.asked == pytest.approx(-OPEN)
    assert done.reached == pytest.approx(-OPEN, rel=0.05)


def test_the_hand_finds_a_hinge_that_the_scene_misplaces(tmp_path: Path) -> None:
    toy = gripping(tmp_path)
    done = run(toy, really(tmp_path, backward(shift=0.03))).execution
    assert done.success, done.reason
    true = np.array([HINGE[0] + 0.03, HINGE[1]])
    assert np.linalg.norm(np.array(done.joint.point[:2]) - true) < 0.015


def test_a_drawer_does_not_follow_the_motion_for_a_door(tmp_path: Path) -> None:
    toy = gripping(tmp_path)
    drawer = cupboard_urdf().replace('type="revolute"', 'type="prismatic"')
    drawer = drawer.replace('axis xyz="0 0 1"', 'axis xyz="0 1 0"')
    done = run(toy, really(tmp_path, drawer)).execution
    assert not done.success
    assert done.reached == pytest.approx(0.0, abs=0.05)


def test_the_part_nearest_to_the_hand_is_chosen_and_none_far_away(tmp_path: Path) -> None:
    toy = gripping(tmp_path)
    there = really(tmp_path, backward())
    other = replace(there.objects[0], name="far", T_world_object=np.eye(4))
    both = replace(there, objects=(other, *there.objects))
    world = true_world(both, toy.scene, toy.task, HANDLE)
    assert (world.task.object, world.task.joint, world.task.to) == ("chest", "real", -OPEN)
    with pytest.raises(InputError, match="no part that opens is within 30 cm of the hand"):
        true_world(moved(there, np.array([2.0, 0.0, 0.0])), toy.scene, toy.task, HANDLE)
    with pytest.raises(InputError, match="opens or closes a joint, not 'pick'"):
        true_world(there, toy.scene, Task("pick", "bin"), HANDLE)


def test_moving_a_room_there_and_back_round_trips(tmp_path: Path) -> None:
    room = gripping(tmp_path).scene
    away = moved(room, np.array([0.4, -0.2, np.pi / 2]))
    c, s = np.cos(-np.pi / 2), np.sin(-np.pi / 2)
    x, y = -np.array([[c, -s], [s, c]]) @ [0.4, -0.2]
    back = moved(away, np.array([x, y, -np.pi / 2]))
    for one, other in zip(room.objects, back.objects, strict=True):
        np.testing.assert_allclose(other.T_world_object, one.T_world_object, atol=1e-9)
    np.testing.assert_allclose(back.floor_polygon, room.floor_polygon, atol=1e-9)


@pytest.mark.parametrize(("travel", "wide"), [(0.2, 0.2), (0.3, 0.3), (0.5, 0.3)])
def test_a_drawer_in_place_of_a_door_opens_by_the_same_share_of_its_travel_or_of_30_cm(
    tmp_path: Path, travel: float, wide: float
) -> None:
    toy = gripping(tmp_path)
    text = cupboard_urdf().replace('type="revolute"', 'type="prismatic"')
    text = text.replace('axis xyz="0 0 1"', 'axis xyz="-1 0 0"').replace(
        'upper="1.2"', f'upper="{travel}"'
    )
    world = true_world(really(tmp_path, text), toy.scene, toy.task, HANDLE)
    assert world.task.to == pytest.approx(wide * OPEN / 1.2)
