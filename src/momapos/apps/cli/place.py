"""momapos place: plan a base pose and the motion of the arm."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from tyro.conf import arg

from momapos.apps.plots import check_figure_path
from momapos.core import (
    MAX,
    InputError,
    OutOfTimeError,
    TaskDoneError,
    TaskError,
    check_outputs,
    parse_quantity,
    say,
)
from momapos.model.robots import find_named_robot
from momapos.model.scene import find_scene, refuse_unknown_object
from momapos.planning.placement import OURS

from .base_pose_words import parse_base, parse_pose, parse_robust
from .bounds import with_time_left, within_time
from .configuration import NO_SETTINGS, PIPELINE, ConfigArgs, SearchOptions
from .loading import load_scene_with_joints, other_robots, plan_before_maps, print_warnings
from .options import (
    DEFAULT_SAMPLES,
    EXIT_STATUS,
    AreasArg,
    BaseArg,
    Flag,
    GraspsArg,
    JointsArg,
    MassArg,
    ObjectArg,
    OptionalFile,
    PoseArg,
    RobustArg,
    SceneArg,
    Target,
    ValueArg,
    check_samples,
    exit_status,
    optional,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from momapos.model.records import BaseRegion, Task
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.planning import PipelineConfig, PlacementResult
    from momapos.planning.reachability import ArmLength, ReachMap


@dataclass(frozen=True)
class PlacedTask:
    """The best answer of all arms."""

    scene: Scene
    task: Task
    arm: tuple[Robot, ReachMap | ArmLength]
    answer: PlacementResult
    tried: str
    """Statuses of all arms; "" for a robot with one arm."""


def with_all_time(
    answer: PlacementResult, planning: float, later: Mapping[str, float]
) -> PlacementResult:
    """Return an answer whose timing includes what was spent on others, and on more than it.

    Args:
        answer: The chosen answer.
        planning: Time of all answers: of every arm and hypothesis [s].
        later: Time of further stages [s].
    """
    timing = dict(answer.plan.timing)
    others = planning - timing.get("total", 0.0)
    more = {**({"other attempts": others} if others > 0.0 else {}), **later}
    timing |= {**more, "total": timing.get("total", 0.0) + sum(more.values())}
    return replace(answer, plan=replace(answer.plan, timing=timing))


def draw(
    found: PlacedTask,
    config: PipelineConfig,
    *,
    plot: Path | None,
    map_file: Path | None,
    seed: int,
    seconds: float | None = None,
) -> None:
    """Write the picture and the opening map, each if there is a file for it.

    Args:
        found: What to draw.
        config: How to plan.
        plot: The file of the picture.
        map_file: The file of the map.
        seed: The same seed gives the same map.
        seconds: Processor time of the command in which the map ends [s]; None for any.

    Raises:
        OutOfTimeError: The map takes longer; it is not written.
    """
    robot, reach = found.arm
    if plot is not None:
        from momapos.apps.plots import draw_answer

        draw_answer(found.scene, found.answer, reach, plot)
    if map_file is not None:
        from momapos.apps.plots import draw_opening_map
        from momapos.planning import opening_map

        from .console import progress

        with within_time(seconds), progress(f"{robot.name}: opening map") as report:
            farthest = opening_map(
                found.scene, robot, found.task, reach, config=config, seed=seed, report=report
            )
        draw_opening_map(found.scene, found.answer, farthest, map_file)


def write(answer: PlacementResult, out: Path | None, *, as_json: bool) -> PlacementResult:
    """Write the plan file, if there is one; return the answer with what files and JSON hold.

    Args:
        answer: The answer.
        out: The plan file; None for no file.
        as_json: Whether the plan is to be printed as JSON.
    """
    from momapos.model import with_times
    from momapos.model.plan_files import write_plan

    if out is not None or as_json:
        # Executors need the time of each state.
        plan = answer.with_notes().plan
        answer = replace(answer, plan=with_times(plan, answer.prepared.robot))
    if out is not None:
        write_plan(answer.plan, out)
    return answer


def show(
    answer: PlacementResult, out: Path | None, *, as_json: bool, most: bool, tried: str
) -> None:
    """Print the answer.

    Args:
        answer: The answer.
        out: The plan file; None for no file.
        as_json: Whether to print the plan as JSON.
        most: Whether the largest value was asked for.
        tried: Statuses of all arms; "" for a robot with one arm.
    """
    from momapos.model.plan_files import plan_to_dict

    from .console import summary

    if as_json:
        say(json.dumps(plan_to_dict(answer.plan)))
    else:
        say(summary(answer, out, most=most, tried=tried))


@dataclass(frozen=True)
class Options(SearchOptions):
    """Options of all tasks."""

    joint: JointsArg = ()
    """Set a joint of the scene, such as fridge/door_hinge=60deg."""
    start: PoseArg = None
    """Where the robot is now [m, m, rad or deg] (default: the scene's start)."""
    at: PoseArg = None
    """Check this base pose only: is it feasible, why not, and how far does it open?"""
    keep_in: AreasArg = ()
    """Where the base may stand, with its whole footprint: an area of the scene, a JSON file, or
    "X,Y X,Y X,Y" [m]. It may drive outside."""
    keep_out: AreasArg = ()
    """An area that the outline of the base must not touch, neither where it stands nor as it
    drives. The arm may reach over it."""
    facing: ValueArg = None
    """Largest angle between the base's x axis and the direction to the grasp, such as 45deg."""
    most_driving: ValueArg = None
    """Longest drive, such as 3m."""
    robust: RobustArg = None
    """Require that replanning succeeds from all base poses this near, such as 0.05m,3deg."""
    base: BaseArg = None
    """How the base may serve a task that no single pose serves: stops (up to three), moving (while
    the hand holds), or auto (whichever works first) (default: fixed)."""
    grasps: GraspsArg = None
    """Use only these grasps of your own: poses of the tool in the frame of what the task moves, or
    in FRAME (world, an object, a part); also files of GraspGen, Isaac Sim, GraspNet and GPD."""
    advice: Flag = True
    """Don't look for a change that makes an infeasible task feasible."""
    tolerance_samples: int = DEFAULT_SAMPLES
    """Base poses sampled to measure it."""
    out: OptionalFile = None
    """Write the plan to this JSON file."""
    plot: OptionalFile = None
    """Draw the plan to this PNG, SVG or PDF file."""
    json: Flag = False
    """Print the plan as one JSON object, and nothing else."""
    settings: ConfigArgs = NO_SETTINGS

    def __post_init__(self) -> None:
        super().__post_init__()
        check_samples(self.tolerance_samples)
        if self.tolerance_samples != DEFAULT_SAMPLES and not self.tolerance:
            raise InputError("--tolerance-samples needs --tolerance")

    def read_config(self) -> PipelineConfig:
        """Read the configuration, with what other options set.

        Raises:
            InputError: A setting is unknown, or out of range.
            TaskError: --robust is not a length and an angle, or --base not a known word.
        """
        config = self.load_config(self.settings, SETTINGS).pipeline
        if self.base is not None:
            config = replace(config, base=parse_base(self.base))
        if self.grasps is not None and config.motion.grasps.own == "too":
            grasps = replace(config.motion.grasps, own="only")
            config = replace(config, motion=replace(config.motion, grasps=grasps))
        if self.robust is None:
            return config
        radius, turn = parse_robust(self.robust)
        place = replace(config.place, robust_radius=radius, robust_turn=math.degrees(turn))
        return replace(config, place=place)

    def with_grasps(self, robot: Robot, scene: Scene, task: Task) -> Robot:
        """Return a robot with the grasps of --grasps, if they are given.

        Raises:
            InputError: The file is unusable.
        """
        if self.grasps is None:
            return robot
        from momapos.planning.grasps import load_grasps

        path, _, frame = self.grasps.partition("@")
        found = load_grasps(path, scene, robot, task, frame=frame or None)
        return robot.with_grasps(found)


@dataclass(frozen=True)
class CarryOptions(Options):
    """Options of tasks that move rigid objects."""

    lift: ValueArg = None
    """How far a rigid object is lifted and let down, such as 2cm or 0 (default: 5 cm, or less where
    it would hit something)."""
    retreat: Annotated[Literal["up", "back", "out"] | None, optional("WAY")] = None
    """How a rigid object leaves where it stands, and reversed gets there: lifted up, drawn back
    along the hand's approach, or drawn out horizontally (default: up, or else out)."""
    level: ValueArg = None
    """Largest tilt of an object in the hand, such as 15deg for a full cup (default: any)."""

    def read_config(self) -> PipelineConfig:
        """Read the configuration, with what other options set.

        Raises:
            InputError: A setting is unknown, or out of range.
            TaskError: --lift is not a length or --level not an angle, see also `Options`.
        """
        config = super().read_config()
        motion = config.motion
        if self.lift is not None:
            motion = replace(motion, lift=parse_quantity(self.lift).length("--lift:"))
        if self.retreat is not None:
            motion = replace(motion, retreat=self.retreat)
        if self.level is not None:
            level = math.degrees(parse_quantity(self.level).angle("--level:"))
            motion = replace(motion, level=level)
        return replace(config, motion=motion)


Shared = Annotated[Options, arg(name="")]
Carrying = Annotated[CarryOptions, arg(name="")]
MapArg = Annotated[OptionalFile, arg(name="map")]
DEFAULT = Options()
CARRY = CarryOptions()
SETTINGS = PIPELINE
"""Fields and tables of a configuration that the commands use."""


def place_press(
    scene: SceneArg,
    target: Target,
    /,
    *,
    to: ValueArg = None,
    options: Shared = DEFAULT,
) -> int:
    """Press a button, a rocker or a switch with the fingertips of the closed hand, and let go.

    Args:
        scene: A scene file or a built-in kitchen.
        target: The object, and its joint if it has several.
        to: How far to press: 3mm, -8deg (default: the farther limit).
    """
    return answer("press", scene, target, to, options)


def place_pick(
    scene: SceneArg,
    target: ObjectArg,
    /,
    *,
    mass: MassArg = None,
    options: Carrying = CARRY,
) -> int:
    """Pick up a rigid object.

    Args:
        scene: A scene file or a built-in kitchen.
        target: The object.
        mass: Its mass [kg] (default: that of the scene, or a guess).
    """
    return answer("pick", scene, target, None, options, mass=mass)


def place_place(
    scene: SceneArg,
    target: ObjectArg,
    /,
    *,
    mass: MassArg = None,
    options: Carrying = CARRY,
) -> int:
    """Place the rigid object that the robot holds where it stands in the scene.

    Args:
        scene: A scene file or a built-in kitchen, with the object at its goal.
        target: The object.
        mass: Its mass [kg] (default: that of the scene, or a guess).
    """
    return answer("place", scene, target, None, options, mass=mass)


def read_region(options: Options, scene: Scene) -> BaseRegion:
    """Read the restrictions of the base pose.

    Raises:
        SceneError: An area is invalid.
        TaskError: A value has the wrong unit or is negative.
    """
    from momapos.model.records import BaseRegion
    from momapos.model.scene import find_area

    facing, driving = options.facing, options.most_driving
    angle = None if facing is None else parse_quantity(facing).angle("--facing:")
    length = None if driving is None else parse_quantity(driving).length("--most-driving:")
    for what, value in (("--facing", angle), ("--most-driving", length)):
        if value is not None and not 0 <= value < math.inf:
            raise TaskError(f"{what} must be at least 0, not {value:g}")
    return BaseRegion(
        tuple(find_area(words, scene, "--keep-in") for words in options.keep_in),
        tuple(find_area(words, scene, "--keep-out") for words in options.keep_out),
        angle,
        length,
    )


def read_scene(
    name: str,
    objects: Sequence[str],
    options: Options,
    outputs: Sequence[Path | None],
    figures: Sequence[Path | None] = (),
) -> Scene:
    """Load a scene with its joints set.

    Mistyped names and unusable outputs are reported before anything heavy is imported.

    Args:
        name: A scene file or a built-in kitchen.
        objects: Names of the objects of the tasks.
        options: Options of the command.
        outputs: Files that the command writes.
        figures: Figures that it writes as well.

    Raises:
        MomaposError: A name is unknown, a file cannot be written or the scene is invalid.
    """
    check_outputs([*outputs, *figures])
    for figure in figures:
        check_figure_path(figure)
    find_named_robot(options.robot)
    path = find_scene(name)
    for one in objects:
        refuse_unknown_object(path, one)
    return load_scene_with_joints(name, options.joint)


@dataclass(frozen=True)
class _ArmQuery:
    """What each arm is planned for, besides the scene and the task."""

    start: list[float] | None
    at: list[float] | None
    region: BaseRegion
    config: PipelineConfig
    seed: int

    def plan(
        self, scene: Scene, task: Task, robot: Robot, reach: ReachMap | ArmLength
    ) -> PlacementResult:
        """Plan for one arm: from any base pose, or from the one of --at."""
        import numpy as np

        start = None if self.start is None else np.array(self.start)
        if self.at is None:
            from momapos.planning import plan_by_method

            return plan_by_method(
                scene, robot, task, reach, start=start, region=self.region, config=self.config,
                seed=self.seed,
            )  # fmt: skip
        from momapos.planning import PlacementQuery, plan_at_pose

        query = PlacementQuery(scene, robot, task, reach, start, self.config, seed=self.seed)
        return plan_at_pose(query, self.at)

    def needs_smaller_opening(self, task: Task, answers: Sequence[PlacementResult]) -> bool:
        """Whether to search for a smaller opening because no arm solves the task."""
        solved = any(answer.plan.feasible for answer in answers)
        whole = task.farthest or task.verb == "press"
        given_up = not solved and self.at is None and not whole
        return given_up and self.config.place.method in OURS


class _Answers(NamedTuple):
    """The answers of all arms."""

    arms: Sequence[tuple[Robot, ReachMap | ArmLength]]
    query: _ArmQuery
    scene: Scene
    task: Task
    answers: Sequence[PlacementResult]

    def are_solved(self) -> bool:
        """Return whether an arm has a plan."""
        return any(answer.plan.status == "solved" for answer in self.answers)


def _read_query(options: Options, scene: Scene, config: PipelineConfig) -> _ArmQuery:
    from momapos.model.records import ANYWHERE

    start = None if options.start is None else parse_pose(options.start, "--start")
    at = None if options.at is None else parse_pose(options.at, "--at")
    region = read_region(options, scene)
    if at is not None and region != ANYWHERE:
        raise TaskError("--at checks one base pose; leave out areas, --facing and --most-driving")
    if at is not None and options.robust is not None:
        raise TaskError("--at checks one base pose and reports its tolerance; leave out --robust")
    if at is not None and options.base is not None:
        raise TaskError("--at checks one base pose; leave out --base")
    return _ArmQuery(start, at, region, config, options.seed)


def answer(
    verb: str,
    scene_name: str,
    target: str,
    to: str | None,
    options: Options,
    map_file: Path | None = None,
    mass: float | None = None,
    by_tour: Callable[..., int] | None = None,
) -> int:
    """Plan one task, and print and write the answer; return the exit status.

    Args:
        verb, scene_name, target, to: The task.
        options: Options of the command.
        map_file: Where to draw how far a part opens; None for nowhere.
        mass: Mass of the object [kg]; None for that of the scene, or a guess.
        by_tour: Answers a task that takes several grasps; None where one always does.
    """
    if to is not None and to != MAX:
        parse_quantity(to)
    config = options.read_config()
    name, _, joint = target.partition("/")
    try:
        with within_time(config.timeout):
            scene = read_scene(scene_name, [name], options, [options.out], [options.plot, map_file])
            scene = scene if mass is None else scene.with_mass(name, mass)
            from momapos.planning.grasps import make_task, turns_to

            if by_tour and turns_to(scene, verb, name, joint or None, to) is not None:
                return by_tour(scene_name, [(verb, target, to)], options)
            found = _plan(scene, make_task(scene, verb, name, joint or None, to), options, config)
    except (TaskDoneError, OutOfTimeError) as end:
        status = "done" if isinstance(end, TaskDoneError) else "timeout"
        say(json.dumps({"status": status, "detail": str(end)}) if options.json else end)
        return EXIT_STATUS["solved" if status == "done" else "timeout"]
    # Files first: the reader of the output may close it at any line. The plan before the figures:
    # they can fail, and take long.
    written = write(found.answer, options.out, as_json=options.json)
    late = None
    try:
        # The default limit is for the search of the plan.
        draw(
            found, config, plot=options.plot, map_file=map_file, seed=options.seed,
            seconds=options.timeout,
        )  # fmt: skip
    except OutOfTimeError as error:
        late = error
    show(written, options.out, as_json=options.json, most=to == MAX, tried=found.tried)
    if late is not None:
        print_warnings([f"{map_file} is not written: {late}"])
        return EXIT_STATUS["timeout"]
    return exit_status(found.answer.plan.status, allow_assumed=options.allow_assumed)


def _plan(scene: Scene, task: Task, options: Options, config: PipelineConfig) -> PlacedTask:
    """Plan with each arm, and add what the options ask for."""
    from momapos.core import Stopwatch, processor_time
    from momapos.planning import cheapest, with_advice, with_max_opening, with_tolerance
    from momapos.planning.importance import WALKERS
    from momapos.workflows import plan_by_hypothesis

    from .compile import ANSWER, compile_once, rank_kernels
    from .console import busy

    walks = rank_kernels(config.ranking) if config.ranking.scorer in WALKERS else ()
    compile_once(tuple(dict.fromkeys((*ANSWER, *walks))))
    watch, spent = Stopwatch(processor_time), list[float]()

    def plan_all(arms: Sequence[tuple[Robot, ReachMap | ArmLength]], limit: float) -> _Answers:
        arms = tuple((options.with_grasps(robot, scene, task), reach) for robot, reach in arms)
        within = min(config.timeout, limit)
        query = _read_query(options, scene, (
            replace(config, timeout=within) if limit < math.inf else with_time_left(config)
        ))  # fmt: skip

        def plan(scene: Scene, task: Task) -> list[PlacementResult]:
            answers: list[PlacementResult] = []
            for arm in arms:
                try:
                    answers.append(query.plan(scene, task, *arm))
                except OutOfTimeError:
                    if not answers:
                        raise
                    break
            spent.extend(answer.plan.timing.get("total", 0.0) for answer in answers)
            return answers

        with busy(f"{arms[0][0].name}: planning", query.config.timeout):
            return _Answers(arms, query, *plan_by_hypothesis(scene, task, plan))

    quick = config.place.method in OURS and options.at is None and not task.farthest
    found = plan_before_maps(options.robot, options.arm, plan_all, _Answers.are_solved, quick=quick)
    config = with_time_left(config)
    arms, query, scene, task, answers = found
    with busy(f"{arms[0][0].name}: planning", config.timeout):
        if query.needs_smaller_opening(task, answers):
            with watch.stage("largest value"):
                answers = [with_max_opening(answer) for answer in answers]
        answer = cheapest(answers, farthest=task.farthest)
    chosen = next(arm for arm, one in zip(arms, answers, strict=False) if one is answer)
    if options.advice and query.at is None and config.place.method in OURS:
        with busy(f"{chosen[0].name}: advice"), watch.stage("advice"):
            # The user's own grasps are those of one hand.
            others = other_robots(options.robot) if options.grasps is None else iter(())
            answer = with_advice(answer, others)
    answer = with_all_time(answer, sum(spent), watch.seconds)
    if options.tolerance:
        with busy(f"{chosen[0].name}: tolerance"):
            answer = with_tolerance(answer, samples=options.tolerance_samples)
    tried = [f"{arm[0].arm}: {one.plan.status}" for arm, one in zip(arms, answers, strict=False)]
    several = ", ".join(tried) if len(arms) > 1 else ""
    return PlacedTask(scene, task, chosen, answer, several)
