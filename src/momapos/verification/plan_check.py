"""Verify a plan from its files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from momapos.core import Cache, FileFormatError, as_path, expect
from momapos.model.plan_files import read_plan
from momapos.model.records import PlacementPlan
from momapos.model.robots import read_srdf
from momapos.model.scene import Scene, as_planned, load_scene
from momapos.model.urdf import Articulated, read_urdf

from .exact_check import PlanVerifier
from .report import DEFAULT, Limits, Report, verdict


@dataclass(frozen=True)
class UrdfArm:
    """A robot as a plan describes it: a URDF, two links and the joints."""

    model: Articulated
    base_link: str
    tool_link: str
    moved_joints: tuple[str, ...]
    disabled: frozenset[frozenset[str]]


def verify_files(
    plan_path: str | Path,
    scene_root: str | Path | None = None,
    limits: Limits = DEFAULT,
    *,
    cache: Cache | None = None,
) -> Report:
    """Verify a plan, given only the plan file and the scene and URDF that it names.

    Args:
        plan_path: The plan.
        scene_root: Folder to search for files that are not next to the plan, and for the models
            of a BestMan scene.
        limits: Largest allowed errors.
        cache: Where to cache model geometry.

    Raises:
        FileFormatError, SceneError, UrdfError, UnknownNameError, TaskError, RobotError: The plan
            or a file that it names is unusable.
    """
    plan_path = as_path("plan_path", plan_path)
    scene_root = None if scene_root is None else as_path("scene_root", scene_root)
    expect("limits", limits, Limits)
    plan = read_plan(plan_path)
    if plan.status != "solved" or plan.motion is None or plan.base_pose is None:
        detail = f"status is {plan.status!r}; only solved plans can be verified"
        return Report((verdict("status is solved", False, detail),))
    folders = [plan_path.resolve().parent, *([scene_root] if scene_root else []), Path()]
    scene = read_scene(find_file("scene", plan.scene, folders, plan_path), scene_root, cache)
    scene = as_planned(scene, plan)
    urdf = find_file("robot.urdf", plan.robot_urdf, folders, plan_path)
    srdf = None
    if plan.robot_srdf is not None:
        srdf = find_file("robot.srdf", plan.robot_srdf, folders, plan_path)
    verifier = PlanVerifier(scene, _arm(plan, urdf, srdf, cache), plan.task, limits)
    report = verifier.check(plan.base_pose, plan.motion)
    drive = verifier.drive_checks(plan) if len(plan.motion.approach) else ()
    return Report((*report.checks, *drive), (*scene.warnings, *report.notes), report.gripper_depth)


def find_file(key: str, name: str, folders: list[Path], plan_path: Path) -> Path:
    """Find a file that a plan names.

    Raises:
        FileFormatError: No folder contains it.
    """
    for folder in folders:
        try:
            if (folder / name).is_file():
                return folder / name
        except OSError as error:  # the name is too long, or the links form a cycle
            raise FileFormatError(f"{plan_path}: {key} {name!r:.80} cannot be looked up") from error
    looked = ", ".join(dict.fromkeys(str(folder.resolve()) for folder in folders))
    raise FileFormatError(
        f"{plan_path}: {key} {name!r} does not exist (searched in {looked}); give scene_root"
    )


def read_scene(path: Path, scene_root: Path | None, cache: Cache | None = None) -> Scene:
    """Load a scene; `scene_root` applies if the scene is inside it or is a BestMan list."""
    if scene_root is not None and path.resolve().is_relative_to(scene_root.resolve()):
        return load_scene(path, root=scene_root, cache=cache)
    if scene_root is None:
        return load_scene(path, cache=cache)
    with path.open("rb") as file:
        is_list = file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"[")
    return load_scene(path, root=scene_root if is_list else None, cache=cache)


def _arm(plan: PlacementPlan, urdf: Path, srdf: Path | None, cache: Cache | None) -> UrdfArm:
    disabled = read_srdf(srdf or urdf.with_suffix(".srdf"))
    record = read_urdf(urdf, cache=cache, visuals=False, actuated=True)
    model = Articulated(record, plan.robot_rest, cache)
    return UrdfArm(model, plan.base_link, plan.tool_link, plan.joints, disabled)
