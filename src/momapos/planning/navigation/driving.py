"""Closed-loop driving from pose to pose: plan, steer, dock, and record the result.

The true pose and the controller's estimate are separate. The base moves by its velocities and
limits, the controller gets noisy fixes, and an independent collision checker uses the true pose.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import Clock, SceneError, refuse_above, refuse_below
from momapos.core.geometry import wrap_angle
from momapos.model.robots import Robot

from .convex_polygons import pack
from .docking import DOCKING_DISTANCE, CarDocking, Docking, can_stop, is_aligned, is_stopped
from .dynamic_window import Steering, WindowConfig, velocity_window
from .footprint_map import NavigationMap, navigation_map_of
from .global_path import METERS_PER_RADIAN, BasePath, direct_path, plan_path
from .judge import FootprintCollisionChecker, impossible_motion
from .path_ends import PathConfig

if TYPE_CHECKING:
    from jaxtyping import Float


class DriveEnding(Enum):
    """Why a drive, or a part of one, ended before the goal."""

    START_BLOCKED = "the start is in collision with"
    GOAL_BLOCKED = "the goal is in collision with"
    NO_PATH = "there is no path for the footprint"
    NO_PATH_FROM_ESTIMATE = "there is no path from the estimated pose"
    PATH_OCCUPIED = "a moving obstacle blocks the path"
    STUCK = "stuck"
    OFF_GOAL = "the estimated pose is off the goal"
    MISSED = "it stopped"
    HIT = "it hit"
    IMPOSSIBLE = "the wheels cannot do that:"
    TIMEOUT = "timeout"


@dataclass(frozen=True, eq=False)
class DriveRecord:
    """Result and trace of a drive."""

    arrived: bool
    reason: str
    """Why it did not arrive; "" if it did."""
    goal: Float[np.ndarray, "3"]
    pose: Float[np.ndarray, "3"]
    """True final pose of the base: x [m], y [m], yaw [rad]."""
    estimated_pose: Float[np.ndarray, "3"]
    """Final pose as the controller estimates it."""
    hit: str
    """What the base touched, which ended the drive; "" for nothing."""
    planned: float
    """Length of the first planned path [m], infinite without one."""
    length: float
    """Distance driven [m]."""
    time: float
    """Duration [s]."""
    clearance: float
    """Smallest distance between the true footprint and the scene [m], at most 0.5."""
    clearance_moving: float
    """Smallest distance to moving obstacles [m], infinite without any."""
    paths: int
    """Number of planned paths [-]."""
    times: Float[np.ndarray, " t"]
    """Times of the trace [s]."""
    poses: Float[np.ndarray, "t 3"]
    """True poses."""
    velocities: Float[np.ndarray, "t 3"]
    """True velocities in the base frame: vx [m/s], vy [m/s], yaw rate [rad/s]."""
    step_times: Float[np.ndarray, " k"]
    """Computing time of each control step [s]."""
    ending: DriveEnding | None = None
    """Category of `reason`; None if it arrived."""


def clip_velocity(
    robot: Robot, now: Float[np.ndarray, "3"], wish: Float[np.ndarray, "3"], dt: float
) -> Float[np.ndarray, "3"]:
    """Return the velocity that a base reaches after some time on its way to another velocity.

    Args:
        robot: The robot, with its speed and acceleration limits. Only an omni base has vy, and the
            yaw rate of a car-like base is at most that of its least turning radius.
        now: vx [m/s], vy [m/s], yaw rate [rad/s], base frame.
        wish: The commanded velocity, likewise.
        dt: Time [s].
    """
    wish = np.array(wish, float)
    if robot.drive != "omni":
        wish[1] = 0.0
    wish[:2] *= min(1.0, robot.max_speed / max(float(np.hypot(wish[0], wish[1])), 1e-12))
    wish[2] = np.clip(wish[2], -robot.max_yaw_rate, robot.max_yaw_rate)
    change = wish - now
    step = robot.max_acceleration * dt
    change[:2] *= min(1.0, step / max(float(np.hypot(change[0], change[1])), 1e-12))
    turn = robot.max_yaw_acceleration * dt
    change[2] = np.clip(change[2], -turn, turn)
    reached = now + change
    if robot.drive == "car":
        fastest = abs(reached[0]) / robot.min_turning_radius
        reached[2] = np.clip(reached[2], -fastest, fastest)
    return reached


def integrate(
    pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"], dt: float
) -> Float[np.ndarray, "3"]:
    """Integrate a constant velocity in the base frame exactly."""
    turn = velocity[2] * dt
    # sin(t) / t and (1 - cos(t)) / t, also for t = 0
    along = np.sinc(turn / np.pi) * dt
    across = np.sinc(turn / (2 * np.pi)) * np.sin(turn / 2) * dt
    x = along * velocity[0] - across * velocity[1]
    y = across * velocity[0] + along * velocity[1]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array(
        [pose[0] + c * x - s * y, pose[1] + s * x + c * y, float(wrap_angle(pose[2] + turn))]
    )


@dataclass(frozen=True)
class NoiseConfig:
    """Noise of the robot's sensors; all errors are Gaussian and independent."""

    position: float = 0.02
    """Standard deviation of x and of y of a fix [m]."""
    heading: float = float(np.radians(1.0))
    """Standard deviation of the heading of a fix [rad]."""
    odometry: float = 0.03
    """Standard deviation of the odometry's velocities, as a share of them, drawn each step [-]."""
    fused: bool = True
    """Whether fixes are fused with odometry; otherwise the last fix is the estimate."""

    def __post_init__(self) -> None:
        refuse_below(self, 0, "position", "heading", "odometry")


class Localizer:
    """A Kalman filter with one variance for the position and one for the heading.

    Odometry predicts the pose, and a fix of the whole pose corrects it, as with any robot that
    navigates by a map. Errors of position and heading are taken as independent, except that heading
    uncertainty adds position uncertainty while driving.
    """

    def __init__(
        self, pose: Float[np.ndarray, "3"], noise: NoiseConfig, rng: np.random.Generator
    ) -> None:
        self.noise, self.rng = noise, rng
        self.variance = np.array([noise.position, noise.position, noise.heading]) ** 2
        self._of_fix = self.variance.copy()
        self.pose = self._fix(pose)

    def _fix(self, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        return pose + self.rng.normal(size=3) * np.sqrt(self._of_fix)

    def step(
        self, pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"], dt: float
    ) -> None:
        """Update the estimate after a control step.

        Args:
            pose: The true pose, which the fix measures.
            velocity: Mean true velocity in the step, which odometry measures, base frame.
            dt: Length of the step [s].
        """
        fix = self._fix(pose)
        measured = velocity * (1 + self.noise.odometry * self.rng.normal(size=3))
        if not self.noise.fused:
            self.pose = fix
            return
        self.pose = integrate(self.pose, measured, dt)
        distance = float(np.hypot(velocity[0], velocity[1])) * dt
        turn = abs(float(velocity[2])) * dt
        spread = (self.noise.odometry * distance) ** 2 + distance**2 * self.variance[2]
        self.variance += [spread, spread, (self.noise.odometry * turn) ** 2]
        total = self.variance + self._of_fix
        gain = np.divide(self.variance, total, out=np.ones(3), where=self._of_fix > 0)
        error = fix - self.pose
        error[2] = wrap_angle(error[2])
        self.pose = self.pose + gain * error
        self.variance = (1 - gain) * self.variance


MovingObstacles: TypeAlias = "Callable[[float], Float[np.ndarray, 'd 5']]"
"""Discs at a time [s]: x [m], y [m], vx [m/s], vy [m/s], radius [m]."""
PoseListener: TypeAlias = "Callable[[Float[np.ndarray, '3']], None]"
"""Called with the true pose of the base."""
_NO_DISCS = np.zeros((0, 5))
_STANDING = 0.05
"""Discs slower than this count as standing: paths lead around them [m/s]."""
_REPLANNED = (DriveEnding.STUCK, DriveEnding.OFF_GOAL)
"""After these endings a new path is planned from the present pose."""


@dataclass(frozen=True)
class _End:
    ending: DriveEnding
    detail: str = ""

    @property
    def reason(self) -> str:
        return f"{self.ending.value} {self.detail}".strip()


SIMULATION_STEP = 0.02
"""Time step of the simulated base [s]."""
TURN_TOLERANCE = float(np.radians(2.0))
"""Largest difference between the true heading and the goal's on arrival [rad]."""
CONTROL_STEP = 0.06
"""Time between control steps [s]."""
SETTLE_TIME = 1.0
"""Time that the base stands at first, to localize itself [s]."""

MAX_REPLANS = 1_000
"""Bound of the number of replanned paths of one drive [-]."""


@dataclass(frozen=True)
class DriveConfig:
    """How a base is driven, and when it has arrived."""

    tolerance: float = 0.03
    """Largest distance between the true pose and the goal on arrival [m]."""
    patience: float = 4.0
    """Time without progress after which the path is replanned [s]."""
    replans: int = 6
    """Largest number of times that the path is replanned [-]."""
    timeout: float = 180.0
    """Time limit of a drive [s]."""
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    path: PathConfig = field(default_factory=PathConfig)
    window: WindowConfig = field(default_factory=WindowConfig)

    def __post_init__(self) -> None:
        refuse_below(self, 0.001, "tolerance", "timeout")
        refuse_below(self, 0, "patience", "replans")
        refuse_above(self, MAX_REPLANS, "replans")


def drive(
    nav_map: NavigationMap,
    start: Float[np.ndarray, "3"],
    goal: Float[np.ndarray, "3"],
    *,
    rng: np.random.Generator,
    moving: MovingObstacles | None = None,
    on_pose: PoseListener | None = None,
    config: DriveConfig = DriveConfig(),
    clock: Clock = time.perf_counter,
) -> DriveRecord:
    """Drive a base from a start pose to a goal pose, in closed loop.

    Args:
        nav_map: The robot and the scene, see `build_navigation_map`.
        start: True pose at the start: x [m], y [m], yaw [rad].
        goal: The pose to reach.
        rng: Source of the noise; the same state gives the same drive.
        moving: Moving obstacles; the controller sees their present state.
        on_pose: Called with the true pose at every control step, for obstacles that react to it.
        config: How to drive.
        clock: Measures the control steps.

    Raises:
        SceneError: Start or goal is not a pose, or moving obstacles are not discs.
    """
    poses = [np.array(pose, float) for pose in (start, goal)]
    for name, pose in zip(("start", "goal"), poses, strict=True):
        if pose.shape != (3,) or not np.isfinite(pose).all():
            raise SceneError(f"the {name} must be three finite numbers: x [m], y [m], yaw [rad]")
    obstacles, listener = moving or (lambda _: _NO_DISCS), on_pose or (lambda _: None)
    run = _DriveRun(nav_map, poses[0], poses[1], rng, obstacles, listener, config, clock)
    return run.record()


class _DriveRun:
    def __init__(
        self,
        nav_map: NavigationMap,
        start: Float[np.ndarray, "3"],
        goal: Float[np.ndarray, "3"],
        rng: np.random.Generator,
        moving: MovingObstacles,
        on_pose: PoseListener,
        config: DriveConfig,
        clock: Clock,
    ) -> None:
        self.nav_map, self.goal, self.config, self.clock = nav_map, goal, config, clock
        self.moving, self.on_pose = moving, on_pose
        self.judge = FootprintCollisionChecker(
            nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon
        )
        self.localizer = Localizer(start, config.noise, rng)
        self.pose, self.velocity, self.now = start, np.zeros(3), 0.0
        self.times, self.poses, self.velocities = [0.0], [start], [np.zeros(3)]
        self.step_times: list[float] = []
        self.clearance, self.clearance_moving = np.inf, np.inf
        self.hit, self.planned, self.paths = "", np.inf, 0

    def record(self) -> DriveRecord:
        end = self._blocked() or self._follow_paths()
        poses = np.array(self.poses)
        return DriveRecord(
            arrived=end is None,
            reason="" if end is None else end.reason,
            goal=self.goal,
            pose=self.pose,
            estimated_pose=self.localizer.pose,
            hit=self.hit,
            planned=self.planned,
            length=float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()),
            time=self.now,
            clearance=float(self.clearance),
            clearance_moving=float(self.clearance_moving),
            paths=self.paths,
            times=np.array(self.times),
            poses=poses,
            velocities=np.array(self.velocities),
            step_times=np.array(self.step_times),
            ending=None if end is None else end.ending,
        )

    def _blocked(self) -> _End | None:
        """Return why the drive cannot start, None if it can."""
        for ending, pose in (
            (DriveEnding.START_BLOCKED, self.pose),
            (DriveEnding.GOAL_BLOCKED, self.goal),
        ):
            _, touched = self.judge.distance(pose[None])
            if touched[0]:
                return _End(ending, touched[0])
        discs = self._discs()
        if (self.judge.disc_distances(self.pose, discs) <= 0).any():
            return _End(DriveEnding.START_BLOCKED, "a moving obstacle")
        self.clearance = float(self.judge.distance(self.pose[None])[0][0])
        return None

    def _follow_paths(self) -> _End | None:
        """Plan and drive paths until the base arrives; return why it does not, None if it does."""
        if ended := self._wait(SETTLE_TIME):
            return ended
        end: _End | None = None
        # After the dynamic window got stuck, and near the goal, the path is followed exactly. So it
        # is always by a car-like base, which would need a cusp to get back to it.
        car = self.nav_map.robot.drive == "car"
        exactly = car
        for self.paths in range(1, self.config.replans + 2):  # noqa: B020
            path = self._plan()
            if path is None:
                if plan_path(self.nav_map, self.pose, self.goal, self.config.path) is None:
                    return _End(DriveEnding.NO_PATH)
                # Outliers of the fixes pass, and so do people.
                end = _End(DriveEnding.NO_PATH_FROM_ESTIMATE)
                if len(self._standing()):
                    end = _End(DriveEnding.PATH_OCCUPIED)
                if ended := self._wait(self.config.patience):
                    return ended
                continue
            if np.isinf(self.planned):
                self.planned = path.length
            if not exactly and self._left(self.localizer.pose) > DOCKING_DISTANCE:
                end, path = self._cruise(path)
                exactly = end is not None
            if path is not None:
                end = self._dock(path)
                exactly = car or end is None
                if end is None and self._at_goal(self.localizer.pose, 0.6):
                    return None if self._at_goal(self.pose, 1.0) else self._missed()
                end = end or _End(DriveEnding.OFF_GOAL)
            if end is not None and end.ending not in _REPLANNED:
                return end
        return end

    def _at_goal(self, pose: Float[np.ndarray, "3"], share: float) -> bool:
        """Check whether a pose is within a share of the tolerance."""
        c, error = self.config, self.goal - pose
        near = float(np.hypot(error[0], error[1])) <= share * c.tolerance
        return near and abs(float(wrap_angle(error[2]))) <= share * TURN_TOLERANCE

    def _missed(self) -> _End:
        error = self.goal - self.pose
        turn = np.degrees(abs(float(wrap_angle(error[2]))))
        off = f"{100 * np.hypot(*error[:2]):.1f} cm and {turn:.1f} degrees off the goal"
        return _End(DriveEnding.MISSED, off)

    def _plan(self) -> BasePath | None:
        """Plan a path from the estimated pose, around standing obstacles."""
        standing = self._standing()
        nav_map = _with_discs(self.nav_map, standing) if len(standing) else self.nav_map
        return plan_path(nav_map, self.localizer.pose, self.goal, self.config.path)

    def _discs(self) -> Float[np.ndarray, "d 5"]:
        discs = np.asarray(self.moving(self.now), float)
        if discs.ndim != 2 or discs.shape[1] != 5 or not np.isfinite(discs).all():
            raise SceneError(
                "moving obstacles must be rows of five finite numbers: x [m], y [m], vx [m/s], "
                f"vy [m/s], radius [m]; at {self.now:.2f} s they were {discs.tolist()}"
            )
        return discs

    def _standing(self) -> Float[np.ndarray, "d 5"]:
        discs = self._discs()
        return discs[np.hypot(discs[:, 2], discs[:, 3]) < _STANDING]

    def _wait(self, seconds: float) -> _End | None:
        for _ in range(int(seconds / CONTROL_STEP)):
            if ended := self._step(np.zeros(3)):
                return ended
        return None

    def _cruise(self, path: BasePath) -> tuple[_End | None, BasePath | None]:
        """Drive along a path by the dynamic window, until near the goal.

        Returns:
            Why it ended, None near the goal; and a direct path from there if the base can follow it
            without stopping first.
        """
        config, robot = self.config, self.nav_map.robot
        steering = Steering(self.nav_map, path, config.window, CONTROL_STEP)
        index, best, since = 0, -np.inf, self.now
        while True:
            began = self.clock()
            pose, discs = self.localizer.pose, self._discs()
            index = path.follow(pose, index, 0.5)
            remaining = path.s[-1] - path.s[index]
            near = self._left(pose) < DOCKING_DISTANCE
            near = near and remaining < DOCKING_DISTANCE + METERS_PER_RADIAN * np.pi
            short, halts = None, near and can_stop(robot, self.velocity, self._left(pose))
            if halts:
                short = direct_path(self.nav_map, pose, self.goal, config.path)
                short = short if short is not None and is_aligned(robot, short) else None
                wish = velocity_window(robot, self.velocity, CONTROL_STEP)[0]
            else:
                wish = steering.choose(pose, self.velocity, index, discs)
            self.step_times.append(self.clock() - began)
            if halts and (short is not None or is_stopped(self.velocity)):
                return None, short
            if ended := self._step(wish):
                return ended, None
            if path.s[index] > best + 0.02:
                best, since = float(path.s[index]), self.now
            if self.now - since > config.patience:
                return self._stuck(discs), None

    def _dock(self, path: BasePath) -> _End | None:
        config, robot = self.config, self.nav_map.robot
        steering = Steering(self.nav_map, path, config.window, CONTROL_STEP)
        kind = CarDocking if robot.drive == "car" else Docking
        docking = kind(robot, path, CONTROL_STEP)
        waited = 0.0
        while not docking.finished(self.localizer.pose, self.velocity):
            began = self.clock()
            pose, discs = self.localizer.pose, self._discs()
            wish = docking.command(pose, self.velocity)
            reached = clip_velocity(robot, self.velocity, wish, CONTROL_STEP)
            if not steering.allows(pose, reached, docking.index, discs):
                wish = velocity_window(robot, self.velocity, CONTROL_STEP)[0]
            self.step_times.append(self.clock() - began)
            if ended := self._step(wish):
                return ended
            waited = waited + CONTROL_STEP if is_stopped(self.velocity) else 0.0
            if waited > config.patience:
                return self._stuck(discs)
        return None

    def _stuck(self, discs: Float[np.ndarray, "d 5"]) -> _End:
        near = self.judge.disc_distances(self.pose, discs)
        what = "by a moving obstacle" if (near < 1.0).any() else "on the way"
        x, y, yaw = self.pose
        where = f"{what} at ({x:.2f}, {y:.2f}, {np.degrees(yaw):.0f} deg)"
        return _End(DriveEnding.STUCK, where)

    def _left(self, pose: Float[np.ndarray, "3"]) -> float:
        return float(np.hypot(*(self.goal - pose)[:2]))

    def _step(self, wish: Float[np.ndarray, "3"]) -> _End | None:
        """Simulate one control step; return why the drive ends, None if it continues."""
        robot = self.nav_map.robot
        count = max(1, round(CONTROL_STEP / SIMULATION_STEP))
        dt = CONTROL_STEP / count
        passed = []
        for _ in range(count):
            self.velocity = clip_velocity(robot, self.velocity, wish, dt)
            self.pose = integrate(self.pose, self.velocity, dt)
            self.now += dt
            passed.append(self.pose)
            self.times.append(self.now)
            self.poses.append(self.pose)
            self.velocities.append(self.velocity)
        self.on_pose(self.pose)
        mean = np.mean(self.velocities[-count:], axis=0)
        self.localizer.step(self.pose, mean, CONTROL_STEP)
        cannot = impossible_motion(
            robot.drive, robot.min_turning_radius, np.array(self.poses[-count - 1 :])
        )
        return _End(DriveEnding.IMPOSSIBLE, cannot) if cannot else self._check(np.array(passed))

    def _check(self, passed: Float[np.ndarray, "k 3"]) -> _End | None:
        """Check the true poses; return why the drive ends, None if it continues."""
        distance, touched = self.judge.distance(passed)
        self.clearance = min(self.clearance, float(distance.min()))
        for name in touched:
            if name:
                self.hit = name
                return _End(DriveEnding.HIT, name)
        discs = self._discs()
        if len(discs):
            near = float(self.judge.disc_distances(self.pose, discs).min())
            self.clearance_moving = min(self.clearance_moving, near)
            if near <= 0:
                self.hit = "a moving obstacle"
                return _End(DriveEnding.HIT, self.hit)
        return _End(DriveEnding.TIMEOUT) if self.now > self.config.timeout else None


def _with_discs(nav_map: NavigationMap, discs: Float[np.ndarray, "d 5"]) -> NavigationMap:
    """Add discs to a map as standing obstacles."""
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
