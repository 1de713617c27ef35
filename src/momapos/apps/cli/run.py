"""momapos run: carry a plan out in physics."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from momapos.core import InputError, check_outputs

from .options import OptionalCount, OptionalPath, OptionalText, PoseArg, check_seed
from .place import parse_pose
from .plan_sources import numbered, open_plans, plans_of

if TYPE_CHECKING:
    from momapos.model.scene import Scene
    from momapos.simulation import Execution, RunRecord, RunTrace

MOST_COLLISIONS = 5


def run(
    plan: Positional[Path],
    /,
    *,
    scene_root: OptionalPath = None,
    robot: OptionalText = None,
    start: PoseArg = None,
    world: OptionalText = None,
    world_at: PoseArg = None,
    hold: Literal["contact", "weld"] = "contact",
    noise: bool = True,
    tries: OptionalCount = None,
    seed: int = 0,
    out: OptionalPath = None,
    out_scene: OptionalPath = None,
    record: OptionalPath = None,
    json: bool = False,
) -> int:
    """Drive there and do it: carry a plan out in a physics engine, and say what came of it.

    Of a tour the plans are carried out one after the other, each from where the base has come to,
    until one fails; records and films are NAME_1, NAME_2 and so on.

    The arm is planned anew where the base really arrives; where it cannot, or the base does not
    arrive, the next base pose is driven to, three at most. Where a motion fails, the arm comes home
    and another grasp or base pose is tried; in a --world also another hypothesis of how the part
    moves, if the scene has several.

    Exit status: 0 the task was done, 1 it was not, 2 a file or the start cannot be used.

    Args:
        plan: The plan file, or the file of a tour.
        scene_root: Folder for names not found beside the plan, and for a BestMan scene's models.
        robot: A library robot or a robot file; by default the one that the plan names.
        start: Where the robot is at first [m, m, rad or deg]; as the plan says by default.
        world: What is really there: a scene, where the plan's own is only what the robot believes,
            as one that was scanned. The part nearest to the planned grasp is the one to open.
        world_at: Where the world's origin lies in the plan's scene [m, m, rad or deg]; the same
            place by default.
        hold: contact: the fingers close and hold by friction; weld: a compliant, breakable weld at
            the grasp, as for a robot without fingers.
        noise: Let the base believe to be where noisy sensors say, and draw how heavily the
            furniture moves; without it, both are as modeled.
        tries: Motions that are executed at most, each after one that failed; by default 3, and in a
            --world one more for each further hypothesis of how the part moves.
        seed: Same seed, same run.
        out: Write the record here (JSON).
        out_scene: Write the scene here, a new file, with the joint of the part as the arm has found
            it and where it is now.
        record: Draw a filmstrip (PNG) or a film (GIF or MP4) here.
        json: Print the record as one JSON object and nothing else.
    """
    # Told before anything heavy is imported.
    check_seed(seed)
    files = _check_files(plan, world, out, out_scene, record)
    if tries is not None and tries < 1:
        raise InputError(f"--tries {tries}: at least one motion must be tried")
    if world is None and world_at is not None:
        raise InputError("--world-at says where a --world lies; give that too, or leave it out")
    begin = None if start is None else parse_pose(start, "start")
    at = [0.0, 0.0, 0.0] if world_at is None else parse_pose(world_at, "world-at")

    import numpy as np

    from momapos.core import default_cache_dir, require, user_cache
    from momapos.model.scene import load_scene
    from momapos.planning.reachability import load_reach

    from .console import progress

    opened = open_plans(files.plans, scene_root, robot, "to execute")
    with require("physics"):
        from momapos.planning.navigation import DriveConfig
        from momapos.simulation import ExecutionConfig, FurnitureConfig, RunTrace, moved
        from momapos.workflows import QUIET, run_plan

    there = None
    if world is not None:
        there = moved(load_scene(world, root=scene_root, cache=user_cache()), np.array(at))
    physics = ExecutionConfig(hold=hold, furniture=FurnitureConfig(spread=0.3 if noise else 0.0))
    done: list[RunRecord] = []
    for k, (content, scene, machine) in enumerate(opened):
        trace = RunTrace()
        with progress(f"reachability map of {machine.name}") as report:
            reach = load_reach(machine, default_cache_dir(), report)
        result = run_plan(
            content, scene, machine, reach, start=None if begin is None else np.array(begin),
            world=there, tries=tries, seed=seed,
            driving=DriveConfig() if noise else DriveConfig(noise=QUIET), physics=physics,
            trace=trace.drive if files.watched else None, watch=trace if files.watched else None,
        )  # fmt: skip
        done.append(result)
        _keep(result, trace, scene, files, k, world, at)
        if not json:
            print(summary(result))
        if not result.success:
            break
        begin = list(result.visits[-1].reached)
    return _conclude(done, files, json=json)


@dataclass(frozen=True)
class _Files:
    """What is read and written."""

    plans: list[Path]
    outs: list[Path | None]
    """The record of each plan."""
    films: list[Path | None]
    out_scene: Path | None

    @property
    def watched(self) -> bool:
        """Whether a run is recorded step by step."""
        return any((*self.outs, *self.films))


def _check_files(
    plan: Path, world: str | None, out: Path | None, out_scene: Path | None, film: Path | None
) -> _Files:
    check_outputs([out, film, out_scene])
    plans = plans_of(plan, "to execute")
    if len(plans) > 1 and (world is not None or out_scene is not None):
        raise InputError("--world and --out-scene are for one plan; give one that the tour names")
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


def _keep(
    result: RunRecord,
    trace: RunTrace,
    scene: Scene,
    files: _Files,
    k: int,
    world: str | None,
    at: list[float],
) -> None:
    """Write what is asked for of the run of plan k: its record, its film, the scene as learned."""
    import numpy as np

    from momapos.simulation import with_files, write_film, write_run
    from momapos.workflows import save_learned

    out, film = files.outs[k], files.films[k]
    if out is not None:
        there = None if world is None else np.array(at)
        named = with_files(result, out, files.plans[k], world, there)
        write_run(replace(named, motion=trace.motion()), out)
    if film is not None:
        if result.execution is None:
            print(f"momapos: {film}: not drawn, for nothing was executed", file=sys.stderr)
        else:
            write_film(trace, film, ending="done" if result.success else result.reason)
    if files.out_scene is not None and save_learned(result, scene, files.out_scene) is None:
        print(
            f"momapos: {files.out_scene}: not written, for no joint was moved as asked",
            file=sys.stderr,
        )


def _conclude(done: list[RunRecord], files: _Files, *, json: bool) -> int:
    from json import dumps

    from momapos.simulation import run_to_dict

    if json:
        records = [run_to_dict(result) for result in done]
        print(dumps(records if len(files.plans) > 1 else records[0]))
    left = len(files.plans) - len(done)
    if left:
        print(f"momapos: {left} of {len(files.plans)} tasks were left", file=sys.stderr)
    return 0 if done[-1].success else 1


def refuse_existing(out: Path) -> None:
    """Refuse to write a scene over another.

    Raises:
        InputError: The file exists, or the folder of its copies does.
    """
    for path in (out, out.parent / f"{out.stem}_files"):
        if path.exists():
            raise InputError(f"--out-scene {out}: {path} exists already; name another file")


def summary(record: RunRecord) -> str:
    """A run in a few lines."""
    task = record.task
    what = task.object if task.joint is None else f"{task.object}/{task.joint}"
    lines = [f"{record.robot}: {task.verb} {what}: {'done' if record.success else 'failed'}"]
    if record.reason:
        lines.append(f"  because     {record.reason}")
    for visit in record.visits:
        off = math.dist(visit.planned[:2], visit.reached[:2])
        gap = "" if visit.clearance is None else f", {100 * visit.clearance:.0f} cm clear"
        lines.append(
            f"  drive       {visit.length:.2f} m in {visit.seconds:.0f} s{gap}, "
            f"{100 * off:.1f} cm off the planned pose"
            + (f": {visit.reason}" if visit.reason else "")
        )
    lines += [
        f"  try {k}       {failed.ending}, at {failed.reached:.3f} of {failed.asked:.3f}"
        + (f", as {record.kinds[k - 1]}" if record.kinds else "")
        for k, failed in enumerate(record.failed, 1)
    ]
    done = record.execution
    if done is None:
        return "\n".join(lines)
    if record.kinds:
        lines.append(f"  part        taken for a {record.kinds[-1]}")
    return "\n".join(lines + _execution_lines(done))


def _execution_lines(done: Execution) -> list[str]:
    lines = [
        f"  reached     {done.reached:.3f} of {done.asked:.3f}, from {done.start:.3f}",
        f"  hold        {done.hold}, {done.load.force:.0f} N and {done.load.torque:.1f} Nm at most;"
        f" slipped {1000 * done.slip.position:.1f} mm, {math.degrees(done.slip.angle):.1f} deg",
        f"  motors      {done.tracking.worst:.4f} rad|m off at most, "
        f"{100 * done.tracking.effort:.0f} % of the effort",
        f"  base        yielded {1000 * max(done.base_shift[:2]):.1f} mm, "
        f"{math.degrees(done.base_shift[2]):.2f} deg",
    ]
    if done.ending:
        lines.append(f"  ended       {done.ending}")
    if done.joint is not None:
        lines.append(
            f"  joint       found {100 * done.joint.shift:.1f} cm and "
            f"{math.degrees(done.joint.tilt):.1f} deg from where it is modeled"
        )
    if done.clearance is not None:
        lines.append(f"  clearance   {100 * done.clearance:.1f} cm")
    for hit in done.collisions[:MOST_COLLISIONS]:
        lines.append(
            f"  collision   {hit.one} with {hit.other}: {hit.force:.0f} N, "
            f"{1000 * hit.depth:.1f} mm, {hit.stage} at {hit.first:.1f} s"
        )
    lines += [f"  note        {note}" for note in done.notes]
    lines.append(
        f"  time        {done.simulated:.1f} s simulated in {done.wall:.1f} s "
        f"({done.simulated / max(done.wall, 1e-9):.0f} times real time)"
    )
    return lines
