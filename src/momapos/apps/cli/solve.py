"""momapos solve: go from a scan of a room to an executed task."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from momapos.core import MAX, InputError, check_outputs, look, parse_quantity, require, say
from momapos.model.robots import find_named_robot
from momapos.model.scene import find_scene

from .bounds import with_time_left, within_time
from .configuration import (
    NO_SETTINGS,
    PIPELINE,
    ConfigArgs,
    Configuration,
    SearchOptions,
)
from .loading import load_arms_with_maps, print_warnings
from .options import Flag, Target, Text, ValueArg, exit_status, optional
from .scan_options import DEFAULT as SCAN_DEFAULT
from .scan_options import ScanArgs

if TYPE_CHECKING:
    from momapos.planning import PipelineConfig
    from momapos.simulation import RunRecord
    from momapos.workflows import ScanAnswer

FORMAT, VERSION = "momapos-solve", 1
SCENE, PLAN, RUN, RECORD = "scene.json", "plan.json", "run.json", "solve.json"
CLOUD = "cloud.ply"


SETTINGS = (*PIPELINE, "scan")
"""Fields and tables of a configuration that the command uses."""


@dataclass(frozen=True)
class SolveOptions(SearchOptions):
    """Options besides those of the scan."""

    to: ValueArg = None
    """How far: 90deg, 1.2rad, 0.3m, 30cm or max (default: 90 deg, or fully)."""
    run: Flag = True
    """Don't execute the plan in simulation."""
    world: Annotated[Text, optional("SCENE")] = None
    """The true room of the scan, if known, in the scan's frame; the plan is executed in it."""
    hold: Literal["contact", "weld"] = "contact"
    """How the hand holds in simulation, see `momapos run`."""
    pictures: Flag = True
    """Don't draw an image for each object that explains its model."""
    json: Flag = False
    """Print the record as one JSON object, and nothing else."""
    scan: ScanArgs = SCAN_DEFAULT
    settings: ConfigArgs = NO_SETTINGS

    def read_config(self) -> Configuration:
        """Read the configuration.

        Raises:
            InputError: A setting is unknown, or out of range.
        """
        return self.load_config(self.settings, SETTINGS)


DEFAULT = SolveOptions()


def solve(
    source: Annotated[Positional[Path], arg(metavar="DIR")],
    verb: Positional[Literal["open", "close", "pick", "place"]],
    target: Target,
    /,
    *,
    out: Annotated[Path, arg(metavar="DIR")],
    options: Annotated[SolveOptions, arg(name="")] = DEFAULT,
) -> int:
    """Go from a scan to an executed task: survey, importance, models, plan, drive, manipulation.

    If there is no feasible base pose, momapos models more of the scan and plans again. The output
    folder holds the scene and its report, the plan, the run, and a record of stages and times.

    Exit status: 0 solved, and executed successfully; 1 the run failed; 2 unusable input; 3 no
    feasible base pose, or only one for a joint type that is not the most probable one (status
    `assumed`), which is executed only with --allow-assumed; 4 out of time.

    Args:
        source: Folder of posed color and depth images, a point cloud, or a robot's recording.
        verb: The task.
        target: The object as the scan names it, and its joint if it has several.
        out: The output folder.
        options: Further options.
    """
    from json import dumps

    from momapos.core import write_file

    if options.to is not None and options.to != MAX:
        parse_quantity(options.to)
    find_named_robot(options.robot)
    _check_world(options, verb)
    config = options.read_config()
    answer, record = _solve(source, verb, target, out, options, config)
    data = _to_dict(answer, record, options)
    write_file(out / RECORD, dumps(data, indent=1, allow_nan=False) + "\n")
    say(dumps(data, allow_nan=False) if options.json else _summary(answer, record, data, out))
    if record is not None and not record.success:
        return 1
    return exit_status(answer.result.plan.status, allow_assumed=options.allow_assumed)


def _check_world(options: SolveOptions, verb: str) -> None:
    """Refuse a true room that cannot be used, before the work.

    Raises:
        MomaposError: There is no such scene, or nothing is opened or closed in it.
    """
    if options.world is None:
        return
    if not options.run or verb not in ("open", "close"):
        raise InputError("--world is the room in which a part is opened or closed; leave it out")
    find_scene(options.world)


def _solve(
    source: Path,
    verb: Any,
    target: str,
    out: Path,
    options: SolveOptions,
    config: Configuration,
) -> tuple[ScanAnswer, RunRecord | None]:
    """Plan and execute, and write everything but the record."""
    # The default limit is for each search: reading a scan may take longer.
    with within_time(options.timeout):
        if options.run:  # a missing package is reported before the work
            with require("physics"):
                from momapos.workflows import run_plan  # noqa: F401
        from momapos.model import with_times
        from momapos.model.plan_files import write_plan
        from momapos.perception.recordings import write_cloud
        from momapos.planning import with_tolerance
        from momapos.workflows import ScanTask, solve_scan

        from .compile import ANSWER, compile_once
        from .console import progress
        from .scan_options import (
            detector_of,
            found_in,
            given_labels,
            given_models,
            read,
            scan_config,
            tools_for,
        )
        from .scan_report import outputs_of, report_to_dict, write_report

        scanning, given = scan_config(options.scan, config.scan), given_models(options.scan)
        labels, detector = given_labels(options.scan), detector_of(options.scan)
        files, folders = outputs_of(out / SCENE, pictures=options.pictures)
        check_outputs([*files, out / CLOUD, out / PLAN, out / RUN, out / RECORD], folders)
        name, _, joint = target.partition("/")
        compile_once(ANSWER)

        def step(what: str, share: float) -> None:
            look()
            report(share, what)

        with progress("solve") as report:
            scan = read(source, options.scan, config.scan)
            arms, reach = load_arms_with_maps(options.robot, options.arm)
            if options.timeout is not None:
                config = with_time_left(config)
            answer = solve_scan(
                scan, list(zip(arms, reach, strict=True)),
                ScanTask(verb, name, joint or None, options.to), out / SCENE,
                tools=tools_for(scan, options.scan, detector), found=found_in(scan, options.scan),
                labels=labels, given=given, scanning=scanning, config=config.pipeline,
                seed=options.seed,
                progress=step,
            )  # fmt: skip
    print_warnings(answer.modeled.warnings)
    data = report_to_dict(answer.modeled, scan, name)
    if options.tolerance:
        answer = replace(answer, result=with_tolerance(answer.result))
    result = answer.result
    robot = result.prepared.robot
    write_plan(with_times(result.with_notes().plan, robot), out / PLAN)
    # After the plan: these figures and clouds can fail.
    write_report(answer.modeled, data, out / SCENE, pictures=options.pictures)
    write_cloud(answer.modeled.cloud, out / CLOUD)
    executable = result.plan.status == "solved" or (
        result.plan.status == "assumed" and options.allow_assumed
    )
    if not executable or not options.run:
        return answer, None
    chosen = next(k for k, one in enumerate(arms) if one.arm == robot.arm)
    return answer, _run(answer, reach[chosen], out / RUN, options, config.pipeline)


def _run(
    answer: ScanAnswer, reach: Any, file: Path, options: SolveOptions, config: PipelineConfig
) -> RunRecord:
    """Execute the plan, and write the record."""
    import numpy as np

    from momapos.model.scene import as_planned, load_scene
    from momapos.simulation import ExecutionConfig, RunTrace, moved, with_files, write_run
    from momapos.workflows import run_plan

    plan, robot = answer.result.plan, answer.result.prepared.robot
    trace, there, at = RunTrace(), None, None
    if options.world is not None:
        T = answer.modeled.T_scene_scan
        at = np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])
        there = moved(load_scene(options.world), at)
    record = run_plan(
        plan, as_planned(load_scene(answer.modeled.scene), plan), robot, reach, world=there,
        config=config, physics=ExecutionConfig(hold=options.hold), seed=options.seed,
        allow_assumed=options.allow_assumed, trace=trace.drive, watch=trace,
    )  # fmt: skip
    named = with_files(record, file, file.parent / PLAN, options.world, at)
    write_run(replace(named, motion=trace.motion()), file)
    return record


def _to_dict(answer: ScanAnswer, record: RunRecord | None, options: SolveOptions) -> dict[str, Any]:
    """Return the record as plain values; times in [s]."""
    from .scan_options import stand_ins

    plan, timing = answer.result.plan, dict(answer.timing)
    if "tolerance" in plan.timing:
        spent = plan.timing["tolerance"]
        timing |= {"tolerance": spent, "total": timing.pop("total") + spent}
    if record is not None:
        timing |= {**record.time, "total": timing.pop("total") + sum(record.time.values())}
    return {
        "format": FORMAT,
        "version": VERSION,
        "verb": plan.task.verb, "object": plan.task.object, "joint": plan.task.joint,
        "to": plan.task.to, "robot": plan.robot_name, "method": plan.method, "seed": plan.seed,
        "status": plan.status,
        **({} if plan.assumption is None else {"assumption": asdict(plan.assumption)}),
        "done": None if record is None else record.verdict == "done",
        "reason": "" if record is None else record.reason,
        "cloud": CLOUD, "scene": SCENE, "plan": PLAN, "run": None if record is None else RUN,
        "alphas": list(answer.alphas),
        "views": answer.scanning.views,
        **({"stand_ins": stand_ins(options.scan)} if answer.scanning.views == "first" else {}),
        "modeled": [d.detection.name for d in answer.modeled.decisions if d.model is not None],
        "timing": {name: round(seconds, 4) for name, seconds in timing.items()},
    }  # fmt: skip


def _summary(answer: ScanAnswer, record: RunRecord | None, data: dict[str, Any], out: Path) -> str:
    """Summarize the plan, the run and the times."""
    from .console import summary
    from .run import summary as run_summary

    stages = ", ".join(f"{n} {s:.1f}" for n, s in data["timing"].items() if n != "total")
    again = len(answer.alphas) - 1
    lines = [summary(answer.result, out / PLAN)]
    if record is not None:
        lines += ["", run_summary(record)]
    back = f", lowered {again} times to model more" if again else ""
    return "\n".join([
        *lines, "",
        f"  scan        {len(answer.modeled.decisions)} objects, {len(data['modeled'])} modeled "
        f"with joints (alpha {answer.alphas[-1]:.2f}{back})",
        *_stand_ins(data),
        f"  all stages  {data['timing']['total']:.1f} s ({stages})",
        f"  record      {out / RECORD}",
    ])  # fmt: skip


def _stand_ins(data: dict[str, Any]) -> list[str]:
    """Name what does the work of the paper's networks, if one image chose each front."""
    lines = [f"{name}: {what}" for name, what in data.get("stand_ins", {}).items()]
    if not lines:
        return []
    return [
        "  fronts      by the first frontal image (MoMa-Pos, III-B)",
        f"  stand-ins   {lines[0]}",
        *(f"              {line}" for line in lines[1:]),
    ]
