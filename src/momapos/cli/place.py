"""momapos place: where to stand and how to move."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from momapos.errors import TaskError
from momapos.importance.scorers import ScorerName

if TYPE_CHECKING:
    from momapos.importance.scorers import ImportanceConfig
    from momapos.pipeline import Answer

Method = Literal["ours", "paper", "exhaustive"]
Planner = Literal["RRTConnect", "RRTstar", "BITstar"]
_UNITS = {"": 1.0, "rad": 1.0, "deg": math.pi / 180, "m": 1.0, "cm": 0.01, "mm": 0.001}
_STATUS = {"solved": 0, "infeasible": 3, "timeout": 4}
Target = Annotated[str, arg(metavar="OBJECT[/JOINT]")]
StartArg = Annotated[str | None, arg(metavar="X,Y,YAW")]
Thing = Annotated[str, arg(metavar="OBJECT")]
ToArg = Annotated[str | None, arg(metavar="VALUE")]


@dataclass(frozen=True)
class Options:
    """What all questions share."""

    robot: str = "fetch"
    """A library robot or a robot file."""
    start: StartArg = None
    """Where the robot is now [m, m, rad or deg]; the scene's start by default."""
    method: Method = "ours"
    """ours: cheapest pose first; paper: MoMa-Pos as printed; exhaustive: a grid."""
    planner: Planner = "RRTConnect"
    """OMPL's planner for the way from home to the object."""
    scorer: ScorerName | None = None
    """How importance is measured: from where the hand goes (reach), or as the paper (deepwalk)."""
    alpha: float | None = None
    """Objects with an importance of at least this are modelled, in [0, 1]; 0: all."""
    seed: int = 0
    """Same seed, same answer."""
    timeout: float = 120.0
    """Time to search for the answer [s]; what is read and compiled before does not count."""
    out: Path | None = None
    """Write the plan here (JSON)."""
    plot: Path | None = None
    """Draw the answer here (PNG)."""
    json: bool = False
    """Print the plan as one JSON object and nothing else."""


Shared = Annotated[Options, OmitArgPrefixes]
DEFAULT = Options()


def place_open(
    scene: Positional[str],
    target: Positional[Target],
    /,
    *,
    to: ToArg = None,
    options: Shared = DEFAULT,
) -> int:
    """Open a door, a drawer or a lid.

    Args:
        scene: A scene file or the name of a built-in kitchen.
        target: The object, and the joint where it has several.
        to: How far, as 90deg, 1.2rad, 0.3m or 30cm; a quarter turn or the whole slide by default.
    """
    return _answer("open", scene, target, to, options)


def place_close(
    scene: Positional[str],
    target: Positional[Target],
    /,
    *,
    to: ToArg = None,
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


def parse_value(text: str) -> float:
    """Read a joint value such as 90deg, 1.2, 0.3m or 30cm [rad] or [m]."""
    match = re.fullmatch(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([a-z]*)\s*", text)
    try:
        if match and match[2] in _UNITS:
            return float(match[1]) * _UNITS[match[2]]
    except ValueError:
        match = None
    raise TaskError(f"{text!r} is no value; write it as 90deg, 1.2rad, 0.3m or 30cm")


def parse_start(text: str) -> list[float]:
    """Read a base pose X,Y,YAW [m, m, rad], the yaw with a unit if it is not in radians."""
    parts = text.split(",")
    if len(parts) != 3:
        raise TaskError(f"start {text!r} is not X,Y,YAW; write it as 1.5,2.0,90deg")
    return [parse_value(part) for part in parts]


def _answer(verb: str, scene_name: str, target: str, to: str | None, options: Options) -> int:
    value = None if to is None else parse_value(to)
    begin = None if options.start is None else parse_start(options.start)
    if not options.timeout > 0:
        raise TaskError("--timeout must be > 0 seconds")

    import numpy as np

    from momapos.cache import default_cache_dir
    from momapos.cli.compile import compile_once
    from momapos.cli.console import progress
    from momapos.config import PipelineConfig
    from momapos.manipulation.planner import PlannerConfig
    from momapos.manipulation.tasks import make_task
    from momapos.pipeline import place
    from momapos.placement.place import PlaceConfig
    from momapos.reachability.store import load_or_build
    from momapos.robots.robot import load_robot
    from momapos.scene.files import load_scene

    robot = load_robot(options.robot)
    scene = load_scene(scene_name)
    for warning in scene.warnings:
        print(f"momapos: {warning}", file=sys.stderr)
    name, _, joint = target.partition("/")
    task = make_task(scene, verb, name, joint or None, value)
    with progress(f"reachability map of {robot.name}") as report:
        reach = load_or_build(robot, default_cache_dir(), report)
    at = None if begin is None else np.array(begin)
    compile_once()
    config = PipelineConfig(
        importance=_importance(options),
        place=PlaceConfig(method=options.method),
        planner=PlannerConfig(algorithm=options.planner),
        timeout=options.timeout,
    )
    answer = place(
        scene, robot, task, reach, start=at,
        config=config, seed=options.seed,
    )  # fmt: skip
    _deliver(answer, options)
    if options.plot is not None:
        from momapos.viewer.plot import draw_answer

        draw_answer(scene, answer, reach, options.plot)
    return _STATUS[answer.plan.status]


def _importance(options: Options) -> ImportanceConfig:
    """How objects are scored: as asked, and by walks in the paper's variant."""
    from momapos.importance.scorers import ImportanceConfig

    paper = "deepwalk" if options.method == "paper" else None
    asked = {"scorer": options.scorer or paper, "alpha": options.alpha}
    return ImportanceConfig(**{k: v for k, v in asked.items() if v is not None})  # type: ignore[arg-type]


def _deliver(answer: Answer, options: Options) -> None:
    import json

    from momapos.cli.console import summary
    from momapos.plans import plan_to_dict, write_plan

    if options.out is not None:
        write_plan(answer.plan, options.out)
    if options.json:
        print(json.dumps(plan_to_dict(answer.plan)))
    else:
        print(summary(answer, options.out))
