"""Driving from pose to pose: plan, steer, dock, and say how it went.

What is true and what the controller believes are kept apart: the base moves by its velocities and
limits, the controller sees noisy fixes, and a judge of its own looks at the true pose alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import Clock, SceneError
from momapos.core.geometry import wrap_angle

from .base_motion import clip_velocity, integrate
from .convex_polygons import pack
from .docking import BEGIN, Docking, aimed, can_stop, stands
from .drive_record import DriveEnding, DriveRecord
from .dynamic_window import Steering, WindowConfig, velocity_window
from .footprint_map import NavigationMap, navigation_map_of
from .global_path import TURN, BasePath, direct_path, plan_path
from .judge import FootprintCollisionChecker
from .localization import Localiser, NoiseConfig
from .path_ends import PathConfig

if TYPE_CHECKING:
    from jaxtyping import Float

Moving: TypeAlias = "Callable[[float], Float[np.ndarray, 'd 5']]"
"""Discs at a time [s]: x [m], y [m], vx [m/s], vy [m/s], radius [m]."""
Meet: TypeAlias = "Callable[[Float[np.ndarray, '3']], None]"
"""Is told the true pose of the base."""
_NO_DISCS = np.zeros((0, 5))
_STANDING = 0.05
"""Discs slower than this are gone around [m/s]."""


_PLANNED_AGAIN = (DriveEnding.STUCK, DriveEnding.BESIDE_GOAL)
"""After these a new path is planned from where the base is."""


@dataclass(frozen=True)
class _End:
    """The end of a drive, or of a part of one."""

    ending: DriveEnding
    detail: str = ""

    @property
    def reason(self) -> str:
        return f"{self.ending.value} {self.detail}".strip()


@dataclass(frozen=True)
class DriveConfig:
    """How a base is driven, and when it has arrived."""

    tolerance: float = 0.03
    """Distance of the true pose from the goal at which the base has arrived [m]."""
    turn_tolerance: float = float(np.radians(2.0))
    """Difference of the true heading at which it has [rad]."""
    control: float = 0.06
    """Time between choices of a velocity [s]."""
    simulation: float = 0.02
    """Step of the simulated base [s]."""
    settle: float = 1.0
    """Time that the base stands at first, to learn where it is [s]."""
    patience: float = 4.0
    """Time without progress after which a new path is planned [s]."""
    replans: int = 6
    """New paths that are planned at most [-]."""
    timeout: float = 180.0
    """Time after which a drive ends [s]."""
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    path: PathConfig = field(default_factory=PathConfig)
    window: WindowConfig = field(default_factory=WindowConfig)


def drive(
    nav_map: NavigationMap,
    start: Float[np.ndarray, "3"],
    goal: Float[np.ndarray, "3"],
    *,
    rng: np.random.Generator,
    moving: Moving | None = None,
    meet: Meet | None = None,
    config: DriveConfig = DriveConfig(),
    clock: Clock = time.perf_counter,
) -> DriveRecord:
    """Drive a base from where it stands to a goal pose, in closed loop.

    Args:
        nav_map: The robot and the room, see `build_navigation_map`.
        start: True pose at first: x [m], y [m], yaw [rad].
        goal: The pose to reach.
        rng: Source of the noise; the same one gives the same drive.
        moving: What else moves; the controller sees it as it is at each moment.
        meet: Told where the base is in every control step, for what moves and looks where it goes.
        config: How to drive.
        clock: Measures the control steps.

    Raises:
        SceneError: Start or goal are no poses, or moving obstacles no discs.
    """
    poses = [np.array(pose, float) for pose in (start, goal)]
    for name, pose in zip(("start", "goal"), poses, strict=True):
        if pose.shape != (3,) or not np.isfinite(pose).all():
            raise SceneError(f"the {name} must be three finite numbers: x [m], y [m], yaw [rad]")
    around = moving or _nothing, meet or _nobody
    return _DriveRun(nav_map, poses[0], poses[1], rng, *around, config, clock).record()


def _nothing(_: float) -> Float[np.ndarray, "0 5"]:
    return _NO_DISCS


def _nobody(_: Float[np.ndarray, "3"]) -> None:
    return None


class _DriveRun:
    """One drive while it lasts."""

    def __init__(
        self,
        nav_map: NavigationMap,
        start: Float[np.ndarray, "3"],
        goal: Float[np.ndarray, "3"],
        rng: np.random.Generator,
        moving: Moving,
        meet: Meet,
        config: DriveConfig,
        clock: Clock,
    ) -> None:
        self.nav_map, self.goal, self.config, self.clock = nav_map, goal, config, clock
        self.moving, self.meet = moving, meet
        self.judge = FootprintCollisionChecker(
            nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon
        )
        self.localiser = Localiser(start, config.noise, rng)
        self.pose, self.velocity, self.now = start, np.zeros(3), 0.0
        self.times, self.poses, self.velocities = [0.0], [start], [np.zeros(3)]
        self.step_times: list[float] = []
        self.clearance, self.clearance_moving = np.inf, np.inf
        self.hit, self.planned, self.ways = "", np.inf, 0

    def record(self) -> DriveRecord:
        end = self._blocked() or self._ways()
        poses = np.array(self.poses)
        return DriveRecord(
            arrived=end is None,
            reason="" if end is None else end.reason,
            goal=self.goal,
            pose=self.pose,
            believed=self.localiser.pose,
            hit=self.hit,
            planned=self.planned,
            length=float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()),
            time=self.now,
            clearance=float(self.clearance),
            clearance_moving=float(self.clearance_moving),
            ways=self.ways,
            times=np.array(self.times),
            poses=poses,
            velocities=np.array(self.velocities),
            step_times=np.array(self.step_times),
            ending=None if end is None else end.ending,
        )

    def _blocked(self) -> _End | None:
        """Why there is no point in starting, if there is none."""
        for ending, pose in (
            (DriveEnding.START_BLOCKED, self.pose),
            (DriveEnding.GOAL_BLOCKED, self.goal),
        ):
            _, touched = self.judge.distance(pose[None])
            if touched[0]:
                return _End(ending, touched[0])
        discs = self._discs()
        if (self.judge.to_discs(self.pose, discs) <= 0).any():
            return _End(DriveEnding.START_BLOCKED, "a moving obstacle")
        self.clearance = float(self.judge.distance(self.pose[None])[0][0])
        return None

    def _ways(self) -> _End | None:
        """Plan a path and drive it, again where that has to be; None where it arrives."""
        if ended := self._wait(self.config.settle):
            return ended
        end: _End | None = None
        # Where the dynamic window got stuck, and for the last bit, the path is followed exactly.
        exactly = False
        for self.ways in range(1, self.config.replans + 2):  # noqa: B020
            path = self._plan()
            if path is None:
                if plan_path(self.nav_map, self.pose, self.goal, self.config.path) is None:
                    return _End(DriveEnding.NO_PATH)
                # Odd fixes pass, and so do people.
                end = _End(DriveEnding.NO_PATH_AS_BELIEVED)
                if len(self._standing()):
                    end = _End(DriveEnding.PATH_OCCUPIED)
                if ended := self._wait(self.config.patience):
                    return ended
                continue
            if np.isinf(self.planned):
                self.planned = path.length
            if not exactly and self._left(self.localiser.pose) > BEGIN:
                end, path = self._cruise(path)
                exactly = end is not None
            if path is not None:
                end = self._dock(path)
                exactly = end is None
                if end is None and self._there(self.localiser.pose, 0.6):
                    return None if self._there(self.pose, 1.0) else self._missed()
                end = end or _End(DriveEnding.BESIDE_GOAL)
            if end is not None and end.ending not in _PLANNED_AGAIN:
                return end
        return end

    def _there(self, pose: Float[np.ndarray, "3"], share: float) -> bool:
        """Whether a pose is within a share of the tolerance."""
        c, error = self.config, self.goal - pose
        near = float(np.hypot(error[0], error[1])) <= share * c.tolerance
        return near and abs(float(wrap_angle(error[2]))) <= share * c.turn_tolerance

    def _missed(self) -> _End:
        error = self.goal - self.pose
        turn = np.degrees(abs(float(wrap_angle(error[2]))))
        off = f"{100 * np.hypot(*error[:2]):.1f} cm and {turn:.1f} degrees off the goal"
        return _End(DriveEnding.MISSED, off)

    def _plan(self) -> BasePath | None:
        """A path from where the base believes to be, around what stands in it."""
        standing = self._standing()
        nav_map = _with_discs(self.nav_map, standing) if len(standing) else self.nav_map
        return plan_path(nav_map, self.localiser.pose, self.goal, self.config.path)

    def _discs(self) -> Float[np.ndarray, "d 5"]:
        """Moving obstacles as they are now."""
        discs = np.asarray(self.moving(self.now), float)
        if discs.ndim != 2 or discs.shape[1] != 5 or not np.isfinite(discs).all():
            raise SceneError(
                "moving obstacles must be rows of five finite numbers: x [m], y [m], vx [m/s], "
                f"vy [m/s], radius [m]; at {self.now:.2f} s they were {discs.tolist()}"
            )
        return discs

    def _standing(self) -> Float[np.ndarray, "d 5"]:
        """Moving obstacles that do not move now."""
        discs = self._discs()
        return discs[np.hypot(discs[:, 2], discs[:, 3]) < _STANDING]

    def _wait(self, seconds: float) -> _End | None:
        for _ in range(int(seconds / self.config.control)):
            if ended := self._step(np.zeros(3)):
                return ended
        return None

    def _cruise(self, path: BasePath) -> tuple[_End | None, BasePath | None]:
        """Drive along a path by the dynamic window, until near the goal.

        Returns:
            Why it ended, None where it came near; and a path to follow from there, where there is a
            simple one that can be followed without a stop.
        """
        config, robot = self.config, self.nav_map.robot
        steering = Steering(self.nav_map, path, config.window, config.control)
        index, best, since = 0, -np.inf, self.now
        while True:
            began = self.clock()
            pose, discs = self.localiser.pose, self._discs()
            index = path.follow(pose, index, 0.5)
            near = self._left(pose) < BEGIN and path.s[-1] - path.s[index] < BEGIN + TURN * np.pi
            short, halts = None, near and can_stop(robot, self.velocity, self._left(pose))
            if halts:
                short = direct_path(self.nav_map, pose, self.goal, config.path)
                short = short if short is not None and aimed(robot, short) else None
                wish = velocity_window(robot, self.velocity, config.control)[0]
            else:
                wish = steering.choose(pose, self.velocity, index, discs)
            self.step_times.append(self.clock() - began)
            if halts and (short is not None or stands(self.velocity)):
                return None, short
            if ended := self._step(wish):
                return ended, None
            if path.s[index] > best + 0.02:
                best, since = float(path.s[index]), self.now
            if self.now - since > config.patience:
                return self._stuck(discs), None

    def _dock(self, path: BasePath) -> _End | None:
        """Follow a path exactly."""
        config, robot = self.config, self.nav_map.robot
        steering = Steering(self.nav_map, path, config.window, config.control)
        docking = Docking(robot, path, config.control)
        waited = 0.0
        while not docking.finished(self.localiser.pose, self.velocity):
            began = self.clock()
            pose, discs = self.localiser.pose, self._discs()
            wish = docking.command(pose, self.velocity)
            reached = clip_velocity(robot, self.velocity, wish, config.control)
            if not steering.allows(pose, reached, discs):
                wish = velocity_window(robot, self.velocity, config.control)[0]
            self.step_times.append(self.clock() - began)
            if ended := self._step(wish):
                return ended
            waited = waited + config.control if stands(self.velocity) else 0.0
            if waited > config.patience:
                return self._stuck(discs)
        return None

    def _stuck(self, discs: Float[np.ndarray, "d 5"]) -> _End:
        near = self.judge.to_discs(self.pose, discs)
        what = "by a moving obstacle" if (near < 1.0).any() else "on the way"
        x, y, yaw = self.pose
        where = f"{what} at ({x:.2f}, {y:.2f}, {np.degrees(yaw):.0f} deg)"
        return _End(DriveEnding.STUCK, where)

    def _left(self, pose: Float[np.ndarray, "3"]) -> float:
        """Distance from a pose to the goal [m]."""
        return float(np.hypot(*(self.goal - pose)[:2]))

    def _step(self, wish: Float[np.ndarray, "3"]) -> _End | None:
        """Let one control step pass; returns why the drive ends, None where it goes on."""
        config, robot = self.config, self.nav_map.robot
        count = max(1, round(config.control / config.simulation))
        dt = config.control / count
        passed = []
        for _ in range(count):
            self.velocity = clip_velocity(robot, self.velocity, wish, dt)
            self.pose = integrate(self.pose, self.velocity, dt)
            self.now += dt
            passed.append(self.pose)
            self.times.append(self.now)
            self.poses.append(self.pose)
            self.velocities.append(self.velocity)
        self.meet(self.pose)
        mean = np.mean(self.velocities[-count:], axis=0)
        self.localiser.step(self.pose, mean, config.control)
        return self._judged(np.array(passed))

    def _judged(self, passed: Float[np.ndarray, "k 3"]) -> _End | None:
        distance, touched = self.judge.distance(passed)
        self.clearance = min(self.clearance, float(distance.min()))
        for name in touched:
            if name:
                self.hit = name
                return _End(DriveEnding.HIT, name)
        discs = self._discs()
        if len(discs):
            near = float(self.judge.to_discs(self.pose, discs).min())
            self.clearance_moving = min(self.clearance_moving, near)
            if near <= 0:
                self.hit = "a moving obstacle"
                return _End(DriveEnding.HIT, self.hit)
        return _End(DriveEnding.TIMEOUT) if self.now > self.config.timeout else None


def _with_discs(nav_map: NavigationMap, discs: Float[np.ndarray, "d 5"]) -> NavigationMap:
    """The map with discs as obstacles that stand."""
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1) / np.cos(np.pi / 12)
    old = nav_map.obstacles
    polygons = [old.polygon(k) for k in range(len(old))]
    layers, names = old.layer.tolist(), list(old.names)
    prisms = len(nav_map.prisms.outlines)
    for disc in discs:
        polygons += [disc[:2] + (disc[4] + 0.05) * ring] * prisms
        layers += range(prisms)
        names += ["a standing obstacle"] * prisms
    return navigation_map_of(
        nav_map.robot, nav_map.prisms, pack(polygons, layers, names), nav_map.floor_polygon
    )
