"""momapos solve: from a scan of a room to an opened door, all stages in one command."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from momapos.core import MAX, check_outputs, parse_quantity, require
from momapos.model.robots import find_named_robot
from momapos.planning import PipelineConfig

from .loading import load_arms_with_maps
from .options import EXIT_STATUS, Target, ValueArg, check_seed, unread
from .scan import ScanOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tyro.constructors import ConstructorRegistry

    from momapos.simulation import RunRecord
    from momapos.workflows import ScanAnswer

FORMAT, VERSION = "momapos-solve", 1
SCENE, PLAN, RUN, RECORD = "scene.json", "plan.json", "run.json", "solve.json"
CLOUD = "cloud.ply"


@dataclass(frozen=True)
class SolveOptions:
    """How to solve."""

    to: ValueArg = None
    """How far: 90deg, 1.2rad, 0.3m, 30cm or max; a quarter turn or the whole slide by default."""
    robot: str = "fetch"
    """A library robot or a robot file."""
    arm: str = "any"
    """Which arm of a robot that has several; any: the one with the cheapest answer."""
    run: bool = True
    """Carry the plan out in physics, in the room as it was modeled."""
    hold: Literal["contact", "weld"] = "contact"
    """How the hand holds in physics, see run."""
    seed: int = 0
    """Same seed, same answer."""
    tolerance: bool = True
    """Measure how far beside the base pose the robot may stand."""
    pictures: bool = True
    """Draw why every object was modeled as it was."""
    json: bool = False
    """Print the record as one JSON object and nothing else."""
    scan: ScanOptions = field(default_factory=ScanOptions)
    config: Annotated[PipelineConfig, OmitArgPrefixes] = field(default_factory=PipelineConfig)

    def __post_init__(self) -> None:
        check_seed(self.seed)


DEFAULT = SolveOptions()
_GROUPS = ("scan", "config")
_PLAIN = {
    "--out",
    *(f"--scan.{item.name.replace('_', '-')}" for item in fields(ScanOptions)),
    *(f"--{item.name}" for item in fields(SolveOptions) if item.name not in _GROUPS),
    *(f"--no-{name}" for name in ("run", "tolerance", "pictures", "json")),
}


def tyro_rules(words: Sequence[str]) -> ConstructorRegistry | None:
    """How tyro reads the words of the command, see `unread`."""
    return unread(PipelineConfig, _PLAIN, words)


def solve(
    source: Annotated[Positional[Path], arg(metavar="DIR")],
    verb: Positional[Literal["open", "close", "pick", "place"]],
    target: Positional[Target],
    /,
    *,
    out: Path,
    options: Annotated[SolveOptions, arg(name="")] = DEFAULT,
) -> int:
    """From a scan to an opened door: survey, importance, models, base pose, drive, physics.

    Where no base pose is found, more of the scan is modeled and the question is asked again. All
    that is made stays in the folder: the scene and its report, the plan, the run, and a record of
    the stages and their times.

    Exit status: 0 solved, and done where it was run; 1 the run failed; 2 input that cannot be used;
    3 no feasible base pose; 4 out of time.

    Args:
        source: Folder of posed color and depth images, a cloud, or a robot's log.
        verb: What is to be done.
        target: The object as the scan names it, and the joint where it has several.
        out: A folder for all that is made.
    """
    from json import dumps

    from momapos.model.scene import write_whole

    if options.to is not None and options.to != MAX:
        parse_quantity(options.to)
    find_named_robot(options.robot)
    answer, record = _solve(source, verb, target, out, options)
    data = _to_dict(answer, record)
    write_whole(out / RECORD, dumps(data, indent=1, allow_nan=False) + "\n")
    print(dumps(data, allow_nan=False) if options.json else _summary(answer, record, data, out))
    if record is not None and not record.success:
        return 1
    return EXIT_STATUS[answer.result.plan.status]


def _solve(
    source: Path, verb: Any, target: str, out: Path, options: SolveOptions
) -> tuple[ScanAnswer, RunRecord | None]:
    """Answer, and write everything but the record."""
    if options.run:  # told before the work
        with require("physics"):
            import momapos.workflows.run  # noqa: F401
    from momapos.core import user_cache
    from momapos.model import with_times
    from momapos.model.plan_files import write_plan
    from momapos.perception.recordings import write_cloud
    from momapos.planning import with_tolerance
    from momapos.workflows import ScanTask, solve_scan

    from .compile import ANSWER, compile_once
    from .console import progress
    from .scan import (
        detector_of,
        found_in,
        given_labels,
        given_models,
        read,
        scan_config,
        tools_for,
    )
    from .scan_report import outputs_of, report_to_dict, write_report

    scanning, given = scan_config(options.scan), given_models(options.scan)
    labels, detector = given_labels(options.scan), detector_of(options.scan)
    files, folders = outputs_of(out / SCENE, pictures=options.pictures)
    check_outputs([*files, out / CLOUD, out / PLAN, out / RUN, out / RECORD], folders)
    name, _, joint = target.partition("/")
    scan = read(source, options.scan)
    compile_once(ANSWER)
    cache = user_cache()
    arms, reach = load_arms_with_maps(options.robot, options.arm, cache)
    with progress("solve") as report:
        answer = solve_scan(
            scan, list(zip(arms, reach, strict=True)),
            ScanTask(verb, name, joint or None, options.to), out / SCENE,
            tools=tools_for(scan, options.scan, detector), found=found_in(scan, options.scan),
            labels=labels, given=given, scanning=scanning, config=options.config, seed=options.seed,
            progress=lambda what, share: report(share, what),
        )  # fmt: skip
    data = report_to_dict(answer.modeled, scan, name)
    write_report(answer.modeled, data, out / SCENE, pictures=options.pictures)
    write_cloud(answer.modeled.cloud, out / CLOUD)
    if options.tolerance:
        answer = replace(answer, result=with_tolerance(answer.result))
    result = answer.result
    robot = result.prepared.robot
    write_plan(with_times(result.plan, robot), out / PLAN)
    if result.plan.status != "solved" or not options.run:
        return answer, None
    chosen = next(k for k, one in enumerate(arms) if one.arm == robot.arm)
    return answer, _run(answer, reach[chosen], out / RUN, options)


def _run(answer: ScanAnswer, reach: Any, file: Path, options: SolveOptions) -> RunRecord:
    """Carry the plan out, and write how that went."""
    from momapos.model.scene import as_planned, load_scene
    from momapos.simulation import ExecutionConfig, RunTrace, with_files, write_run
    from momapos.workflows import run_plan

    plan, robot = answer.result.plan, answer.result.prepared.robot
    trace = RunTrace()
    record = run_plan(
        plan, as_planned(load_scene(answer.modeled.scene), plan), robot, reach,
        config=options.config, physics=ExecutionConfig(hold=options.hold), seed=options.seed,
        trace=trace.drive, watch=trace,
    )  # fmt: skip
    named = with_files(record, file, file.parent / PLAN)
    write_run(replace(named, motion=trace.motion()), file)
    return record


def _to_dict(answer: ScanAnswer, record: RunRecord | None) -> dict[str, Any]:
    """The record as plain values; times in [s]."""
    plan, timing = answer.result.plan, dict(answer.timing)
    if record is not None:
        timing |= {**record.time, "total": timing.pop("total") + sum(record.time.values())}
    return {
        "format": FORMAT,
        "version": VERSION,
        "verb": plan.task.verb, "object": plan.task.object, "joint": plan.task.joint,
        "to": plan.task.to, "robot": plan.robot_name, "method": plan.method, "seed": plan.seed,
        "status": plan.status,
        "done": None if record is None else record.success,
        "reason": "" if record is None else record.reason,
        "cloud": CLOUD, "scene": SCENE, "plan": PLAN, "run": None if record is None else RUN,
        "alphas": list(answer.alphas),
        "modeled": [d.detection.name for d in answer.modeled.decisions if d.model is not None],
        "timing": {name: round(seconds, 4) for name, seconds in timing.items()},
    }  # fmt: skip


def _summary(answer: ScanAnswer, record: RunRecord | None, data: dict[str, Any], out: Path) -> str:
    """The answer, how the run went, and where the time went."""
    from .console import summary
    from .run import summary as run_summary

    stages = ", ".join(f"{n} {s:.1f}" for n, s in data["timing"].items() if n != "total")
    again = len(answer.alphas) - 1
    lines = [summary(answer.result, out / PLAN)]
    if record is not None:
        lines += ["", run_summary(record)]
    back = f", back to the scan {again} times" if again else ""
    return "\n".join([
        *lines, "",
        f"  scan        {len(answer.modeled.decisions)} objects, {len(data['modeled'])} of them "
        f"modeled (alpha {answer.alphas[-1]:.2f}{back})",
        f"  all stages  {data['timing']['total']:.1f} s ({stages})",
        f"  record      {out / RECORD}",
    ])  # fmt: skip
