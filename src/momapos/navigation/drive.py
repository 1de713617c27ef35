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

from momapos.errors import SceneError
from momapos.geometry.transforms import wrap_angle
from momapos.navigation.base import limited, moved
from momapos.navigation.docking import BEGIN, Docking, aimed, can_stop, stands
from momapos.navigation.dynamic_window import Steering, WindowConfig, velocity_window
from momapos.navigation.footprint_map import Ground, ground_of
from momapos.navigation.global_path import TURN, Path, PathConfig, direct_path, plan_path
from momapos.navigation.judge import Judge
from momapos.navigation.localisation import Localiser, NoiseConfig
from momapos.navigation.outlines import pack
from momapos.protocols import Clock

if TYPE_CHECKING:
    from jaxtyping import Float

Moving: TypeAlias = "Callable[[float], Float[np.ndarray, 'd 5']]"
"""Discs at a time [s]: x [m], y [m], vx [m/s], vy [m/s], radius [m]."""
Meet: TypeAlias = "Callable[[Float[np.ndarray, '3']], None]"
"""Is told the true pose of the base."""
_NO_DISCS = np.zeros((0, 5))
_STANDING = 0.05
"""Discs slower than this are gone around [m/s]."""


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
    """Time without progress after which a new way is planned [s]."""
    replans: int = 6
    """New ways that are planned at most [-]."""
    timeout: float = 180.0
    """Time after which a drive ends [s]."""
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    path: PathConfig = field(default_factory=PathConfig)
    window: WindowConfig = field(default_factory=WindowConfig)


@dataclass(frozen=True, eq=False)
class DriveRecord:
    """What came of a drive."""

    arrived: bool
    reason: str
    """Why it did not arrive; "" where it did."""
    goal: Float[np.ndarray, "3"]
    pose: Float[np.ndarray, "3"]
    """Where the base really stands: x [m], y [m], yaw [rad]."""
    believed: Float[np.ndarray, "3"]
    """Where the controller believes it to stand."""
    hit: str
    """What the base touched, which ended the drive; "" where it touched nothing."""
    planned: float
    """Length of the way as first planned [m]; infinite where there was none."""
    length: float
    """Metres driven."""
    time: float
    """Seconds it took."""
    clearance: float
    """Smallest distance of the true footprint to anything that stands [m], at most 0.5."""
    clearance_moving: float
    """Smallest distance to what moves [m]; infinite where nothing does."""
    ways: int
    """Ways that were planned [-]."""
    times: Float[np.ndarray, " t"]
    """Of the trace [s]."""
    poses: Float[np.ndarray, "t 3"]
    """True poses."""
    velocities: Float[np.ndarray, "t 3"]
    """True velocities in the base frame: vx [m/s], vy [m/s], yaw rate [rad/s]."""
    step_times: Float[np.ndarray, " k"]
    """Computing time of each control step [s]."""


def drive(
    ground: Ground,
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
        ground: The robot and the room, see `survey`.
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
    return _Run(ground, poses[0], poses[1], rng, *around, config, clock).record()


def _nothing(_: float) -> Float[np.ndarray, "0 5"]:
    return _NO_DISCS


def _nobody(_: Float[np.ndarray, "3"]) -> None:
    return None


class _Run:
    """One drive while it lasts."""

    def __init__(
        self,
        ground: Ground,
        start: Float[np.ndarray, "3"],
        goal: Float[np.ndarray, "3"],
        rng: np.random.Generator,
        moving: Moving,
        meet: Meet,
        config: DriveConfig,
        clock: Clock,
    ) -> None:
        self.ground, self.goal, self.config, self.clock = ground, goal, config, clock
        self.moving, self.meet = moving, meet
        self.judge = Judge(ground.body, ground.obstacles, ground.floor)
        self.localiser = Localiser(start, config.noise, rng)
        self.pose, self.velocity, self.now = start, np.zeros(3), 0.0
        self.times, self.poses, self.velocities = [0.0], [start], [np.zeros(3)]
        self.step_times: list[float] = []
        self.clearance, self.clearance_moving = np.inf, np.inf
        self.hit, self.planned, self.ways = "", np.inf, 0

    def record(self) -> DriveRecord:
        reason = self._refusal() or self._ways()
        poses = np.array(self.poses)
        return DriveRecord(
            arrived=not reason,
            reason=reason,
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
        )

    def _refusal(self) -> str:
        """Why there is no point in starting; "" where there is none."""
        for name, pose in (("start", self.pose), ("goal", self.goal)):
            _, touched = self.judge.distance(pose[None])
            if touched[0]:
                return f"the {name} is in collision with {touched[0]}"
        discs = self._discs()
        if (self.judge.to_discs(self.pose, discs) <= 0).any():
            return "the start is in collision with a moving obstacle"
        self.clearance = float(self.judge.distance(self.pose[None])[0][0])
        return ""

    def _ways(self) -> str:
        """Plan a way and drive it, again where that has to be; returns why it ended, "" if well."""
        if reason := self._wait(self.config.settle):
            return reason
        # Where the dynamic window got stuck, and for the last bit, the way is followed exactly.
        exactly = False
        for self.ways in range(1, self.config.replans + 2):  # noqa: B020
            path = self._plan()
            if path is None:
                if plan_path(self.ground, self.pose, self.goal, self.config.path) is None:
                    return "there is no way for the footprint"
                # Odd fixes pass, and so do people.
                reason = "there is no way from where it believes to be"
                if len(self._standing()):
                    reason = "a moving obstacle stands in the way"
                if ended := self._wait(self.config.patience):
                    return ended
                continue
            if np.isinf(self.planned):
                self.planned = path.length
            if not exactly and self._left(self.localiser.pose) > BEGIN:
                reason, path = self._cruise(path)
                exactly = bool(reason)
            if path is not None:
                reason = self._dock(path)
                exactly = not reason
                if not reason and self._there(self.localiser.pose, 0.6):
                    return "" if self._there(self.pose, 1.0) else self._missed()
                reason = reason or "it believes to stand beside the goal"
            if reason and not reason.startswith(("stuck", "it believes")):
                return reason
        return reason

    def _there(self, pose: Float[np.ndarray, "3"], share: float) -> bool:
        """Whether a pose is within a share of the tolerance."""
        c, error = self.config, self.goal - pose
        near = float(np.hypot(error[0], error[1])) <= share * c.tolerance
        return near and abs(float(wrap_angle(error[2]))) <= share * c.turn_tolerance

    def _missed(self) -> str:
        error = self.goal - self.pose
        turn = np.degrees(abs(float(wrap_angle(error[2]))))
        return f"it stands {100 * np.hypot(*error[:2]):.1f} cm and {turn:.1f} degrees off the goal"

    def _plan(self) -> Path | None:
        """A way from where the base believes to be, around what stands in it."""
        standing = self._standing()
        ground = _with_discs(self.ground, standing) if len(standing) else self.ground
        return plan_path(ground, self.localiser.pose, self.goal, self.config.path)

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

    def _wait(self, seconds: float) -> str:
        for _ in range(int(seconds / self.config.control)):
            if ended := self._step(np.zeros(3)):
                return ended
        return ""

    def _cruise(self, path: Path) -> tuple[str, Path | None]:
        """Drive along a way by the dynamic window, until near the goal.

        Returns:
            Why it ended, "" where it came near; and a way to follow from there, where there is a
            simple one that can be followed without a stop.
        """
        config, robot = self.config, self.ground.robot
        steering = Steering(self.ground, path, config.window, config.control)
        index, best, since = 0, -np.inf, self.now
        while True:
            began = self.clock()
            pose, discs = self.localiser.pose, self._discs()
            index = path.follow(pose, index, 0.5)
            near = self._left(pose) < BEGIN and path.s[-1] - path.s[index] < BEGIN + TURN * np.pi
            short, halts = None, near and can_stop(robot, self.velocity, self._left(pose))
            if halts:
                short = direct_path(self.ground, pose, self.goal, config.path)
                short = short if short is not None and aimed(robot, short) else None
                wish = velocity_window(robot, self.velocity, config.control)[0]
            else:
                wish = steering.choose(pose, self.velocity, index, discs)
            self.step_times.append(self.clock() - began)
            if halts and (short is not None or stands(self.velocity)):
                return "", short
            if ended := self._step(wish):
                return ended, None
            if path.s[index] > best + 0.02:
                best, since = float(path.s[index]), self.now
            if self.now - since > config.patience:
                return self._stuck(discs), None

    def _dock(self, path: Path) -> str:
        """Follow a way exactly."""
        config, robot = self.config, self.ground.robot
        steering = Steering(self.ground, path, config.window, config.control)
        docking = Docking(robot, path, config.control)
        waited = 0.0
        while not docking.finished(self.localiser.pose, self.velocity):
            began = self.clock()
            pose, discs = self.localiser.pose, self._discs()
            wish = docking.command(pose, self.velocity)
            reached = limited(robot, self.velocity, wish, config.control)
            if not steering.allows(pose, reached, discs):
                wish = velocity_window(robot, self.velocity, config.control)[0]
            self.step_times.append(self.clock() - began)
            if ended := self._step(wish):
                return ended
            waited = waited + config.control if stands(self.velocity) else 0.0
            if waited > config.patience:
                return self._stuck(discs)
        return ""

    def _stuck(self, discs: Float[np.ndarray, "d 5"]) -> str:
        near = self.judge.to_discs(self.pose, discs)
        what = "by a moving obstacle" if (near < 1.0).any() else "on the way"
        x, y, yaw = self.pose
        return f"stuck {what} at ({x:.2f}, {y:.2f}, {np.degrees(yaw):.0f} deg)"

    def _left(self, pose: Float[np.ndarray, "3"]) -> float:
        """Distance from a pose to the goal [m]."""
        return float(np.hypot(*(self.goal - pose)[:2]))

    def _step(self, wish: Float[np.ndarray, "3"]) -> str:
        """Let one control step pass; returns why the drive ends, "" where it goes on."""
        config, robot = self.config, self.ground.robot
        count = max(1, round(config.control / config.simulation))
        dt = config.control / count
        passed = []
        for _ in range(count):
            self.velocity = limited(robot, self.velocity, wish, dt)
            self.pose = moved(self.pose, self.velocity, dt)
            self.now += dt
            passed.append(self.pose)
            self.times.append(self.now)
            self.poses.append(self.pose)
            self.velocities.append(self.velocity)
        self.meet(self.pose)
        mean = np.mean(self.velocities[-count:], axis=0)
        self.localiser.step(self.pose, mean, config.control)
        return self._judged(np.array(passed))

    def _judged(self, passed: Float[np.ndarray, "k 3"]) -> str:
        distance, touched = self.judge.distance(passed)
        self.clearance = min(self.clearance, float(distance.min()))
        for name in touched:
            if name:
                self.hit = name
                return f"it hit {name}"
        discs = self._discs()
        if len(discs):
            near = float(self.judge.to_discs(self.pose, discs).min())
            self.clearance_moving = min(self.clearance_moving, near)
            if near <= 0:
                self.hit = "a moving obstacle"
                return "it hit a moving obstacle"
        return "timeout" if self.now > self.config.timeout else ""


def _with_discs(ground: Ground, discs: Float[np.ndarray, "d 5"]) -> Ground:
    """The ground with discs as things that stand."""
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1) / np.cos(np.pi / 12)
    old = ground.obstacles
    polygons = [old.polygon(k) for k in range(len(old))]
    layers, names = old.layer.tolist(), list(old.names)
    prisms = len(ground.body.outlines)
    for disc in discs:
        polygons += [disc[:2] + (disc[4] + 0.05) * ring] * prisms
        layers += range(prisms)
        names += ["a standing obstacle"] * prisms
    return ground_of(ground.robot, ground.body, pack(polygons, layers, names), ground.floor)
