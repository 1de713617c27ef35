"""Verify plans and tours from their files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path, PurePosixPath

import numpy as np

from momapos.core import USER_CACHE, Cache, FileFormatError, as_path, expect, resolved
from momapos.core.geometry import invert
from momapos.model.plan_files import TourFile, changed_files, read_plan, read_tour
from momapos.model.records import Motion, PlacementPlan
from momapos.model.robots import Robot, claimed_apart, read_srdf
from momapos.model.scene import (
    Scene,
    as_begun,
    as_planned,
    load_scene,
    scene_after,
    with_assumptions,
    with_overrides,
)
from momapos.model.urdf import Articulated, in_convex_pieces, read_urdf

from . import path_checks as paths
from .exact_check import PlanVerifier
from .exact_shapes import of_bodies, prepared
from .path_checks import (
    base_path_checks,
    known_base_checks,
    known_latch_checks,
    latch_checks,
    time_checks,
)
from .plan_claims import (
    assumes_otherwise,
    read_robot_of,
    rest_checks,
    robot_checks,
    robot_notes,
    scene_checks,
    scene_notes,
    stated_checks,
    with_usual,
)
from .report import DEFAULT, Check, Limits, Report, at_most, verdict
from .robot_collision_model import RobotDescription, robot_collision_model, self_pairs

SAME_ROOM = 1e-5
"""Differences of poses, joint values and extents between two rooms below which they are the same:
files round numbers [m], [rad]."""
SAME_GRASP = 1e-3
"""Difference of the hand's poses in an object below which the hand holds it as before [m]."""
MAX_NAMED = 6
"""Maximum number of names in a note [-]."""


def trust_notes(scene: Scene, robot: RobotDescription, srdf: Path | None) -> Iterator[str]:
    """Yield notes on disabled pairs, and on robots and objects without shapes.

    Args:
        scene: The scene of the plan.
        robot: The robot of the plan.
        srdf: The file that disables pairs of links, if there is one.
    """
    built = robot_collision_model(robot)
    bodies, shapes = prepared(robot.model)
    moving = set().union(*(bodies.moved_by(joint) for joint in built.joints))
    every = self_pairs(bodies, shapes, of_bodies(shapes, moving))
    names = {frozenset((shapes.names[i], shapes.names[j])) for i, j in every}
    trusted = sorted("-".join(sorted(pair)) for pair in names & robot.disabled)
    if trusted:
        checked = f"{len(trusted)} of {len(names)} pairs of links"
        source = "the robot file" if srdf is None else srdf
        yield (
            f"trusts {source}: it disables the self-collision check of {checked} "
            f"({_listed(trusted)})"
        )
    for what, count in (("arm and hand", len(built.arm)), ("base", len(built.base))):
        if not count:
            yield f"the {what} of the robot has no collision shapes: nothing of it is checked"
    empty = [item.name for item in scene.objects if not len(prepared(item.model)[1])]
    if empty:
        yield f"without collision shapes, so not checked: {_listed(empty)}"


def _listed(names: Sequence[str]) -> str:
    more = len(names) - MAX_NAMED
    shown = ", ".join(names[:MAX_NAMED])
    return f"{shown} and {more} more" if more > 0 else shown


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
    claimed: frozenset[frozenset[str]] = frozenset()
    """Disabled pairs that are said never to touch, which their surfaces decide."""


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
    none = frozenset[frozenset[str]]()
    disabled, claimed = (none, none) if srdf is None else (read_srdf(srdf), claimed_apart(srdf))
    record = in_convex_pieces(read_urdf(urdf, cache=cache, visuals=False, actuated=True), cache)
    rest = dict(plan.robot_rest) if own is None else {**own.model.held, **plan.robot_rest}
    return UrdfArm(
        Articulated(record, rest, cache), plan.base_link, plan.tool_link, plan.joints, disabled,
        plan.robot_drive if own is None else own.drive,
        plan.robot_min_turning_radius if own is None else own.min_turning_radius,
        None if own is None else own.grip_force, claimed,
    )  # fmt: skip


def verify_tour(
    path: Path,
    scene_root: Path | None = None,
    limits: Limits = DEFAULT,
    *,
    allow_assumed: bool = False,
    cache: Cache | None = USER_CACHE,
) -> dict[str, Report]:
    """Verify a tour, given only its file, its plans, and the scenes and URDFs that they name.

    Args:
        path: The tour.
        scene_root: As for `verify_files`.
        limits: Largest allowed errors.
        allow_assumed: As for `verify_files`.
        cache: Where to cache model geometry; None to always compute it.

    Returns:
        A report for each plan by its file name, and one for the sequence by the tour's file name.

    Raises:
        FileFormatError, SceneError, UrdfError, UnknownNameError, TaskError, RobotError: The tour,
            a plan or a file that a plan names is unusable.
    """
    tour = read_tour(path)
    files = [path.with_name(step.plan) for step in tour.steps]
    reports = {
        file.name: verify_files(file, scene_root, limits, allow_assumed=allow_assumed, cache=cache)
        for file in files
    }
    plans = [read_plan(file) for file in files]
    folders = [resolved(path).parent, *([scene_root] if scene_root else []), Path()]
    read: dict[Path, Scene] = {}
    rooms = []
    for file, plan in zip(files, plans, strict=True):
        scene = find_file("scene", plan.scene, folders, file)
        room = read.setdefault(scene, read.get(scene) or read_scene(scene, scene_root, cache))
        rooms.append(as_begun(room, plan))
    sequence = _sequence(tour, plans, rooms, allow_assumed)
    reports[path.name] = Report(tuple(sequence))
    return reports


def _sequence(
    tour: TourFile, plans: list[PlacementPlan], rooms: list[Scene], allow_assumed: bool
) -> Iterator[Check]:
    """Check that each plan starts in the state in which the previous plan ends.

    Args:
        tour: The tour.
        plans: Its plans.
        rooms: The scene of each plan as it begins, or with what it places at its goal.
        allow_assumed: As for `verify_files`.
    """
    solved = tour.status == "solved" or (allow_assumed and tour.status == "assumed")
    yield verdict("status is solved", solved, f"status {tour.status!r}")
    stops = [step.stop for step in tour.steps]
    counted = [1, *(b - a for a, b in pairwise(stops))]
    in_order = stops[0] == 1 and set(counted) <= {0, 1} and stops[-1] == tour.stops
    yield verdict("stops are numbered from 1, in order", in_order, str(stops))
    for number, (before, after) in enumerate(pairwise(plans), start=2):
        name = f"plan {number}"
        yield verdict(
            f"{name}: same robot as the previous plan",
            (before.robot_urdf, before.joints) == (after.robot_urdf, after.joints),
        )
        left, room = scene_after(rooms[number - 2], before.task), rooms[number - 1]
        placed = after.task.object if after.task.verb == "place" else ""
        other = _differences(left, room, placed)
        yield verdict(
            f"{name}: the room is as the previous plan leaves it", not other, ", ".join(other)
        )
        if placed and (before.task.verb, before.task.object) == ("pick", placed):
            off = _grasp_gap(before, rooms[number - 2], after, room)
            yield at_most(f"{name}: {placed} is held as it was picked up", off, SAME_GRASP, "m")
        ends = np.array([before.final_base_pose or [np.nan] * 3, after.start or [np.nan] * 3])
        off = float(np.abs(np.diff(ends, axis=0)).max())
        yield at_most(f"{name}: base starts where the previous plan ends", off, 1e-6, "rad|m")
        came_home = before.motion is not None and before.motion.home is not None
        yield verdict(f"{name}: arm has returned home", came_home)
        gap = _arm_gap(before, after)
        if gap is not None:
            what = f"{name}: arm starts as it has returned"
            yield at_most(what, gap, DEFAULT.join, "rad|m")
        if stops[number - 1] == stops[number - 2]:
            stays = before.final_base_pose == after.base_pose
            yield verdict(f"{name}: base stays at its stop", stays)


def _arm_gap(before: PlacementPlan, after: PlacementPlan) -> float | None:
    """Return how far a plan's first arm state is from the last one of the previous plan."""
    first, last = after.motion, before.motion
    if first is None or last is None or last.home is None or before.joints != after.joints:
        return None
    starts = first.approach[:1] if len(first.approach) else first.q[:1]
    return float(np.abs(starts - last.home[-1:]).max(initial=0.0))


def _differences(before: Scene, after: Scene, held: str) -> list[str]:
    """Return which objects differ between two rooms, but for one that is in the hand."""
    if before is after:
        return []
    one, other = ({item.name: item for item in room.objects} for room in (before, after))
    found = [f"{name} is in one of them" for name in sorted(one.keys() ^ other.keys())]
    for name in sorted(one.keys() & other.keys()):
        a, b = one[name], other[name]
        if a is b:
            continue
        if name == held:
            moved = np.abs(np.ptp(a.bounds, axis=0)[2] - np.ptp(b.bounds, axis=0)[2])
        else:
            moved = np.abs(a.T_world_object - b.T_world_object).max()
            moved = max(moved, np.abs(a.bounds - b.bounds).max())
        if moved > SAME_ROOM:
            found.append(f"{name} is not where or as it was")
        values = b.values()
        found += [
            f"{name}/{joint} is at {values[joint]:g}, not {value:g}"
            for joint, value in a.values().items()
            if abs(value - values.get(joint, np.inf)) > SAME_ROOM
        ]
    return found


def _grasp_gap(pick: PlacementPlan, room: Scene, place: PlacementPlan, goal: Scene) -> float:
    """Return how far apart a hand holds an object as it picks it up and as it places it [m].

    A difference of the rotation counts at 1 m from the tool.
    """
    if pick.motion is None or place.motion is None:
        return np.inf
    held = [
        invert(scene.object(plan.task.object).T_world_object) @ plan.motion.Ts_world_tool[0]
        for plan, scene in ((pick, room), (place, goal))
        if plan.motion is not None
    ]
    return float(np.abs(held[0] - held[1]).max())


def check_plan_numbers(plan: PlacementPlan, scene: Scene, robot: Robot, name: str) -> None:
    """Refuse a plan whose numbers `verify` rejects: what would use it cannot rely on them.

    What the plan states about robot and scene is compared with their files. Joint values and their
    limits, tool poses, base path and times are checked; bodies and loads are not, because a plan
    that collides can be shown and simulated.

    Args:
        plan: A plan with a motion.
        scene: The scene as it was planned in.
        robot: The robot.
        name: The plan's file, for the message.

    Raises:
        FileFormatError: It names the first failed check, its value and its limit.
    """
    verifier = PlanVerifier(with_assumptions(scene, plan), robot, plan.task)
    stated = (
        *rest_checks(plan.robot_rest, robot.model, plan.joints, verifier.limits),
        *stated_checks(plan, robot),
        *scene_checks(plan, with_overrides(scene, plan)),
    )
    failed = next((c for c in chain(stated, _checks(verifier, plan)) if not c.ok), None)
    if failed is None:
        return
    number = f": {failed.value:.4g} {failed.unit}, limit {failed.limit:g}" if failed.unit else ""
    detail = f" ({failed.detail})" if failed.detail else ""
    raise FileFormatError(f"{name}: not a usable plan: {failed.name}{number}{detail}")


def _checks(verifier: PlanVerifier, plan: PlacementPlan) -> Iterator[Check]:
    """Yield the checks; each relies on those before it."""
    motion, base, limits = plan.motion, plan.base_pose, verifier.limits
    assert motion is not None
    assert base is not None
    yield from paths.number_checks(verifier.part, motion, base)
    yield from known_latch_checks(verifier.part, motion)
    yield from known_base_checks(base, motion, plan.robot_drive)
    yield from paths.hold_checks(verifier.part, motion)
    yield from paths.verb_checks(verifier.part, plan.task.verb)
    yield from joint_number_checks(verifier, motion)
    states = paths.count_states(motion, limits.step)
    yield at_most("states to check", states, limits.states)
    bases = base if motion.base is None else motion.base
    Ts_tool, _, _ = verifier.robot_model.poses(verifier.robot_model.body_poses(bases, motion.q))
    yield from paths.tool_checks(Ts_tool, motion, limits)
    if plan.start is not None and plan.base_path is not None:
        yield from base_path_checks(plan.base_path, np.array([plan.start, base]), limits)


def joint_number_checks(verifier: PlanVerifier, motion: Motion) -> Iterator[Check]:
    """Check the values of all joints, and the times at which they are reached."""
    robot, part, limits = verifier.robot_model, verifier.part, verifier.limits
    yield from paths.object_checks(part, motion, limits)
    yield from latch_checks(part, motion, limits)
    yield from paths.joint_checks(robot, motion, limits)
    yield from paths.home_checks(verifier.task, motion, limits)
    yield from time_checks(robot, motion, limits)
