"""Let go after a failed motion, draw back, and bring the arm home for another attempt."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from momapos.model import time_motion
from momapos.model.records import Motion
from momapos.model.robots import Robot

from .approach import PacedTrajectory, pace_trajectory
from .arm_control import EVERYWHERE, Reference
from .config import NEAR_GRASP, NEAR_SPEED, PATH_FORCE, SETTLE_TIME, Ending, Stage
from .entering import go_back
from .execution_run import ExecutionRun

if TYPE_CHECKING:
    from typing import TypeAlias

    from jaxtyping import Float

    from .joint_estimate import LearnedPart

PlanHomePath: TypeAlias = (
    "Callable[[Float[np.ndarray, ' n'], LearnedPart], Float[np.ndarray, 'k n'] | None]"
)
"""Plans arm states from a given state to home, with the part at its estimated state; None without
a path. A second call means that the arm met an obstacle; the planner then assumes another part
pose."""
_MAX_HOME_PATHS = 3
"""Maximum number of paths home that are tried [-]."""
_LOAD_FACTOR = 1.2
"""Factor on the joint load after release at which the arm stops on its way back [-]."""
_HOME_TOLERANCE = 0.05
"""Maximum joint distance from home at which the arm has arrived [rad] or [m]."""


def retreat(run: ExecutionRun, robot: Robot, way: PacedTrajectory, way_home: PlanHomePath) -> bool:
    """Let go and bring the arm home; return whether it arrived.

    If the part has not moved, the hand goes back on its approach. Otherwise it draws back from the
    part, against its approach direction, and plans a path.
    """
    run.arm.stop()
    run.max_load, run.releasing = np.inf, True
    if _let_go(run) is not None:
        return False
    run.releasing = False
    run.max_load = max(1.0, _LOAD_FACTOR * run.arm.load)
    run.lateral_offset, run.forward_offset = 0.0, np.zeros(3)
    if run.learned is None:
        return go_back(run, way) is None and _at_home(run, robot)
    if _draw_back(run, run.learned.value) is not None:
        return False
    for _ in range(_MAX_HOME_PATHS):
        path = way_home(run.world.data.qpos[run.world.arm_q].copy(), run.learned)
        if path is None:
            return False
        home = _time_path(run, robot, path)
        if _follow_home(run, home):
            return _at_home(run, robot)
        if go_back(run, home) is not None:
            return False
    return False


def _time_path(run: ExecutionRun, robot: Robot, path: Float[np.ndarray, "k n"]) -> PacedTrajectory:
    """Time a path home, slow where the arm is near the known room."""
    tool = np.array([run.arm.kinematics.at(q)[0] for q in path])
    back = Motion(path, path[-1:], np.zeros(1), tool[-1:])
    plan, _ = time_motion(robot, back, run.config.speed, run.step)
    known = run.avoidance.known
    return pace_trajectory(plan, path, tool[:, :3, 3], known, run.config, careful=True)


def _follow_home(run: ExecutionRun, home: PacedTrajectory) -> bool:
    """Move the arm along a trajectory; return whether it met no obstacle."""
    run.passed = 0.0
    while run.passed < home.last:
        pace = float(home.pace[round(run.passed)])
        q, v, a = home.at(run.passed, pace)
        run.arm.go(q, v, a)
        felt = float(np.linalg.norm(run.arm.wrench[:3]))
        if run.tick(Stage.RETREAT) is not None or felt > PATH_FORCE:
            run.arm.stop()
            return False
        run.passed += pace
    return True


def _let_go(run: ExecutionRun) -> Ending | None:
    """Open the hand as slowly as it closes: fingers that snap open would knock the part away.

    The arm is compliant meanwhile: a finger that opens against an obstacle would push hard.
    """
    q, still = run.arm.q.copy(), np.zeros_like(run.arm.q)
    T, _ = run.arm.kinematics.at(q)
    stay = Reference(q, still, T, np.zeros(6), EVERYWHERE, EVERYWHERE)
    grip, fingers, ctrl = run.config.gripper, run.world.fingers, run.world.data.ctrl
    way = max((abs(ctrl[motor] - one.open) * one.lever for one, motor in fingers), default=0.0)
    for k in range(0 if run.world.welded else round(way / grip.speed / run.step)):
        run.command_fingers(way - grip.speed * k * run.step)
        run.arm.follow(stay)
        ending = run.tick(Stage.GRIP)
        if ending is not None:
            return ending
    return run.let_go()


def _draw_back(run: ExecutionRun, value: float) -> Ending | None:
    """Draw the hand back against its approach, over the distance of its slow approach."""
    T, _ = run.arm.kinematics.at(run.arm.q)
    back = -T[:3, :3] @ run.world.hand.approach
    q, still = run.arm.q.copy(), np.zeros_like(run.arm.q)
    twist = np.concatenate([NEAR_SPEED * back, np.zeros(3)])
    count = round(NEAR_GRASP / NEAR_SPEED / run.step)
    for _ in range(count):
        T = T.copy()
        T[:3, 3] += run.step * twist[:3]
        bounds = run.avoidance.bounds(run.arm.q, value)
        run.arm.follow(Reference(q, still, T, twist, EVERYWHERE, EVERYWHERE, None, bounds))
        ending = run.tick(Stage.RETREAT)
        if ending is not None:
            return ending
    return run.rest(Stage.RETREAT, SETTLE_TIME)


def _at_home(run: ExecutionRun, robot: Robot) -> bool:
    run.rest(Stage.RETREAT, SETTLE_TIME)
    home = robot.model.all_values(dict(zip(robot.arm_joints, robot.home.tolist(), strict=True)))
    off = run.world.data.qpos[run.world.arm_q] - [home[name] for name in robot.moved_joints]
    return bool(np.abs(off).max() < _HOME_TOLERANCE)
