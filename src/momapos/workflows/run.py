"""Drive there and do it: a plan, carried out in physics.

The base drives from its start to the base pose. On arrival the arm motion is planned anew from the
pose really reached; where the drive ends elsewhere, or the arm finds no motion, the next cheapest
base pose is driven to, from there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import Clock, InputError, SceneError, Stopwatch, version_of
from momapos.model.records import Motion, PlacementPlan, ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning import PipelineConfig, start_pose
from momapos.planning.grasps import task_motion
from momapos.planning.navigation import (
    DriveConfig,
    DriveRecord,
    NavigationMap,
    NoiseConfig,
    build_navigation_map,
    drive,
)
from momapos.simulation import (
    Again,
    Execution,
    ExecutionConfig,
    Outcome,
    RunRecord,
    Watch,
    attempt,
    true_world,
)

from .joint_belief import JointBeliefs, joint_beliefs
from .replanning import Drive, Trace, Trip, base_triple

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()
PHYSICS = ExecutionConfig()
DRIVING = DriveConfig()
QUIET = NoiseConfig(position=0.0, heading=0.0, odometry=0.0)
"""Sensors without errors."""
STAGES = ("drive", "plan", "execute")
_Execute: TypeAlias = "Callable[[Float[np.ndarray, '3'], Motion, Again | None, bool], Outcome]"
"""Executes a motion from a base pose, after what earlier tries left, as the last one or not."""
TRIES = 3
"""Motions that are executed at most, where the scene knows how the part moves [-]."""


def run_plan(
    plan: PlacementPlan,
    scene: Scene,
    robot: Robot,
    reach: ReachScorer,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    world: Scene | None = None,
    attempts: int = 3,
    tries: int | None = None,
    config: PipelineConfig = DEFAULT,
    driving: DriveConfig = DRIVING,
    physics: ExecutionConfig = PHYSICS,
    seed: int = 0,
    go: Drive | None = None,
    trace: Trace | None = None,
    watch: Watch | None = None,
    clock: Clock = time.perf_counter,
) -> RunRecord:
    """Carry out a plan.

    Args:
        plan: A solved plan for this scene and robot.
        scene: The room.
        robot: The robot.
        reach: The robot's reachability map, for planning anew.
        start: Where the base is at first; as the plan says by default, else as for `place`.
        world: What is really there, in the frame of `scene`, which is then what the robot
            believes: it plans and drives by the scene, its hand meets the world. The part nearest
            to where the plan takes hold is the one to open. As the scene says by default. Where
            the scene has several `hypotheses` of how that part moves, each motion is planned for
            the one that is the most probable after what the hand has felt.
        attempts: Base poses that are driven to for one motion at most [-].
        tries: Motions that are executed at most, one after the other, each after one that failed
            and after which the arm came home [-]; by default three, and one more for each further
            way in which the part may move.
        config: How to plan anew.
        driving: How the base drives, and how wrong its sensors are.
        physics: How to model and judge.
        seed: Same seed, same run. The furniture is drawn from a stream of its own, so that it is
            the same for every plan, however far it has to be driven.
        go: Drives in the place of `navigation.drive`.
        trace: Sees the drives.
        watch: Sees the physics, see `execute`.
        clock: Measures the stages.

    Raises:
        InputError: The plan is not solved, or nothing in the world opens where it takes hold.
        SceneError: The robot stands in something at the start.
        TaskError, RobotError: They do not fit together.
    """
    if plan.status != "solved" or plan.base_pose is None:
        raise InputError(f"the plan is {plan.status!r}: there is nothing to execute")
    # Planned anew from another pose, it must go as far as planned, no farther and no less far.
    plan = replace(plan, task=replace(plan.task, farthest=False))
    there = None
    if world is not None:
        assert plan.motion is not None
        there = true_world(world, scene, plan.task, plan.motion.Ts_world_tool[0, :3, 3])
    of_drive, of_world = np.random.SeedSequence(seed).spawn(2)
    stopwatch = Stopwatch(clock, dict.fromkeys(STAGES, 0.0))

    def by_window(
        ground: NavigationMap,
        here: Float[np.ndarray, "3"],
        goal: Float[np.ndarray, "3"],
        rng: np.random.Generator,
    ) -> DriveRecord:
        return drive(ground, here, goal, rng=rng, config=driving, clock=clock)

    with stopwatch.stage("drive"):
        ground = build_navigation_map(scene, robot)
    if start is None and plan.start is not None:
        start = np.array(plan.start)
    begin = _begin(ground, scene, plan.task, start, config)
    trip = Trip(
        ground, scene, plan, reach, go or by_window, config, trace or _unseen, stopwatch,
        np.random.default_rng(of_drive), whole=scene,
        beliefs=JointBeliefs(
            () if world is None else joint_beliefs(scene, plan.task), physics.compliance
        ),
    )  # fmt: skip
    most = tries or TRIES + max(len(trip.beliefs.beliefs) - 1, 0)

    def execute(
        here: Float[np.ndarray, "3"], motion: Motion, again: Again | None, last: bool
    ) -> Outcome:
        return attempt(
            trip.whole, robot, base_triple(here), motion, trip.plan.task, physics,
            np.random.default_rng(of_world), true_world=trip.true_world(there), again=again,
            way_home=None if last else trip.way_home(here),
            doubt=None if last else trip.beliefs.speaks_against,
            watch=watch, clock=clock,
        )  # fmt: skip

    executions, kinds = _carry_out(trip, execute, begin, attempts, most)
    return RunRecord(
        scene=plan.scene,
        robot=robot.name,
        task=plan.task,
        visits=tuple(trip.visits),
        execution=executions[-1] if executions else None,
        failed=tuple(executions[:-1]),
        kinds=tuple(filter(None, kinds)),
        seed=seed,
        noise=driving.noise != QUIET,
        time=stopwatch.seconds,
        versions={name: version_of(name) for name in ("momapos", "mujoco", "toppra")},
        true_task=None if there is None else there.task,
    )


def _carry_out(
    trip: Trip, execute: _Execute, begin: Float[np.ndarray, "3"], attempts: int, most: int
) -> tuple[list[Execution], list[str]]:
    """Execute motions, each after one that failed and after which the arm came home.

    Args:
        trip: The drives, and what the robot believes.
        execute: Executes a motion.
        begin: Where the base is at first: x [m], y [m], yaw [rad].
        attempts: Base poses that are driven to for one motion at most [-].
        most: Motions that are executed at most [-].

    Returns:
        What came of each, and as which kind it took the part.
    """
    executions: list[Execution] = []
    kinds: list[str] = []
    again: Again | None = None
    here, motion = trip.go(begin, trip.plan, attempts)
    while motion is not None:
        try:
            with trip.stopwatch.stage("execute"):
                outcome = execute(here, motion, again, len(executions) + 1 >= most)
        except SceneError as error:  # by the exact shapes of the physics, which nothing before uses
            trip.visits[-1] = replace(trip.visits[-1], reason=str(error))
            break
        executions.append(outcome.execution)
        kinds.append(trip.beliefs.kind)
        if not outcome.at_home:
            break
        same = trip.learn(motion, outcome)
        here, motion = trip.try_anew(here, attempts, elsewhere=same and outcome.in_the_way)
        again = Again(trip.scene, outcome.value, outcome.collisions)
    return executions, kinds


def _unseen(_: Float[np.ndarray, " t"], __: Float[np.ndarray, "t 3"]) -> None:
    """Nobody looks."""


def _begin(
    ground: NavigationMap,
    scene: Scene,
    task: Task,
    start: Float[np.ndarray, "3"] | None,
    config: PipelineConfig,
) -> Float[np.ndarray, "3"]:
    """Where the base is at first.

    Raises:
        SceneError: The base cannot stand there, or not with its arm at home.
    """
    robot = ground.robot
    motion = task_motion(scene, robot, task, config.motion)
    return start_pose(scene, robot, motion, start, ground)
