"""Execute a plan in physics.

The base drives from its start to the base pose. The arm motion is replanned at the pose that it
reached; a base that moves in the manipulation keeps its path, displaced to that pose. If the base
does not arrive or the arm finds no motion, the base drives to the next cheapest base pose.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import Clock, InputError, SceneError, Stopwatch, version_of
from momapos.model.records import Motion, PlacementPlan, ReachScorer
from momapos.model.robots import Robot, opened_as
from momapos.model.scene import Scene, with_assumptions
from momapos.planning import PipelineConfig, carrier_of, start_pose
from momapos.planning.grasps import task_motion
from momapos.planning.navigation import (
    DriveConfig,
    NoiseConfig,
    build_navigation_map,
    drive,
)
from momapos.simulation import (
    AttemptOutcome,
    Execution,
    ExecutionConfig,
    RetryState,
    RunRecord,
    Watch,
    attempt,
    true_world,
)

from .joint_belief import JointBeliefs, joint_beliefs
from .replanning import Drive, OnDrive, Replanner, base_triple

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()
PHYSICS = ExecutionConfig()
DRIVING = DriveConfig()
NO_NOISE = NoiseConfig(position=0.0, heading=0.0, odometry=0.0)
"""Sensors without errors."""
STAGES = ("drive", "plan", "execute")
_Execute: TypeAlias = (
    "Callable[[Float[np.ndarray, '3'], Motion, RetryState | None, bool], AttemptOutcome]"
)
"""Executes a motion; takes the base pose, the motion, the state after earlier tries, and whether it
is the last try."""
MAX_TRIES = 3
"""Maximum number of executed motions for a part with one hypothesis [-]."""


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
    allow_assumed: bool = False,
    config: PipelineConfig = DEFAULT,
    driving: DriveConfig = DRIVING,
    physics: ExecutionConfig = PHYSICS,
    seed: int = 0,
    driver: Drive | None = None,
    trace: OnDrive | None = None,
    watch: Watch | None = None,
    clock: Clock = time.perf_counter,
) -> RunRecord:
    """Execute a plan in physics.

    Args:
        plan: A solved plan for this scene and robot.
        scene: The scene, as the robot believes it.
        robot: The robot; its hand is as open as in the plan.
        reach: The robot's reachability map, for replanning.
        start: Initial base pose; by default the plan's, else the scene's.
        world: The true world, in the frame of `scene`; the scene by default. The robot plans and
            drives in the scene, and its hand acts in the world, on the part nearest to the planned
            grasp. If the scene has several `hypotheses` for that part, each motion is planned for
            the most probable one after the measurements of the hand.
        attempts: Maximum number of base poses for one motion [-].
        tries: Maximum number of executed motions [-]. A retry needs the arm back at home. Default:
            three, and one more for each further hypothesis.
        allow_assumed: Whether to execute an assumed plan, see `Status`.
        config: Configuration for replanning.
        driving: Configuration of the drives and of the sensor errors.
        physics: Configuration of the simulation.
        seed: Same seed, same run. The furniture has its own random stream, so that it does not
            depend on the drives.
        driver: Replaces `navigation.drive`.
        trace: Called after every drive.
        watch: Called during the simulation, see `attempt`.
        clock: Measures the stages.

    Raises:
        InputError: The plan is not solved, or no part of the world opens at the planned grasp.
            An assumed plan needs `allow_assumed`.
        SceneError: The robot collides at the start.
        TaskError, RobotError: Plan, scene and robot don't match.
    """
    if plan.status == "assumed" and not allow_assumed:
        raise InputError(f"the plan is 'assumed' ({plan.assumes}); allow_assumed=True executes it")
    if not plan.feasible or plan.base_pose is None:
        raise InputError(f"the plan is {plan.status!r}: there is nothing to execute")
    scene, robot = with_assumptions(scene, plan), opened_as(robot, plan.robot_rest)
    # A replanned motion must open the part exactly as far as planned.
    plan = replace(plan, task=replace(plan.task, farthest=False))
    there = None
    if world is not None:
        assert plan.motion is not None
        there = true_world(world, scene, plan.task, plan.motion.Ts_world_tool[0, :3, 3])
    of_drive, of_world = np.random.SeedSequence(seed).spawn(2)
    stopwatch = Stopwatch(clock, dict.fromkeys(STAGES, 0.0))
    driver = driver or (
        lambda ground, here, goal, rng: drive(
            ground, here, goal, rng=rng, config=driving, clock=clock
        )
    )
    with stopwatch.stage("drive"):
        robot, held = carrier_of(plan, scene, robot)
        ground = build_navigation_map(scene, robot, plan.region.keep_out, held)
    if start is None and plan.start is not None:
        start = np.array(plan.start)
    begin = start_pose(
        scene, robot, task_motion(scene, robot, plan.task, config.motion), start, ground
    )
    replanner = Replanner(
        ground, scene, plan, reach, driver, config, trace or (lambda _, __: None), stopwatch,
        np.random.default_rng(of_drive), initial=scene, held=held,
        beliefs=JointBeliefs(
            () if world is None else joint_beliefs(scene, plan.task), physics.compliance
        ),
    )  # fmt: skip
    max_tries = tries or MAX_TRIES + max(len(replanner.beliefs.beliefs) - 1, 0)

    def execute(
        here: Float[np.ndarray, "3"], motion: Motion, again: RetryState | None, last: bool
    ) -> AttemptOutcome:
        # A base that has moved does not return for another try.
        last = last or motion.moves_base
        return attempt(
            replanner.initial, robot, base_triple(here), motion, replanner.plan.task, physics,
            np.random.default_rng(of_world), true_world=replanner.true_world(there), again=again,
            way_home=None if last else replanner.home_path_planner(here),
            doubt=None if last else replanner.beliefs.contradicts,
            watch=watch, clock=clock,
        )  # fmt: skip

    executions, kinds = _execute_until_done(replanner, execute, begin, attempts, max_tries)
    return RunRecord(
        scene=plan.scene,
        robot=robot.name,
        task=plan.task,
        visits=tuple(replanner.visits),
        execution=executions[-1] if executions else None,
        failed=tuple(executions[:-1]),
        kinds=tuple(filter(None, kinds)),
        seed=seed,
        noise=driving.noise != NO_NOISE,
        time=stopwatch.seconds,
        versions={name: version_of(name) for name in ("momapos", "mujoco", "toppra")},
        true_task=None if there is None else there.task,
        assumed="" if there is not None else _assumed_kind(scene, plan),
    )


def _assumed_kind(scene: Scene, plan: PlacementPlan) -> str:
    """Return the kind of part that an assumed plan assumes; "" for a solved plan."""
    if plan.status != "assumed":
        return ""
    ways = scene.object(plan.task.object).hypotheses.get(plan.task.joint or "", ())
    return ways[0].kind if ways else "part of another type"


def _execute_until_done(
    replanner: Replanner, execute: _Execute, begin: Float[np.ndarray, "3"], attempts: int,
    max_tries: int,
) -> tuple[list[Execution], list[str]]:  # fmt: skip
    """Execute motions until one succeeds, the arm can't return home, or no motion is left.

    Args:
        replanner: BasePaths and replans.
        execute: Executes a motion.
        begin: Initial base pose x [m], y [m], yaw [rad].
        attempts: Maximum number of base poses for one motion [-].
        max_tries: Maximum number of executed motions [-].

    Returns:
        The executions, and the kind of part that each assumed.
    """
    executions: list[Execution] = []
    kinds: list[str] = []
    again: RetryState | None = None
    here, motion = replanner.drive_and_plan(begin, replanner.plan, attempts)
    while motion is not None:
        try:
            with replanner.stopwatch.stage("execute"):
                outcome = execute(here, motion, again, len(executions) + 1 >= max_tries)
        except SceneError as error:  # a collision at the start, which only exact shapes show
            replanner.visits[-1] = replace(replanner.visits[-1], reason=str(error))
            break
        executions.append(outcome.execution)
        kinds.append(replanner.beliefs.kind)
        if not outcome.at_home:
            break
        same = replanner.learn(motion, outcome)
        here, motion = replanner.retry(here, attempts, leave=same and outcome.in_the_way)
        again = RetryState(replanner.scene, outcome.value, outcome.collisions)
    return executions, kinds
