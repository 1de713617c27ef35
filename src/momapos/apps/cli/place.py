"""momapos place: where to stand and how to move."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from momapos.apps.plots import check_picture
from momapos.core import MAX, TaskError, check_outputs, parse_quantity
from momapos.model.robots import find_named_robot
from momapos.model.scene import find_scene, refuse_unknown_object
from momapos.planning import PipelineConfig
from momapos.planning.placement import OURS

from .loading import load_arms_with_maps, load_room
from .options import (
    EXIT_STATUS,
    AreasArg,
    JointsArg,
    OptionalPath,
    PoseArg,
    RoomArg,
    Target,
    Thing,
    ValueArg,
    check_samples,
    check_seed,
    unread,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from tyro.constructors import ConstructorRegistry

    from momapos.model.records import BaseRegion, Task
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.planning import PlacementResult
    from momapos.planning.reachability import ArmLength, ReachMap


@dataclass(frozen=True)
class Options:
    """What all questions share."""

    robot: str = "fetch"
    """A library robot or a robot file."""
    arm: str = "any"
    """Which arm of a robot that has several, as left; any: the one with the cheapest answer."""
    joint: JointsArg = ()
    """A joint that stands elsewhere than in the file, as fridge/door_hinge=60deg; repeatable."""
    start: PoseArg = None
    """Where the robot is now [m, m, rad or deg]; the scene's start by default."""
    at: PoseArg = None
    """Ask about this base pose alone [m, m, rad or deg]: feasible, or why not, and how far then."""
    keep_in: AreasArg = ()
    """An area in which the base has to stand: a name in the scene, a JSON file of corners, or
    "X,Y X,Y X,Y" [m]; repeatable, one of them is enough."""
    keep_out: AreasArg = ()
    """An area that the base may not touch; repeatable."""
    facing: ValueArg = None
    """Most angle between the base's x and the way to where the hand takes hold, as 45deg."""
    most_driving: ValueArg = None
    """Longest drive, as 3m."""
    seed: int = 0
    """Same seed, same answer."""
    robust: RoomArg = None
    """Ask for a base pose beside which the robot may stand, too: so far away and turned so far to
    either side, as 0.05m,3deg."""
    tolerance: bool = True
    """Measure how far beside the base pose the robot may stand, after the answer."""
    tolerance_samples: int = 100
    """Poses beside the base pose from which the motion has to be found anew for that [-]."""
    out: OptionalPath = None
    """Write the plan here (JSON)."""
    plot: OptionalPath = None
    """Draw the answer here (PNG, SVG or PDF)."""
    json: bool = False
    """Print the plan as one JSON object and nothing else."""
    config: PipelineConfig = field(default_factory=PipelineConfig)

    def __post_init__(self) -> None:
        check_seed(self.seed)
        check_samples(self.tolerance_samples)


Shared = Annotated[Options, OmitArgPrefixes]
MapArg = Annotated[OptionalPath, arg(name="map")]
DEFAULT = Options()
_PLAIN = {f"--{item.name.replace('_', '-')}" for item in fields(Options) if item.name != "config"}
_PLAIN |= {"--to", "--map", "--no-tolerance"}


def tyro_rules(words: Sequence[str]) -> ConstructorRegistry | None:
    """How tyro reads the words of the commands below, see `unread`."""
    return unread(PipelineConfig, _PLAIN, words)


def place_open(
    scene: Positional[str],
    target: Positional[Target],
    /,
    *,
    to: ValueArg = None,
    map_file: MapArg = None,
    options: Shared = DEFAULT,
) -> int:
    """Open a door, a drawer or a lid.

    Args:
        scene: A scene file or the name of a built-in kitchen.
        target: The object, and the joint where it has several.
        to: How far: 90deg, 1.2rad, 0.3m, 30cm or max; a quarter turn or the whole slide by default.
        map_file: Draw how far it opens from everywhere (PNG, SVG or PDF); takes 5 s and more.
    """
    return _answer("open", scene, target, to, options, map_file)


def place_close(
    scene: Positional[str],
    target: Positional[Target],
    /,
    *,
    to: ValueArg = None,
    options: Shared = DEFAULT,
) -> int:
    """Close a door, a drawer or a lid that stands open in the scene.

    Args:
        scene: A scene file or the name of a built-in kitchen.
        target: The object, and the joint where it has several.
        to: How far, as 0deg or 0m; shut by default.
    """
    return _answer("close", scene, target, to, options)


def place_pick(
    scene: Positional[str], target: Positional[Thing], /, *, options: Shared = DEFAULT
) -> int:
    """Pick up a rigid object.

    Args:
        scene: A scene file or the name of a built-in kitchen.
        target: The object.
    """
    return _answer("pick", scene, target, None, options)


def place_place(
    scene: Positional[str], target: Positional[Thing], /, *, options: Shared = DEFAULT
) -> int:
    """Put a rigid object, which the robot holds, where it stands in the scene.

    Args:
        scene: A scene file or the name of a built-in kitchen, with the object where it shall be.
        target: The object.
    """
    return _answer("place", scene, target, None, options)


def parse_pose(text: str, name: str) -> list[float]:
    """Read a base pose X,Y,YAW [m, m, rad], the yaw with a unit if it is not in radians.

    Args:
        text: What was written.
        name: What it is for, such as start.
    """
    parts = text.split(",")
    if len(parts) != 3:
        raise TaskError(f"{name} {text!r} is not X,Y,YAW; write it as 1.5,2.0,90deg")
    x, y, yaw = map(parse_quantity, parts)
    if not yaw.unit and abs(yaw.value) > 2 * math.pi:
        raise TaskError(f"{name} {text!r}: a yaw of {yaw.value:g} rad; did you mean {yaw.text}deg?")
    return [x.length(f"{name}: X"), y.length(f"{name}: Y"), yaw.angle(f"{name}: YAW")]


def read_region(options: Options, scene: Scene) -> BaseRegion:
    """Where the base is allowed to stand, by the options.

    Raises:
        SceneError: An area is none.
        TaskError: A value has the wrong unit or is negative.
    """
    from momapos.model.records import BaseRegion
    from momapos.model.scene import find_area

    facing, driving = options.facing, options.most_driving
    angle = None if facing is None else parse_quantity(facing).angle("--facing:")
    length = None if driving is None else parse_quantity(driving).length("--most-driving:")
    for what, value in (("--facing", angle), ("--most-driving", length)):
        if value is not None and not 0 <= value < math.inf:
            raise TaskError(f"{what} must be a number from 0 up, not {value:g}")
    return BaseRegion(
        tuple(find_area(words, scene, "--keep-in") for words in options.keep_in),
        tuple(find_area(words, scene, "--keep-out") for words in options.keep_out),
        angle,
        length,
    )


def with_room(options: Options) -> PipelineConfig:
    """The configuration, with the room around the base pose that --robust asks for.

    Raises:
        TaskError: It is no length and angle, or negative.
    """
    if options.robust is None:
        return options.config
    parts = options.robust.split(",")
    if len(parts) != 2:
        raise TaskError(f"--robust {options.robust!r} is not LENGTH,ANGLE; write it as 0.05m,3deg")
    length, angle = (parse_quantity(part) for part in parts)
    room, turn = length.length("--robust: length"), angle.angle("--robust: angle")
    if not (0 <= room < math.inf and 0 <= turn < math.inf):
        raise TaskError(f"--robust must be two numbers from 0 up, not {options.robust}")
    place = replace(options.config.place, robust_radius=room, robust_turn=math.degrees(turn))
    return replace(options.config, place=place)


@dataclass(frozen=True)
class _Question:
    """What is asked of each arm, beside the room and the task."""

    start: list[float] | None
    at: list[float] | None
    region: BaseRegion
    config: PipelineConfig
    seed: int

    def ask(
        self, scene: Scene, task: Task, robot: Robot, reach: ReachMap | ArmLength
    ) -> PlacementResult:
        """Where this arm stands for it, or whether it can from the one base pose asked about."""
        import numpy as np

        start = None if self.start is None else np.array(self.start)
        if self.at is None:
            from momapos.planning.baselines import plan_by_method

            return plan_by_method(
                scene, robot, task, reach, start=start, region=self.region, config=self.config,
                seed=self.seed,
            )  # fmt: skip
        from momapos.planning import plan_at_base_pose

        return plan_at_base_pose(
            scene, robot, task, self.at, reach, start=start, config=self.config, seed=self.seed
        )

    def asks_for_less(self, task: Task, answers: Sequence[PlacementResult]) -> bool:
        """Whether a smaller opening is looked for where none of the answers solves the task."""
        solved = any(answer.plan.status == "solved" for answer in answers)
        given_up = not solved and self.at is None and not task.farthest
        return given_up and self.config.place.method in OURS


def _read_question(options: Options, scene: Scene, config: PipelineConfig) -> _Question:
    from momapos.model.records import ANYWHERE

    start = None if options.start is None else parse_pose(options.start, "start")
    at = None if options.at is None else parse_pose(options.at, "--at")
    region = read_region(options, scene)
    if at is not None and region != ANYWHERE:
        raise TaskError("--at names the one base pose that is asked about; leave the areas out")
    if at is not None and options.robust is not None:
        raise TaskError(
            "--at names the one base pose; its answer has the tolerance, so leave --robust out"
        )
    return _Question(start, at, region, config, options.seed)


def _answer(
    verb: str,
    scene_name: str,
    target: str,
    to: str | None,
    options: Options,
    map_file: Path | None = None,
) -> int:
    if to is not None and to != MAX:
        parse_quantity(to)
    config = with_room(options)
    check_outputs([options.out, options.plot, map_file])
    for picture in (options.plot, map_file):
        check_picture(picture)
    name, _, joint = target.partition("/")
    # A mistyped name is told before anything heavy is imported.
    find_named_robot(options.robot)
    refuse_unknown_object(find_scene(scene_name), name)

    from momapos.core import user_cache
    from momapos.planning import cheapest, smaller_opening, with_tolerance
    from momapos.planning.grasps import make_task
    from momapos.workflows import ask_in_turn

    from .compile import ANSWER, RANK, WALKS, compile_once
    from .console import busy

    cache = user_cache()
    scene = load_room(scene_name, options.joint, cache)
    task = make_task(scene, verb, name, joint or None, to)
    question = _read_question(options, scene, config)
    walks = (*RANK, *WALKS) if config.ranking.scorer == "deepwalk" else ()
    compile_once(tuple(dict.fromkeys((*ANSWER, *walks))))
    arms = tuple(zip(*load_arms_with_maps(options.robot, options.arm, cache), strict=True))

    with busy(f"{arms[0][0].name}: searching", len(arms) * config.timeout):
        scene, task, answers = ask_in_turn(
            scene, task, lambda scene, task: [question.ask(scene, task, *arm) for arm in arms]
        )
        if question.asks_for_less(task, answers):
            answers = [
                replace(answer, plan=smaller_opening(answer.plan, scene, *arm, config=config))
                for answer, arm in zip(answers, arms, strict=True)
            ]
        answer = cheapest(answers, farthest=task.farthest)
    chosen = next(arm for arm, one in zip(arms, answers, strict=True) if one is answer)
    if options.tolerance:
        with busy(f"{chosen[0].name}: tolerance"):
            answer = with_tolerance(answer, samples=options.tolerance_samples)
    # Files come first: who reads what is printed may stop reading at any line.
    _draw(scene, task, chosen, answer, options, config, map_file)
    tried = [f"{arm[0].arm}: {one.plan.status}" for arm, one in zip(arms, answers, strict=True)]
    _deliver(answer, options, most=to == MAX, tried=", ".join(tried) if len(arms) > 1 else "")
    return EXIT_STATUS[answer.plan.status]


def _draw(
    scene: Scene,
    task: Task,
    arm: tuple[Robot, ReachMap | ArmLength],
    answer: PlacementResult,
    options: Options,
    config: PipelineConfig,
    map_file: Path | None,
) -> None:
    """The pictures that were asked for."""
    robot, reach = arm
    if options.plot is not None:
        from momapos.apps.plots import draw_answer

        draw_answer(scene, answer, reach, options.plot)
    if map_file is not None:
        from momapos.apps.plots import draw_opening_map
        from momapos.planning import opening_map

        from .console import progress

        with progress(f"{robot.name}: opening map") as report:
            farthest = opening_map(
                scene, robot, task, reach, config=config, seed=options.seed, report=report
            )
        draw_opening_map(scene, answer, farthest, map_file)


def _deliver(answer: PlacementResult, options: Options, *, most: bool, tried: str) -> None:
    import json

    from momapos.model import with_times
    from momapos.model.plan_files import plan_to_dict, write_plan

    from .console import summary

    if options.out is not None or options.json:
        # For those who execute it: they need to know when the arm is where.
        answer = replace(answer, plan=with_times(answer.plan, answer.prepared.robot))
    if options.out is not None:
        write_plan(answer.plan, options.out)
    if options.json:
        print(json.dumps(plan_to_dict(answer.plan)))
    else:
        print(summary(answer, options.out, most=most, tried=tried))
