"""momapos reach: build and evaluate reachability maps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from momapos.apps.plots import check_figure_path
from momapos.core import say
from momapos.model.robots import find_named_robot

from .options import (
    ArmOption,
    Flag,
    OptionalFile,
    OptionalFolder,
    RobotArg,
    Text,
    optional,
)

if TYPE_CHECKING:
    from pathlib import Path

    from momapos.model.robots import Robot
    from momapos.planning.reachability import ReachMap


def reach_build(
    robot: RobotArg,
    /,
    *,
    arm: ArmOption = "any",
    cache: OptionalFolder = None,
    out: OptionalFile = None,
    plot: OptionalFile = None,
    json: Flag = False,
) -> int:
    """Build a robot's reachability map, unless it is cached.

    Args:
        robot: A library robot or a robot file.
        arm: The arm of a robot with several; any: all of them.
        cache: Folder of the cache.
        out: Build the map again and write it to this file. momapos finds NAME.reach next to
            NAME.toml, and NAME.ARM.reach for one arm of several.
        plot: Draw slices of the arm's reachable space (PNG, SVG or PDF).
        json: Print one JSON object.
    """
    find_named_robot(robot)  # reports a mistyped name before anything heavy is imported
    import json as encoder
    import time

    from momapos.core import Cache, InputError, check_outputs, default_cache_dir, write_atomic
    from momapos.model.robots import load_arms
    from momapos.planning.reachability import (
        build_true_map,
        default_config,
        encode,
        load_reach_map,
        map_key,
    )

    from .console import progress

    check_outputs([out, plot], [cache])
    check_figure_path(plot)
    kept = cache or default_cache_dir()
    machines, where = load_arms(robot, arm, cache=Cache(kept)), out or kept
    for machine in machines:
        _check_map(machine)
    if (out or plot) is not None and len(machines) > 1:
        names = " or ".join(machine.arm for machine in machines)
        raise InputError(f"{out or plot} can hold the map of one arm only; give --arm {names}")
    began, worked = time.perf_counter(), time.process_time()
    for machine in machines:
        with progress(f"reachability map of {machine.title}") as report:
            if out is None:
                reach = load_reach_map(machine, where, report)
            else:
                key = map_key(machine, default_config(machine))
                reach = build_true_map(machine, progress=report, key=key)
                write_atomic(out, encode(reach))
    if plot is not None:
        _draw(machines[0], reach, plot)
    seconds, worked = time.perf_counter() - began, time.process_time() - worked
    facts = {"path": str(where), "seconds": seconds, "processor_seconds": worked}
    if json:
        arms = [machine.arm for machine in machines if machine.arm]
        say(encoder.dumps({"robot": machines[0].name, "arms": arms, **facts}))
    else:
        names = ", ".join(machine.title for machine in machines)
        say(
            f"reachability map of {names}: ready in {seconds:.1f} s "
            f"({worked:.1f} s of processor time), in {where}"
        )
    return 0


def reach_eval(
    robot: RobotArg, /, *, arm: Annotated[Text, optional("ARM")] = None, count: int = 4_000,
    seed: int = 0, cache: OptionalFolder = None, json: Flag = False,
) -> int:  # fmt: skip
    """Compare a robot's reachability map with exact inverse kinematics.

    Most poses in the ball around the shoulder are out of reach, so errors of the map matter among
    poses near the boundary of the reachable space. Their figures come first.

    Args:
        robot: A library robot or a robot file.
        arm: The arm of a robot with several (default: the first).
        count: Number of random tool poses, near the boundary and in the ball each.
        seed: Seed of the poses.
        cache: Folder of the cache.
        json: Print one JSON object.
    """
    find_named_robot(robot)
    import json as encoder
    from dataclasses import asdict

    import numpy as np

    from momapos.core import Cache, check_outputs, default_cache_dir
    from momapos.model.robots import load_robot
    from momapos.planning.reachability import evaluate, load_reach_map

    from .console import progress
    from .options import check_count, check_seed

    check_count("--count", count, 1, 10_000_000)
    check_seed(seed)
    check_outputs(folders=[cache])
    kept = cache or default_cache_dir()
    machine = load_robot(robot, arm=arm, cache=Cache(kept))
    _check_map(machine)
    with progress(f"reachability map of {machine.title}") as report:
        reach = load_reach_map(machine, kept, report)
    ik = machine.finer.ik
    near, ball = (
        asdict(evaluate(reach, machine, np.random.default_rng(seed), count, ik, near=near_boundary))
        for near_boundary in (True, False)
    )
    shares = ("accuracy", "false_positives", "misses", "reachable")
    facts = {f"{name}_near_reach": near[name] for name in shares} | ball
    if json:
        say(encoder.dumps({"robot": machine.name, "arm": machine.arm, **facts}))
    else:
        width = max(len(name) for name in facts)
        for name, value in facts.items():
            say(f"{name:<{width}}  {value:.4g}")
    return 0


def _draw(robot: Robot, reach: ReachMap, path: Path) -> None:
    from momapos.apps.plots import draw_reach, tool_axes

    axes = tool_axes(robot.approach_axis, robot.closing_axis)
    draw_reach(reach, axes, robot.reach, path, title=robot.title, footprint=robot.footprint)


def _check_map(robot: Robot) -> None:
    """Refuse an arm that can't have a reachability map.

    Raises:
        RobotError: With the reason.
    """
    from momapos.core import RobotError
    from momapos.planning.reachability import no_map

    if why := no_map(robot):
        raise RobotError(
            f"{robot.title} has no reachability map: {why}; momapos place doesn't need one"
        )
