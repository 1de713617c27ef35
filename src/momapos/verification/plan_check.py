"""Verify a plan from its files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from momapos.core import USER_CACHE, Cache, FileFormatError, as_path, expect, resolved
from momapos.model.plan_files import changed_files, read_plan
from momapos.model.records import PlacementPlan
from momapos.model.robots import Robot, read_srdf
from momapos.model.scene import Scene, as_planned, load_scene, with_assumptions, with_overrides
from momapos.model.urdf import Articulated, read_urdf

from .exact_check import PlanVerifier
from .report import DEFAULT, Check, Limits, Report, verdict
from .robot_claims import read_robot_of, robot_checks, robot_notes
from .scene_claims import assumes_otherwise, scene_checks, scene_notes, with_usual
from .trust_notes import trust_notes

_PACKAGE = Path(__file__).parents[1]
"""Folder of the package; built-in kitchens and robots are in `model/*/library`."""


@dataclass(frozen=True)
class UrdfArm:
    """A robot as a plan describes it: a URDF, two links and the joints."""

    model: Articulated
    base_link: str
    tool_link: str
    moved_joints: tuple[str, ...]
    disabled: frozenset[frozenset[str]]
    drive: str | None = None
    """How the base drives: by the robot file, else by the plan; None if neither states it."""
    min_turning_radius: float | None = None
    """Least turning radius of a car-like base [m]."""
    grip_force: float | None = None
    """Closing force of each finger, or pull of a suction cup [N]; None without a robot file."""


def verify_files(
    plan_path: str | Path,
    scene_root: str | Path | None = None,
    limits: Limits = DEFAULT,
    *,
    allow_assumed: bool = False,
    cache: Cache | None = USER_CACHE,
) -> Report:
    """Verify a plan, given only the plan file and the scene and URDF that it names.

    An assumed plan is checked in the scene that it assumes, and is not valid even if all checks
    pass, because the part probably moves in another way.

    Args:
        plan_path: The plan.
        scene_root: Folder to search for files that are not next to the plan, and for the models
            of a BestMan scene.
        limits: Largest allowed errors.
        allow_assumed: Whether an assumed plan may be valid.
        cache: Where to cache model geometry; None to always compute it.

    Raises:
        FileFormatError, SceneError, UrdfError, UnknownNameError, TaskError, RobotError: The plan
            or a file that it names is unusable.
    """
    plan_path = as_path("plan_path", plan_path)
    scene_root = None if scene_root is None else as_path("scene_root", scene_root)
    expect("limits", limits, Limits)
    plan = read_plan(plan_path)
    if not plan.feasible or plan.motion is None or plan.base_pose is None:
        detail = f"status is {plan.status!r}; only solved plans can be verified"
        return Report((verdict("status is solved", False, detail),))
    folders = [resolved(plan_path).parent, *([scene_root] if scene_root else []), Path()]
    scene_file = find_file("scene", plan.scene, folders, plan_path)
    filed = read_scene(scene_file, scene_root, cache)
    assumed = _assumed(filed, plan)
    planned = with_overrides(as_planned(filed, plan), plan)
    scene = with_assumptions(planned, plan)
    urdf = find_file("robot.urdf", plan.robot_urdf, folders, plan_path)
    srdf = None
    if plan.robot_srdf is not None:
        srdf = find_file("robot.srdf", plan.robot_srdf, folders, plan_path)
    if srdf is None and urdf.with_suffix(".srdf").is_file():
        srdf = urdf.with_suffix(".srdf")
    own = read_robot_of(plan, urdf, folders, cache)
    robot = _arm(plan, urdf, srdf, own, cache)
    stated = [*robot_checks(plan, robot.model, own, limits), *scene_checks(plan, planned)]
    if own is not None:
        stated.append(_trusted_pairs(robot, own))
    verifier = PlanVerifier(scene, robot, plan.task, limits)
    report = verifier.check(plan.base_pose, plan.motion)
    drive = verifier.drive_checks(plan) if len(plan.motion.approach) else ()
    checks = [*stated, *report.checks, *drive, *verifier.region_checks(plan)]
    if report.valid and assumes_otherwise(plan, planned):
        usual = PlanVerifier(with_usual(planned, plan), robot, plan.task, limits)
        checks += usual.load_checks(plan.base_pose, plan.motion, " with the usual resistance")
    notes = [
        *scene.warnings, *_changes(plan_path, scene_file, urdf), *robot_notes(plan, own),
        *scene_notes(plan, planned, filed), *report.notes, *trust_notes(scene, robot, srdf),
        *assumed,
    ]  # fmt: skip
    if (assumed or plan.status == "assumed") and not allow_assumed:
        checks.insert(0, verdict("status is solved", False, "; ".join(assumed) or "assumed"))
    return Report(tuple(checks), tuple(notes), report.gripper_depth)


def _changes(plan_path: Path, scene: Path, urdf: Path) -> Iterator[str]:
    for what, file in changed_files(plan_path, scene, urdf).items():
        yield (
            f"the {what} ({file}) has changed since the plan was written; all checks are of the "
            "file as it is now"
        )


def _trusted_pairs(robot: UrdfArm, own: Robot) -> Check:
    """Check that no pair of links is disabled that the robot's own SRDF does not disable."""
    more = sorted("-".join(sorted(pair)) for pair in robot.disabled - own.disabled)
    detail = f"{more[0]} and {len(more) - 1} more" if more else ""
    return verdict("disabled pairs of links are those of the robot's SRDF", not more, detail)


def _assumed(scene: Scene, plan: PlacementPlan) -> list[str]:
    """Describe each joint for which a plan assumes an improbable or less probable motion.

    Raises:
        UnknownNameError, SceneError: See `as_planned`.
    """
    task, found = plan.task, []
    taken = {(name, j): k for name, some in plan.scene_hypotheses.items() for j, k in some.items()}
    if task.joint is not None:
        taken.setdefault((task.object, task.joint), 0)
    for (name, joint), index in taken.items():
        ways = scene.object(name).hypotheses.get(joint, ())
        if 0 <= index < len(ways) and (index > 0 or not ways[0].is_probable):
            first, way = ways[0], ways[index]
            other = f", not a {first.kind} ({100 * first.probability:.2g} %)" if index else ""
            words = f"the plan assumes that {name}/{joint} is a {way.kind}"
            found.append(f"{words} ({100 * way.probability:.2g} %){other}")
    return found


def find_file(key: str, name: str, folders: list[Path], plan_path: Path) -> Path:
    """Find a file that a plan names, also one of another installation of this package.

    Raises:
        FileFormatError: No folder contains it.
    """
    for folder in folders:
        try:
            if (folder / name).is_file():
                return folder / name
        except OSError as error:  # the name is too long, or the links form a cycle
            raise FileFormatError(f"{plan_path}: {key} {name!r:.80} cannot be looked up") from error
    shipped = _shipped_file(name)
    if shipped is not None:
        return shipped
    looked = ", ".join(dict.fromkeys(str(resolved(folder)) for folder in folders))
    raise FileFormatError(
        f"{plan_path}: {key} {name!r} does not exist (searched in {looked}); give scene_root"
    )


def _shipped_file(name: str) -> Path | None:
    """Return the built-in kitchen or robot file that a path of another installation means."""
    parts = PurePosixPath(name).parts
    for k in reversed(range(len(parts))):
        tail = parts[k + 1 :]
        is_library = tail[:1] == ("model",) and "library" in tail[1:3] and ".." not in tail
        if parts[k] == _PACKAGE.name and is_library and _PACKAGE.joinpath(*tail).is_file():
            return _PACKAGE.joinpath(*tail)
    return None


def read_scene(path: Path, scene_root: Path | None, cache: Cache | None = USER_CACHE) -> Scene:
    """Load a scene; `scene_root` applies if the scene is inside it or is a BestMan list."""
    if scene_root is not None and resolved(path).is_relative_to(resolved(scene_root)):
        return load_scene(path, root=scene_root, cache=cache)
    if scene_root is None:
        return load_scene(path, cache=cache)
    with path.open("rb") as file:
        is_list = file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"[")
    return load_scene(path, root=scene_root if is_list else None, cache=cache)


def _arm(
    plan: PlacementPlan, urdf: Path, srdf: Path | None, own: Robot | None, cache: Cache | None
) -> UrdfArm:
    """Read the robot that a plan names; what its robot file states has priority over the plan."""
    disabled = frozenset() if srdf is None else read_srdf(srdf)
    record = read_urdf(urdf, cache=cache, visuals=False, actuated=True)
    rest = dict(plan.robot_rest) if own is None else {**own.model.held, **plan.robot_rest}
    return UrdfArm(
        Articulated(record, rest, cache), plan.base_link, plan.tool_link, plan.joints, disabled,
        plan.robot_drive if own is None else own.drive,
        plan.robot_min_turning_radius if own is None else own.min_turning_radius,
        None if own is None else own.grip_force,
    )  # fmt: skip
