"""momapos place ... then ...: plan several tasks in a row, from few base poses."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, get_args

from momapos.apps.plots import check_figure_path
from momapos.core import (
    OutOfTimeError,
    TaskError,
    check_outputs,
    parse_quantity,
    parse_speed,
    say,
    unknown_name,
)
from momapos.planning.placement import OURS

from .base_pose_words import parse_pose
from .bounds import ended_by_interrupt, with_time_left, within_time
from .configuration import PIPELINE
from .loading import plan_before_maps
from .options import (
    EXIT_STATUS,
    Flag,
    ObjectArg,
    PathFileArg,
    PlaceArg,
    PoseFileArg,
    SceneArg,
    Target,
    Text,
    ValueArg,
    exit_status,
    optional,
)
from .parse import parse
from .place import (
    CARRY,
    DEFAULT,
    Carrying,
    MapArg,
    Options,
    Shared,
    answer,
    read_region,
    read_scene,
    show,
    write,
)

if TYPE_CHECKING:
    from pathlib import Path

    from momapos.model.records import PlacementPlan
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.planning import PipelineConfig, Request, Tour
    from momapos.planning.reachability import ArmLength, ReachMap

SETTINGS = PIPELINE
"""Sections of the configuration that the commands read."""
THEN = "then"
TIME_PER_PLAN = 0.1
"""Time in which a plan is timed and written after the search [s]; measured with five tasks."""
USAGE = "write each further task as: then VERB OBJECT[/JOINT] [--to VALUE]"


def run_tour(words: Sequence[str]) -> int:
    """Run `open SCENE OBJECT ... then VERB OBJECT ...`.

    Args:
        words: What follows `momapos place`.

    Raises:
        InputError: The words are not a list of tasks.
    """
    verb, first, further = split(words)
    return parse(_command(verb, further), first, "momapos place")()


def split(words: Sequence[str]) -> tuple[str, list[str], list[tuple[str, str, str | None]]]:
    """Split the words into tasks.

    Options may stand anywhere; all but --to apply to all tasks.

    Returns:
        The first verb, its words and all options, and verb, target and value of every other task.

    Raises:
        InputError: A task is incomplete, or its verb is unknown.
    """
    parts: list[list[str]] = [[]]
    for word in words:
        if word == THEN:
            parts.append([])
        else:
            parts[-1].append(word)
    (verb, *first), further = parts[0] or [""], []
    _check_verb(verb)
    for part in parts[1:]:
        if len(part) < 2 or part[0].startswith("-") or part[1].startswith("-"):
            raise TaskError(f"then {' '.join(part)}: {USAGE}".replace("  ", " "))
        _check_verb(part[0])
        to, rest = _value(part[2:])
        further.append((part[0], part[1], to))
        first += rest
    return verb, first, further


def _value(words: list[str]) -> tuple[str | None, list[str]]:
    """Separate the value of --to from the other words."""
    for i, word in enumerate(words):
        if word == "--to":
            if i + 1 == len(words):
                raise TaskError(f"--to needs a value; {USAGE}")
            return words[i + 1], [*words[:i], *words[i + 2 :]]
        if word.startswith("--to="):
            return word.removeprefix("--to="), [*words[:i], *words[i + 1 :]]
    return None, words


def _check_verb(verb: str) -> None:
    from momapos.model.records import RequestVerb

    verbs = get_args(RequestVerb)
    if verb not in verbs:
        raise unknown_name("verb", verb, verbs, "momapos place")


def _command(verb: str, further: list[tuple[str, str, str | None]]) -> Callable[..., int]:
    """Build the command of a first verb, for tyro."""

    def place_tour(
        scene: SceneArg,
        target: Target,
        /,
        *,
        to: ValueArg = None,
        options: Carrying = CARRY,
    ) -> int:
        """Plan several tasks in a row: from one base pose, or else from as few as possible.

        Args:
            scene: A scene file or a built-in kitchen.
            target: The object of the first task, and its joint if it has several.
            to: How far to move the first part; each further task may have its own --to.
        """
        return answer_tour(scene, [(verb, target, to), *further], options)

    return place_tour


def place_open(
    scene: SceneArg,
    target: Target,
    /,
    *,
    to: ValueArg = None,
    map_file: MapArg = None,
    options: Shared = DEFAULT,
) -> int:
    """Open a door, a drawer or a lid.

    Args:
        scene: A scene file or a built-in kitchen.
        target: The object, and its joint if it has several.
        to: How far to open: 90deg, 1.2rad, 0.3m, 30cm or max (default: 90 deg, or fully).
        map_file: Draw how far it opens from each base pose (PNG, SVG or PDF); takes 5 s or more.
    """
    return answer("open", scene, target, to, options, map_file, by_tour=answer_tour)


def place_close(
    scene: SceneArg,
    target: Target,
    /,
    *,
    to: ValueArg = None,
    options: Shared = DEFAULT,
) -> int:
    """Close a door, a drawer or a lid that is open in the scene.

    Args:
        scene: A scene file or a built-in kitchen.
        target: The object, and its joint if it has several.
        to: Where to stop, such as 10deg or 5cm (default: closed).
    """
    return answer("close", scene, target, to, options, by_tour=answer_tour)


def place_bring(
    scene: SceneArg,
    target: ObjectArg,
    /,
    *,
    to: PlaceArg,
    options: Carrying = CARRY,
) -> int:
    """Pick up a rigid object, carry it and put it down, with one grasp.

    Args:
        scene: A scene file or a built-in kitchen.
        target: The object.
        to: Where to: an object or a part of it as table or chest/drawer, a point as 1.2,0.4,0.75
            or with a yaw as 1.2,0.4,0.75,90deg, or an area of the scene.
    """
    return answer_tour(scene, [("bring", target, to)], options)


def place_reach(
    scene: SceneArg,
    poses: PoseFileArg,
    /,
    *,
    in_order: Flag = False,
    map_file: MapArg = None,
    options: Shared = DEFAULT,
) -> int:
    """Bring the tool to a set of poses: from one base pose, or else from as few as possible.

    Args:
        scene: A scene file or a built-in kitchen.
        poses: A JSON, YAML or CSV file of tool poses, messages of ROS among them, or an array of
            numpy.
        in_order: Keep the order of the file.
        map_file: Draw how many poses each base position serves (PNG, SVG or PDF).
    """
    check_figure_path(map_file)
    if options.base is not None:
        raise TaskError("--base does not apply to reach; leave it out")
    _refuse_tolerance(options, "reach")

    def of_scene(room: Scene) -> tuple[Callable[..., Tour], int]:
        from momapos.model.scene import load_poses
        from momapos.planning import plan_reach

        targets = load_poses(poses, room)
        return lambda robot, reach, **how: plan_reach(
            room, robot, targets, reach, in_order=in_order, **how
        ), 1

    return _answer_with(scene, (), of_scene, options, map_file)


def place_follow(
    scene: SceneArg,
    path: PathFileArg = None,
    /,
    *,
    wipe: Annotated[Text, optional("OBJECT/FACE")] = None,
    tool_width: ValueArg = None,
    tool_length: ValueArg = None,
    speed: Annotated[Text, optional("SPEED")] = None,
    options: Shared = DEFAULT,
) -> int:
    """Move the tool along a path: from one base pose, from several, or while the base moves.

    Args:
        scene: A scene file or a built-in kitchen.
        path: A file of tool poses as for reach, in their order; `"break": true` of a pose allows to
            leave the path there, to go on from another base pose.
        wipe: Instead of a path: go to and fro over a face of an object or of a part, such as
            table/top or chest/drawer/front (top, bottom, front, back, left, right).
        tool_width: Distance of the lanes of --wipe, such as 8cm.
        tool_length: How far what the hand holds stands out beyond its fingertips (default: 0).
        speed: Speed of the tool, such as 5cm/s (default: that of the path, or 25 cm/s at most).
    """
    if (path is None) == (wipe is None):
        raise TaskError("give either a file with the path or --wipe OBJECT/FACE")
    if wipe is None and (tool_width is not None or tool_length is not None):
        raise TaskError("--tool-width and --tool-length are for --wipe; leave them out")
    if wipe is not None and tool_width is None:
        raise TaskError("--wipe needs --tool-width, such as 8cm")
    _refuse_tolerance(options, "follow")
    fast = None if speed is None else parse_speed(speed, "--speed:")
    width, length = (
        parse_quantity(value or "0").length(f"{name}:")
        for name, value in (("--tool-width", tool_width), ("--tool-length", tool_length))
    )

    def of_scene(room: Scene) -> tuple[Callable[..., Tour], int]:
        from momapos.model.scene import load_path
        from momapos.planning import plan_follow
        from momapos.planning.grasps import wipe_path

        given = None if path is None else load_path(path, room)

        def plan_with(robot: Robot, reach: ReachMap | ArmLength, **how: Any) -> Tour:
            way = given or wipe_path(room, robot, str(wipe), width, tool_length=length)
            return plan_follow(
                room, robot, way if fast is None else replace(way, speed=fast), reach, **how
            )

        return plan_with, 1

    names = () if wipe is None else (wipe.partition("/")[0],)
    return _answer_with(scene, names, of_scene, options)


def _refuse_tolerance(options: Options, verb: str) -> None:
    if options.tolerance:
        raise TaskError(f"--tolerance does not apply to {verb}; leave it out")


def _request(verb: str, target: str, to: str | None) -> Request:
    from momapos.planning import Request

    name, _, joint = target.partition("/")
    return Request(verb, name, joint or None, to)  # type: ignore[arg-type]


def _check(options: Options, config: PipelineConfig) -> None:
    """Refuse options that apply to a single task.

    Raises:
        TaskError: One is given.
    """
    one = {
        "--at": options.at, "--plot": options.plot, "--robust": options.robust,
        "--grasps": options.grasps,
    }  # fmt: skip
    for name, value in one.items():
        if value is not None:
            raise TaskError(f"{name} applies to one task; plan each task alone, or leave it out")
    if config.place.method not in OURS:
        raise TaskError(
            f"several tasks need --method {' or '.join(OURS)}, not {config.place.method}"
        )


def answer_tour(
    scene_name: str, tasks: Sequence[tuple[str, str, str | None]], options: Options
) -> int:
    """Plan tasks of a verb, a target and a value each, and print and write the answer."""
    requests = [_request(*task) for task in tasks]

    def of_scene(room: Scene) -> tuple[Callable[..., Tour], int]:
        from momapos.planning import expanded, plan_tour

        def plan_with(robot: Robot, reach: ReachMap | ArmLength, **how: Any) -> Tour:
            return plan_tour(room, robot, requests, reach, **how)

        return plan_with, len(expanded(requests, room))

    return _answer_with(scene_name, [one.object for one in requests], of_scene, options)


def _answer_with(
    scene_name: str,
    names: Sequence[str],
    of_scene: Callable[[Scene], tuple[Callable[..., Tour], int]],
    options: Options,
    map_file: Path | None = None,
) -> int:
    """Plan a tour, write it and print it.

    Args:
        scene_name: A scene file or a built-in kitchen.
        names: Objects that it must have.
        of_scene: Returns what plans the tour of a robot in the scene, and the least number of plans
            that are written next to it.
        options: Options of the command.
        map_file: File of a map of the base positions that serve the tour's tool poses.
    """
    config = options.read_config()
    _check(options, config)
    start = None if options.start is None else parse_pose(options.start, "--start")
    outs = [] if options.out is None else [options.out]
    try:
        with within_time(config.timeout), ended_by_interrupt() as interrupted:
            scene = read_scene(scene_name, names, options, outs)
            plan_with, plans = of_scene(scene)
            numbers = range(1, 1 + plans)
            check_outputs([one.with_name(f"{one.stem}_{k}.json") for one in outs for k in numbers])
            tour = _plan(scene, plan_with, plans, options, config, start)
    except OutOfTimeError as late:
        say(json.dumps({"status": "timeout", "detail": str(late)}) if options.json else late)
        return EXIT_STATUS["timeout"]
    _deliver(tour, options)
    if map_file is not None:
        _draw_map(tour, config, map_file)
    if interrupted.is_set():
        raise KeyboardInterrupt
    return exit_status(tour.status, allow_assumed=options.allow_assumed)


def _draw_map(tour: Tour, config: PipelineConfig, path: Path) -> None:
    """Draw from where how many of a tour's tool poses are reached."""
    from momapos.apps.plots import draw_pose_map
    from momapos.core import Stopwatch, processor_time
    from momapos.planning import map_poses

    from .console import busy

    query = tour.steps[0].query
    assert query is not None
    poses = tuple(pose for step in tour.steps for pose in step.plan.task.poses)
    task = replace(query.task, poses=poses)
    query = replace(query, task=task, config=config, watch=Stopwatch(processor_time))
    with busy(f"{query.robot.name}: map"):
        found = map_poses(query)
    bases = [step.plan.base_pose for step in tour.steps if step.plan.base_pose is not None]
    draw_pose_map(query.scene, query.robot, poses, found, bases, path)


def _plan(
    scene: Scene,
    plan_with: Callable[..., Tour],
    plans: int,
    options: Options,
    config: PipelineConfig,
    start: list[float] | None,
) -> Tour:
    """Plan a tour with each arm, and return the best one."""
    import numpy as np

    from momapos.planning import best_tour, with_tolerance

    from .compile import ANSWER, compile_once
    from .console import busy

    region = read_region(options, scene)
    compile_once(ANSWER)

    def plan_all(arms: Sequence[tuple[Robot, ReachMap | ArmLength]], limit: float) -> list[Tour]:
        tours: list[Tour] = []
        for robot, reach in arms:
            limited = replace(config, timeout=min(config.timeout, limit * plans))
            if limit == math.inf:
                limited = with_time_left(config, later=TIME_PER_PLAN * plans)
            try:
                with busy(f"{robot.name}: planning", limited.timeout):
                    tours.append(plan_with(
                        robot, reach, region=region, config=limited,
                        start=None if start is None else np.array(start), seed=options.seed,
                    ))  # fmt: skip
            except OutOfTimeError:
                if not tours:
                    raise
                break
        return tours

    tours = plan_before_maps(
        options.robot, options.arm, plan_all, lambda found: any(t.status == "solved" for t in found)
    )
    tour = replace(best_tour(tours), seconds=sum(one.seconds for one in tours))
    if options.tolerance:
        with busy(f"{tour.steps[0].plan.robot_name}: tolerance"):
            tour = replace(tour, steps=tuple(
                with_tolerance(step, samples=options.tolerance_samples) for step in tour.steps
            ))  # fmt: skip
    return tour


def _deliver(tour: Tour, options: Options) -> None:
    if len(tour.steps) == 1 and tour.steps[0].plan.task.poses:
        written = write(tour.steps[0], options.out, as_json=options.json)
        show(written, options.out, as_json=options.json, most=False, tried="")
        return
    import json
    from pathlib import Path

    from momapos.model.plan_files import plan_to_dict, tour_of, tour_to_dict

    if options.out is not None:
        tour = tour.save(options.out)
    elif options.json:
        tour = tour.timed()
    if options.json:
        plans = [step.plan for step in tour.steps]
        file = options.out or Path("tour.json")
        record = tour_of(file, plans, tour.stops, tour.assumed, tour.status)
        say(json.dumps(tour_to_dict(record, [plan_to_dict(plan) for plan in plans])))
    else:
        say(_summary(tour, options))


def _summary(tour: Tour, options: Options) -> str:
    """Summarize a tour: each stop and its tasks, and why a task has no plan."""
    from .console import also_for_tolerance, pose_names, pose_text, summary, task_text

    name = tour.steps[0].plan.robot_name
    done = [step for step in tour.steps if step.plan.feasible]
    stops = max(tour.stops[: len(done)], default=0)
    poses = sum(len(step.plan.task.poses) for step in done)
    what = f"{poses} poses" if tour.steps[0].plan.task.poses else f"{len(done)} tasks"
    counted = f"{what} from {stops} base pose{'s' if stops != 1 else ''}"
    lines = [f"{name}: {counted}: {tour.status}", ""]
    for before, stop, step in zip((0, *tour.stops), tour.stops, done, strict=False):
        plan = step.plan
        assert plan.base_pose is not None
        if stop != before:
            here = [one.plan for at, one in zip(tour.stops, done, strict=False) if at == stop]
            lines.append(
                f"  stop {stop}      {pose_text(plan.base_pose)}; drive "
                f"{plan.navigation_cost:.2f} m{_stop_tolerance(here)}"
            )
        holds = [pose_names(plan.task)] if plan.task.poses else step.holds[:1]
        lines += [f"    {task_text(step)}; {words}" for words in holds]
        lines += [f"    assumed: {plan.assumes}"] if plan.assumes else []
        lines += [f"    note: {words}" for words in step.notes]
    lines += [f"  assumed     {words}" for words in tour.assumed]
    tolerance = also_for_tolerance(
        sum(step.plan.timing.get("tolerance", 0.0) for step in tour.steps)
    )
    lines += [f"  time        {1000 * tour.seconds:.0f} ms{tolerance}"]
    if not tour.steps[-1].plan.feasible:
        lines += ["", summary(tour.steps[-1], None)]
    if tour.unanswered:
        lines.append(f"  timeout     {tour.unanswered} further tasks have no answer yet")
    if options.out is not None:
        files = [f"{options.out.stem}_{k}.json" for k in range(1, 1 + len(tour.steps))]
        lines.append(f"  plans       {options.out}, {', '.join(files)}")
    return "\n".join(lines)


def _stop_tolerance(plans: Sequence[PlacementPlan]) -> str:
    """The tolerance of a base pose for all its tasks, if it was measured."""
    known = [plan.tolerance for plan in plans if plan.tolerance is not None]
    if not known:
        return ""
    least = min(known, key=lambda one: one.radius)
    return f"; tolerance {least}" if least.radius > 0.0 else "; no tolerance"
