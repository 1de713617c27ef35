"""Runs as episodes for learning: states, actions and images at equal time steps."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.apps.synthetic_scans import (
    Backdrop,
    RenderWorld,
    join_worlds,
    link_of_triangles,
    look_at,
    moved_world,
    pinhole,
    render_backdrop,
    render_frame,
    render_world,
)
from momapos.core import InputError, in_threads, require
from momapos.core.geometry import invert, pose, pose_planar
from momapos.model.records import Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject
from momapos.simulation import RunRecord

from .timeline import Timeline, run_timeline

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Int, UInt8


Camera = Literal["room", "hand"]
RGB = tuple[float, float, float]
CAMERAS: tuple[Camera, ...] = ("room", "hand")
"""room: to the side of the robot at its base pose, still, toward the grasp; hand: on the hand."""
FOCAL = {"room": 0.85, "hand": 0.6}
"""Focal length of each camera, as a share of the image width [-]; 61 and 80 deg wide."""
ROOM_DISTANCE, ROOM_SIDE, ROOM_HEIGHT = 1.9, 0.7, 1.7
"""Distance of the room's camera from its aim [m], angle to the robot [rad], and height [m]."""
ROBOT_COLOR = (0.80, 0.81, 0.83)
"""sRGB color of robots, whose files have none."""
HAND_BACK, HAND_OFF = 0.12, 0.07
"""How far the hand's camera is behind the tool frame and off the hand's approach axis [m]."""


@dataclass(frozen=True, eq=False)
class _Moving:
    """An object as triangles in the frames of its links, to be placed at any state."""

    world: RenderWorld
    link: Int[np.ndarray, " n"]
    """Index of the link of each triangle."""
    local: Float[np.ndarray, "n 3 3"]
    """Corners in the frames of the links [m]."""

    @classmethod
    def of(cls, scene: Scene, item: SceneObject, color: RGB | None = None) -> _Moving:
        """Prepare an object; a color replaces its materials."""
        alone = replace(scene, objects=(item,))
        world = render_world(alone, np.random.default_rng(0), floor=False)
        if color is not None:
            gray = tuple(replace(material, color=color) for material in world.materials)
            world = replace(world, materials=gray)
        link = link_of_triangles(item)
        T = invert(_link_poses(item))[link]
        return cls(world, link, np.einsum("nij,nkj->nki", T[:, :3, :3], world.triangles)
                   + T[:, None, :3, 3])  # fmt: skip

    def placed(self, item: SceneObject) -> Float[np.ndarray, "n 3 3"]:
        """Return the triangles of the object in another state [m]."""
        T = _link_poses(item)[self.link]
        return self.local @ T[:, :3, :3].swapaxes(1, 2) + T[:, None, :3, 3]


def _link_poses(item: SceneObject) -> Float[np.ndarray, "l 4 4"]:
    poses = item.link_poses()
    return np.array([poses[name] for name in item.model.urdf.links])


@dataclass(frozen=True, eq=False)
class EpisodeRenderer:
    """Renders the scene with the robot and the moved object at samples of a timeline."""

    scene: Scene
    robot: Robot
    timeline: Timeline
    size: tuple[int, int]
    """Width and height of the images [px]."""
    still: RenderWorld
    """Everything that does not move."""
    T_world_room: Float[np.ndarray, "4 4"]
    """Pose of the room's camera."""

    @classmethod
    def of(
        cls, scene: Scene, robot: Robot, timeline: Timeline, size: tuple[int, int]
    ) -> EpisodeRenderer:
        """Prepare the rendering of a run in a scene."""
        others = tuple(item for item in scene.objects if item.name != timeline.task.object)
        still = render_world(replace(scene, objects=others), np.random.default_rng(0))
        return cls(scene, robot, timeline, size, still, _room_camera(scene, timeline))

    def prepare(self, cameras: Sequence[Camera]) -> None:
        """Compute what all images share, before several threads render them."""
        self.images(0, cameras)

    def images(
        self, sample: int, cameras: Sequence[Camera]
    ) -> Mapping[Camera, UInt8[np.ndarray, "h w 3"]]:
        """Render what cameras see at a sample."""
        robot = self._robot(sample)
        moving = [
            self._moving_object.placed(self._object(sample)),
            self._moving_robot.placed(robot),
        ]
        world = moved_world(self._world, np.concatenate(moving))
        found: dict[Camera, UInt8[np.ndarray, "h w 3"]] = {}
        for camera in cameras:
            room = camera == "room"
            T = self.T_world_room if room else self._hand_camera(robot)
            found[camera] = render_frame(
                world, T, self._lens(camera), self.size, backdrop=self._backdrop if room else None
            ).color
        return found

    def _lens(self, camera: Camera) -> Float[np.ndarray, "3 3"]:
        return pinhole(self.size, FOCAL[camera] * self.size[0])

    @cached_property
    def _world(self) -> RenderWorld:
        """What stands still, the object and the robot, in this order."""
        world = join_worlds(self.still, self._moving_object.world)
        return join_worlds(world, self._moving_robot.world)

    @cached_property
    def _backdrop(self) -> Backdrop:
        return render_backdrop(self.still, self.T_world_room, self._lens("room"), self.size)

    @cached_property
    def _moving_object(self) -> _Moving:
        return _Moving.of(self.scene, self._object(0))

    @cached_property
    def _moving_robot(self) -> _Moving:
        return _Moving.of(self.scene, self._robot(0), ROBOT_COLOR)

    @cached_property
    def _T_base_root(self) -> Float[np.ndarray, "4 4"]:
        return invert(self.robot.model.link_poses({})[self.robot.base_link])

    def _values(self, sample: int) -> dict[str, float]:
        values = self.timeline.samples.positions[sample].tolist()
        return dict(zip(self.timeline.joints, values, strict=True))

    def _robot(self, sample: int) -> SceneObject:
        """Return the robot as an object of the scene."""
        model = self.robot.model
        T = pose_planar(self.timeline.samples.base[sample]) @ self._T_base_root
        held = {**model.held, **self._values(sample)}
        free = {n: v for n, v in held.items() if n in model.joints and model.joint(n).mimic is None}
        return SceneObject(self.robot.name, "robot", T, model, free)

    def _object(self, sample: int) -> SceneObject:
        """Return the object of the task as it is at a sample."""
        item = self.scene.object(self.timeline.task.object)
        poses = self.timeline.Ts_world_object
        if poses is not None:
            return replace(item, T_world_object=poses[sample])
        limits = {name: item.joint(name) for name in self.timeline.object_values(sample)}
        moved = {
            name: float(np.clip(value, limits[name].lower, limits[name].upper))
            for name, value in self.timeline.object_values(sample).items()
        }
        return replace(item, joints={**item.joints, **moved})

    def _hand_camera(self, placed: SceneObject) -> Float[np.ndarray, "4 4"]:
        """Return the pose of the camera on the hand: it looks along the approach axis."""
        robot, T_world_tool = self.robot, placed.link_poses()[self.robot.tool_link]
        ahead, right = robot.approach_axis, robot.closing_axis
        down = np.cross(ahead, right)
        eye = -HAND_BACK * ahead - HAND_OFF * down
        return T_world_tool @ pose(eye, np.stack([right, down, ahead], axis=1))


def _room_camera(scene: Scene, timeline: Timeline) -> Float[np.ndarray, "4 4"]:
    """Return a pose from which robot and object are seen when the base has arrived."""
    base = timeline.samples.base[-1]
    target = scene.object(timeline.task.object).bounds.mean(0)
    away = base[:2] - target[:2]
    angle = np.arctan2(away[1], away[0]) + ROOM_SIDE
    aim = np.append(0.5 * (base[:2] + target[:2]), 0.8)
    eye = np.append(aim[:2] + ROOM_DISTANCE * np.array([np.cos(angle), np.sin(angle)]), ROOM_HEIGHT)
    return look_at(eye, aim)


RATE = 10.0
"""Frames per second, the rate of a record [1/s]."""
BASE = ("base_x", "base_y", "base_yaw")
GRIPPER = "gripper"
PART = ("value", "x", "y", "z", "qw", "qx", "qy", "qz")
_HOLDING = ("grip", "manipulate", "dwell")
"""Stages in which the hand is closed."""
MIN_FRAMES = 2
MAX_THREADS = 4
"""Threads that render; more only wait for the one that writes [-]."""


@dataclass(frozen=True, eq=False)
class Episode:
    """A run at equal time steps; row t of `action` leads from frame t to frame t + 1."""

    robot: str
    instruction: str
    """The task in words, such as "open the fridge by its door hinge"."""
    success: bool
    names: tuple[str, ...]
    """Names of the columns of `state` and `action`: joints, base, gripper."""
    state: Float32[np.ndarray, "t n"]
    """Joint values [rad] or [m], pose of the base x [m], y [m], yaw [rad], and whether the hand is
    closed, 0 or 1 [-]."""
    action: Float32[np.ndarray, "t n"]
    """The state to reach at the next frame; that of the last frame is the state there."""
    part: Float32[np.ndarray, "t 8"]
    """What the task moves, see `PART`: the value of the joint [rad] or [m], 0 without one, and the
    object's pose in the world [m]."""
    cameras: tuple[Camera, ...]
    size: tuple[int, int]
    """Width and height of the images [px]."""
    samples: tuple[int, ...]
    """Sample of the timeline of each frame."""
    renderer: EpisodeRenderer

    def __len__(self) -> int:
        return len(self.state)

    def images(self) -> Iterator[Mapping[Camera, UInt8[np.ndarray, "h w 3"]]]:
        """Render the images of all frames in order, with a thread for each processor."""
        if not self.cameras:
            return
        self.renderer.prepare(self.cameras)
        render = partial(self.renderer.images, cameras=self.cameras)
        yield from in_threads(render, self.samples, MAX_THREADS)


def episode_of(
    record: RunRecord, scene: Scene, robot: Robot, cameras: Sequence[Camera], size: tuple[int, int]
) -> Episode:
    """Return a run as an episode.

    Args:
        record: The record, with its motion.
        scene: The true scene of the run.
        robot: The robot of its plan.
        cameras: Cameras to render.
        size: Width and height of the images [px].

    Raises:
        InputError: The record has no motion, or is shorter than two frames.
    """
    timeline = run_timeline(record, robot)
    times = timeline.samples.times
    wanted = np.arange(times[0], times[-1] + 1e-6, 1.0 / RATE)
    if len(wanted) < MIN_FRAMES:
        raise InputError(f"the run takes {np.ptp(times):.2f} s, less than {MIN_FRAMES} frames")
    nearest = np.clip(np.searchsorted(times, wanted - 0.5 / RATE), 0, len(times) - 1)
    state = _state(timeline)[nearest]
    return Episode(
        robot.name, instruction_of(timeline.task), record.success,
        (*timeline.joints, *BASE, GRIPPER), state, np.concatenate([state[1:], state[-1:]]),
        _part(timeline, scene)[nearest], tuple(cameras), size, tuple(nearest.tolist()),
        EpisodeRenderer.of(scene, robot, timeline, size),
    )  # fmt: skip


def instruction_of(task: Task) -> str:
    """Return a task in words."""
    name = task.object.replace("_", " ")
    if task.joint is None:
        return f"pick up the {name}" if task.verb == "pick" else f"put down the {name}"
    return f"{task.verb} the {name} by its {task.joint.replace('_', ' ')}"


def _state(timeline: Timeline) -> Float32[np.ndarray, "t n"]:
    samples = timeline.samples
    holding = np.isin(np.array(timeline.stages)[samples.phase], _HOLDING)
    columns = [samples.positions, samples.base, holding[:, None]]
    return np.concatenate(columns, axis=1, dtype=np.float32)


def _part(timeline: Timeline, scene: Scene) -> Float32[np.ndarray, "t 8"]:
    count = len(timeline.samples.times)
    Ts = timeline.Ts_world_object
    if Ts is None:
        Ts = np.tile(scene.object(timeline.task.object).T_world_object, (count, 1, 1))
    value = timeline.samples.object_q if timeline.task.joint is not None else np.zeros(count)
    wxyz = Rotation.from_matrix(Ts[:, :3, :3]).as_quat(scalar_first=True)
    return np.concatenate([value[:, None], Ts[:, :3, 3], wxyz], axis=1, dtype=np.float32)


def check_alike(first: Episode, other: Episode, where: str) -> None:
    """Refuse an episode that does not fit into the set of another one.

    Raises:
        InputError: It is of another robot, or has other joints.
    """
    if other.names != first.names:
        raise InputError(
            f"{where}: moves other joints ({other.robot}) than the runs before it ({first.robot}); "
            "a set holds the runs of one robot, so give a folder for each"
        )


def write_hdf5(episodes: Iterable[tuple[str, Episode]], path: Path) -> int:
    """Write `data/demo_0` and so on: actions, states, obs, rewards, dones; return their number.

    Observations are robot0_joint_pos, robot0_base, robot0_gripper, object, and CAMERA_image. The
    language instruction and the success are attributes of each demo.

    Args:
        episodes: Names for messages, and episodes of one robot.
        path: The file, which is replaced.

    Raises:
        MissingExtraError: h5py is not installed.
        InputError: The episodes are of several robots.
    """
    with require("hdf5"):
        import h5py
    first, count, total = None, 0, 0
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        for where, episode in episodes:
            first = first or episode
            check_alike(first, episode, where)
            _write_demo(data.create_group(f"demo_{count}"), episode)
            count, total = count + 1, total + len(episode)
        data.attrs["total"] = total
        data.attrs["env_args"] = json.dumps({
            "env_name": "momapos", "type": 1,
            "env_kwargs": {
                "robots": None if first is None else first.robot, "control_freq": RATE,
                "columns": [] if first is None else list(first.names), "object": list(PART),
            },
        })  # fmt: skip
        file.create_group("mask").create_dataset(
            "train", data=np.array([f"demo_{k}".encode() for k in range(count)], "S")
        )
    return count


def _write_demo(demo: Any, episode: Episode) -> None:
    state, joints = episode.state, episode.state.shape[1] - 4
    demo.attrs["num_samples"] = len(episode)
    demo.attrs["language_instruction"] = episode.instruction
    demo.attrs["success"] = episode.success
    demo.create_dataset("actions", data=episode.action)
    demo.create_dataset("states", data=np.concatenate([state, episode.part], axis=1))
    last = np.arange(len(episode)) == len(episode) - 1
    demo.create_dataset("rewards", data=(last & episode.success).astype(np.float32))
    demo.create_dataset("dones", data=last.astype(np.int64))
    parts = {
        "robot0_joint_pos": state[:, :joints], "robot0_base": state[:, joints : joints + 3],
        "robot0_gripper": state[:, joints + 3 :], "object": episode.part,
    }  # fmt: skip
    width, height = episode.size
    for name, rows in (("obs", parts), ("next_obs", {k: _next(v) for k, v in parts.items()})):
        group = demo.create_group(name)
        for key, values in rows.items():
            group.create_dataset(key, data=values)
        for camera in episode.cameras:
            group.create_dataset(
                f"{camera}_image", (len(episode), height, width, 3), np.uint8, compression="gzip",
                chunks=(1, height, width, 3),
            )  # fmt: skip
    for k, images in enumerate(episode.images()):
        for camera, image in images.items():
            demo["obs"][f"{camera}_image"][k] = image
            for before in {max(k - 1, 0), k if k == len(episode) - 1 else max(k - 1, 0)}:
                demo["next_obs"][f"{camera}_image"][before] = image


def _next(rows: np.ndarray) -> np.ndarray:
    """Return the rows one frame later; the last row stays."""
    return np.concatenate([rows[1:], rows[-1:]])
