"""momapos run: execute a plan in a physics simulation."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from momapos.core import InputError, check_outputs, say

from .base_pose_words import parse_pose
from .loading import numbered, open_plans, plans_of
from .options import (
    Flag,
    OptionalCount,
    OptionalFile,
    OptionalFolder,
    OptionalRobot,
    PlanArg,
    PoseArg,
    Text,
    check_count,
    check_seed,
    optional,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from momapos.model.records import PlacementPlan
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.simulation import Execution, RunRecord, RunTrace

MAX_TRIES = 1_000
"""Bound of --tries [-]."""
MAX_COLLISIONS = 5
"""Printed collisions of a run [-]."""


def run(
    plan: PlanArg,
    /,
    *,
    scene_root: OptionalFolder = None,
    robot: OptionalRobot = None,
    start: PoseArg = None,
    world: Annotated[Text, optional("SCENE")] = None,
    world_at: PoseArg = None,
    hold: Literal["contact", "weld"] = "contact",
    exact: Flag = False,
    noise: Flag = True,
    tries: OptionalCount = None,
    allow_assumed: Flag = False,
    seed: int = 0,
    out: OptionalFile = None,
    out_scene: OptionalFile = None,
    record: OptionalFile = None,
    json: Flag = False,
) -> int:
    """Execute a plan in a physics simulation, and report the result.

    For a tour, the plans run in order, each from where the base stopped, until one fails. Records
    and films are then NAME_1, NAME_2 and so on.

    The arm motion is replanned from the pose that the base reaches. If there is none, or the base
    does not arrive, it drives to the next base pose, at most three. If a motion fails, the arm
    returns home and another grasp or base pose is tried; with --world also another hypothesis of
    the joint type.

    With --exact nothing is replanned, avoided or random: base and arm follow the states of the
    file, from its start to its path home. The run fails if the part does not move as planned, or
    anything touches what it must not.

    Exit status: 0 task done; 1 task failed; 2 unusable file or start pose.

    Args:
        plan: A plan file or a tour file.
        scene_root: Folder for files that are not next to the plan, and for models of a BestMan
            scene.
        robot: A library robot or a robot file (default: the robot of the plan).
        start: Where the robot starts [m, m, rad or deg] (default: as in the plan).
        world: The true scene, where the plan's scene is an estimate, such as a scan. The part
            nearest to the planned grasp is the one to move.
        world_at: Pose of the true scene's origin in the plan's scene [m, m, rad or deg].
        hold: contact: the fingers close and hold by friction; weld: a compliant, breakable weld at
            the grasp, for robots without fingers.
        exact: Follow the plan's own states, without replanning; so is always a plan of reach.
        noise: No sensor noise of the base, and furniture exactly as heavy as modeled.
        tries: Maximum number of executed motions (default: 3; with --world one more for each
            further hypothesis of the joint type).
        allow_assumed: Execute also a plan for a less probable joint type (status `assumed`).
        seed: The same seed gives the same run.
        out: Write the record to this JSON file.
        out_scene: Write the scene to this new file, with the joint as estimated and moved.
        record: Write a filmstrip (PNG) or a film (GIF or MP4).
        json: Print the record as one JSON object, and nothing else.
    """
    # Mistakes are reported before anything heavy is imported.
    check_seed(seed)
    files = _check_files(plan, world, out, out_scene, record)
    if exact:
        refused = {"--start": start, "--world": world, "--tries": tries, "--out-scene": out_scene}
        for name, value in refused.items():
            if value is not None:
                raise InputError(f"--exact follows the plan as it is; leave out {name}")
    if tries is not None:
        check_count("--tries", tries, 1, MAX_TRIES)
    if world is None and world_at is not None:
        raise InputError("--world-at needs --world")
    begin = None if start is None else parse_pose(start, "--start")
    at = [0.0, 0.0, 0.0] if world_at is None else parse_pose(world_at, "--world-at")

    import numpy as np

    from momapos.core import default_cache_dir, require
    from momapos.model.scene import load_scene
    from momapos.planning.reachability import load_reach

    from .console import progress

    opened = open_plans(files.plans, scene_root, robot, "to execute", allow_assumed=allow_assumed)
    if exact or any(content.task.poses for content, _, _ in opened):
        return _run_exactly(opened, files, hold, json=json)
    with require("physics"):
        from momapos.planning.navigation import DriveConfig
        from momapos.simulation import (
            BaseTrackingConfig,
            ExecutionConfig,
            FurnitureConfig,
            RunTrace,
            moved,
        )
        from momapos.workflows import NO_NOISE, run_plan

    there = None
    if world is not None:
        there = moved(load_scene(world, root=scene_root), np.array(at))
    physics = ExecutionConfig(
        hold=hold, furniture=FurnitureConfig(spread=0.3 if noise else 0.0),
        base=BaseTrackingConfig() if noise else BaseTrackingConfig(slip=0.0),
    )  # fmt: skip
    done: list[RunRecord] = []
    for k, (content, scene, machine) in enumerate(opened):
        trace = RunTrace()
        with progress(f"reachability map of {machine.name}") as report:
            reach = load_reach(machine, default_cache_dir(), report)
        result = run_plan(
            content, scene, machine, reach, start=None if begin is None else np.array(begin),
            world=there, tries=tries, allow_assumed=allow_assumed, seed=seed,
            driving=DriveConfig() if noise else DriveConfig(noise=NO_NOISE), physics=physics,
            trace=trace.drive if files.recorded else None, watch=trace if files.recorded else None,
        )  # fmt: skip
        done.append(result)
        _write_outputs(result, trace, scene, files, k, world, at)
        if not json:
            say(summary(result))
        if not result.success:
            break
        begin = None if result.final_base_pose is None else list(result.final_base_pose)
    return _finish(done, files, json=json)


def _run_exactly(
    opened: Sequence[tuple[PlacementPlan, Scene, Robot]],
    files: _Files,
    hold: Literal["contact", "weld"],
    *,
    json: bool,
) -> int:
    """Follow the states of plans in order, until one fails."""
    from momapos.core import require

    with require("physics"):
        from momapos.simulation import ExecutionConfig, RunTrace, run_exactly

    done: list[RunRecord] = []
    for k, (content, scene, machine) in enumerate(opened):
        trace = RunTrace()
        result = run_exactly(
            content, scene, machine, ExecutionConfig(hold=hold),
            watch=trace if files.recorded else None,
        )  # fmt: skip
        done.append(result)
        _write_outputs(result, trace, scene, files, k, None, [])
        if not json:
            say(summary(result))
        if not result.success:
            break
    return _finish(done, files, json=json)


@dataclass(frozen=True)
class _Files:
    """Files to read and to write."""

    plans: list[Path]
    outs: list[Path | None]
    """The record of each plan."""
    films: list[Path | None]
    out_scene: Path | None

    @property
    def recorded(self) -> bool:
        """Whether to record runs step by step."""
        return any((*self.outs, *self.films))


def _check_files(
    plan: Path, world: str | None, out: Path | None, out_scene: Path | None, film: Path | None
) -> _Files:
    check_outputs([out, film, out_scene])
    plans = plans_of(plan, "to execute")
    if len(plans) > 1 and (world is not None or out_scene is not None):
        raise InputError("--world and --out-scene need a single plan, such as one of the tour's")
    outs, films = (
        [None if path is None else numbered(path, len(plans), k) for k in range(len(plans))]
        for path in (out, film)
    )
    check_outputs([*outs, *films])
    if out_scene is not None:
        refuse_existing(out_scene)
    if film is not None:
        from momapos.simulation import check_film

        check_film(film)
    return _Files(plans, outs, films, out_scene)


def _write_outputs(
    result: RunRecord,
    trace: RunTrace,
    scene: Scene,
    files: _Files,
    k: int,
    world: str | None,
    at: list[float],
) -> None:
    """Write the outputs of the run of plan k: record, film, scene with the estimated joint."""
    import numpy as np

    from momapos.simulation import with_files, write_film, write_run
    from momapos.workflows import save_learned

    out, film = files.outs[k], files.films[k]
    if out is not None:
        there = None if world is None else np.array(at)
        named = with_files(result, out, files.plans[k], world, there)
        write_run(replace(named, motion=trace.motion()), out)
    if files.out_scene is not None and save_learned(result, scene, files.out_scene) is None:
        say(
            f"momapos: {files.out_scene}: not written: no joint was moved as planned, or only in a "
            "room that is an assumption",
            file=sys.stderr,
        )
    if film is not None:
        if result.execution is None:
            say(f"momapos: {film}: not written: nothing was executed", file=sys.stderr)
        else:
            title = f"{result.robot}: {result.task.verb} {result.task.object}"
            write_film(trace, film, ending=result.reason or result.verdict, title=title)


def _finish(done: list[RunRecord], files: _Files, *, json: bool) -> int:
    from json import dumps

    from momapos.simulation import run_to_dict

    if json:
        records = [run_to_dict(result) for result in done]
        say(dumps(records if len(files.plans) > 1 else records[0]))
    left = len(files.plans) - len(done)
    if left:
        say(f"momapos: {left} of {len(files.plans)} tasks were not started", file=sys.stderr)
    return 0 if done[-1].success else 1


def refuse_existing(out: Path) -> None:
    """Refuse to overwrite a scene.

    Raises:
        InputError: The file or its folder of copies exists.
    """
    for path in (out, out.parent / f"{out.stem}_files"):
        if path.exists():
            raise InputError(f"--out-scene {out}: {path} exists already; choose another name")


def summary(record: RunRecord) -> str:
    """Summarize a run."""
    task = record.task
    lines = [f"{record.robot}: {task.verb} {task.target}: {record.verdict}"]
    if record.assumed and record.success:
        lines.append(
            f"  assumed     the part is a {record.assumed}, which is improbable; whether the true "
            "part moves so is unknown"
        )
    if record.reason:
        lines.append(f"  reason      {record.reason}")
    for visit in record.visits:
        off = math.dist(visit.planned[:2], visit.reached[:2])
        gap = "" if visit.clearance is None else f", clearance {100 * visit.clearance:.0f} cm"
        lines.append(
            f"  drive       {visit.length:.2f} m in {visit.seconds:.0f} s{gap}, "
            f"{100 * off:.1f} cm from the planned pose"
            + (f": {visit.reason}" if visit.reason else "")
        )
    lines += [
        f"  attempt {k}   {failed.ending}, at {failed.reached:.3f} of {failed.asked:.3f}"
        + (f", as {record.kinds[k - 1]}" if record.kinds else "")
        for k, failed in enumerate(record.failed, 1)
    ]
    done = record.execution
    if done is None:
        return "\n".join(lines)
    if record.kinds:
        lines.append(f"  joint type  {record.kinds[-1]}")
    if record.true_task is not None:
        lines.append(f"  true part   {record.true_task.object}/{record.true_task.joint}")
    facts = _execution_lines(done)
    # Nothing is moved or held on the way to tool poses.
    return "\n".join(lines + (facts[2:] if task.poses else facts))


def _base_words(done: Execution) -> str:
    shift = f"{1000 * max(done.base_shift[:2]):.1f} mm, {math.degrees(done.base_shift[2]):.2f} deg"
    if done.final_base_pose is None:
        return f"moved {shift}"
    from .console import pose_text

    return f"drove to {pose_text(done.final_base_pose)}, at most {shift} off its path"


def _execution_lines(done: Execution) -> list[str]:
    lines = [
        f"  reached     {done.reached:.3f} of {done.asked:.3f}, from {done.start:.3f}",
        f"  grasp       {done.hold}; at most {done.load.force:.0f} N, {done.load.torque:.1f} Nm;"
        f" slip {1000 * done.slip.position:.1f} mm, {math.degrees(done.slip.angle):.1f} deg",
        f"  motors      tracking error at most {done.tracking.worst:.4f} rad or m, "
        f"{100 * done.tracking.effort:.0f} % of the effort limit",
        f"  base        {_base_words(done)}",
    ]
    if done.ending:
        lines.append(f"  end         {done.ending}")
    if done.joint is not None:
        lines.append(
            f"  joint       estimated {100 * done.joint.shift:.1f} cm, "
            f"{math.degrees(done.joint.tilt):.1f} deg from the model"
        )
    if done.clearance is not None:
        lines.append(f"  clearance   {100 * done.clearance:.1f} cm")
    for hit in done.collisions[:MAX_COLLISIONS]:
        lines.append(
            f"  collision   {hit.one} with {hit.other}: {hit.force:.0f} N, "
            f"{1000 * hit.depth:.1f} mm, {hit.stage} at {hit.first:.1f} s"
        )
    lines += [f"  note        {note}" for note in done.notes]
    lines.append(
        f"  time        {done.simulated:.1f} s simulated in {done.wall:.1f} s "
        f"({done.simulated / max(done.wall, 1e-9):.0f} x real time)"
    )
    return lines
