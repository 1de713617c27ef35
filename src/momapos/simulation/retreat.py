"""After a motion that failed: let go, draw back, and bring the arm home for another try."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from momapos.model import time_motion
from momapos.model.records import Motion
from momapos.model.robots import Robot

from .approach import PacedTrajectory, paced
from .arm_control import EVERYWHERE, Reference
from .config import Ending, Stage
from .entering import go_back

if TYPE_CHECKING:
    from typing import TypeAlias

    from jaxtyping import Float

    from .joint_estimate import Learned
    from .stages import ExecutionRun

WayHome: TypeAlias = "Callable[[Float[np.ndarray, ' n'], Learned], Float[np.ndarray, 'k n'] | None]"
"""Plans the arm's states from one back to home, with the part where it was left; None where it
finds no way. Asked again where something was in that way, it has the part elsewhere."""
_WAYS = 3
"""Ways home that are tried at most [-]."""
_MORE = 1.2
"""On its way back the arm stops where it bears so many times more than when it let go [-]."""
_ARRIVED = 0.05
"""The arm is back when no joint is farther from home than this [rad] or [m]."""


def retreat(run: ExecutionRun, robot: Robot, way: PacedTrajectory, way_home: WayHome) -> bool:
    """Let go and bring the arm home; whether it is there.

    Before the part has moved, the hand goes back the way that it came. Later it draws back from the
    part, against its approach, and asks for a way.
    """
    run.arm.stop()
    run.bearable, run.opening = np.inf, True
    if _let_go(run) is not None:
        return False
    run.opening = False
    run.bearable = max(1.0, _MORE * run.arm.load)
    run.aside, run.ahead = 0.0, np.zeros(3)
    if run.learned is None:
        return go_back(run, way) is None and _at_home(run, robot)
    if _draw_back(run, run.learned.value) is not None:
        return False
    for _ in range(_WAYS):
        path = way_home(run.world.data.qpos[run.world.arm_q].copy(), run.learned)
        if path is None:
            return False
        home = _timed(run, robot, path)
        if _goes_home(run, home):
            return _at_home(run, robot)
        if go_back(run, home) is not None:
            return False
    return False


def _timed(run: ExecutionRun, robot: Robot, path: Float[np.ndarray, "k n"]) -> PacedTrajectory:
    """A way home, slow where the arm is near what the robot knows of the room."""
    tool = np.array([run.arm.kinematics.at(q)[0] for q in path])
    back = Motion(path, path[-1:], np.zeros(1), tool[-1:])
    plan, _ = time_motion(robot, back, run.config.speed, run.step)
    known = run.surroundings.known
    return paced(plan, path, tool[:, :3, 3], known, run.config, careful=True)


def _goes_home(run: ExecutionRun, home: PacedTrajectory) -> bool:
    """Bring the arm along a way; whether nothing was in it."""
    run.passed = 0.0
    while run.passed < home.last:
        pace = float(home.pace[round(run.passed)])
        q, v, a = home.at(run.passed, pace)
        run.arm.go(q, v, a)
        felt = float(np.linalg.norm(run.arm.wrench[:3]))
        if run.tick(Stage.RETREAT) is not None or felt > run.config.compliance.way_force:
            run.arm.stop()
            return False
        run.passed += pace
    return True


def _let_go(run: ExecutionRun) -> Ending | None:
    """Open the hand as slowly as it closes: fingers that snap open knock the part away.

    The arm gives way meanwhile: a finger that opens against something would press with all force.
    """
    q, still = run.arm.q.copy(), np.zeros_like(run.arm.q)
    T, _ = run.arm.kinematics.at(q)
    stay = Reference(q, still, T, np.zeros(6), EVERYWHERE, EVERYWHERE)
    grip, fingers, ctrl = run.config.gripper, run.world.fingers, run.world.data.ctrl
    way = max((abs(ctrl[motor] - one.open) * one.lever for one, motor in fingers), default=0.0)
    for k in range(0 if run.world.welded else round(way / grip.speed / run.step)):
        run.close(way - grip.speed * k * run.step)
        run.arm.follow(stay)
        ending = run.tick(Stage.GRIP)
        if ending is not None:
            return ending
    return run.let_go()


def _draw_back(run: ExecutionRun, value: float) -> Ending | None:
    """Draw the hand back against its approach, as far as it came in slowly."""
    compliance = run.config.compliance
    T, _ = run.arm.kinematics.at(run.arm.q)
    back = -T[:3, :3] @ run.world.hand.approach
    q, still = run.arm.q.copy(), np.zeros_like(run.arm.q)
    twist = np.concatenate([compliance.near_speed * back, np.zeros(3)])
    count = round(compliance.near / compliance.near_speed / run.step)
    for _ in range(count):
        T = T.copy()
        T[:3, 3] += run.step * twist[:3]
        bounds = run.surroundings.bounds(run.arm.q, value)
        run.arm.follow(Reference(q, still, T, twist, EVERYWHERE, EVERYWHERE, None, bounds))
        ending = run.tick(Stage.RETREAT)
        if ending is not None:
            return ending
    return run.rest(Stage.RETREAT, run.config.settle)


def _at_home(run: ExecutionRun, robot: Robot) -> bool:
    run.rest(Stage.RETREAT, run.config.settle)
    home = robot.model.settled(dict(zip(robot.arm_joints, robot.home.tolist(), strict=True)))
    off = run.world.data.qpos[run.world.arm_q] - [home[name] for name in robot.moved_joints]
    return bool(np.abs(off).max() < _ARRIVED)
