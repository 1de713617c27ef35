"""Evaluate scenes from scans of known kitchens: fronts, waypoints, answers, and whole chains.

    python benchmarks/scan.py kitchens [--rooms 20] [--robot segway_ur5e] [--frames 100]
        [--folder bench_out/scans] [--out bench_out] [--no-answers]
    python benchmarks/scan.py chains [--kitchens kitchen_small ...] [--chains ours views paper]
        [--robot segway_ur5e] [--frames 60] [--folder bench_out/chains]

Each kitchen is rendered as a walk with an RGB-D camera, and a scene is reconstructed from it.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from momapos.apps.cli.main import main as momapos
from momapos.apps.synthetic_scans import DepthSensor, synthetic_scan, write_scan
from momapos.core import MomaposError
from momapos.core.geometry import apply, invert, pose_planar
from momapos.model.records import PlacementPlan, ReachScorer, Scan, Task
from momapos.model.robots import Robot
from momapos.model.scene import LAYOUTS, Scene, generate_kitchen, load_scene
from momapos.model.urdf import opening_of
from momapos.perception import Modeled, ScanConfig, default_tools
from momapos.perception.recordings import read_scan
from momapos.perception.views import ViewMethod
from momapos.planning import PipelineConfig, PlacementResult, plan_base_placement
from momapos.planning.grasps import hand_path, make_task, openable, opening_direction
from momapos.planning.placement import PlaceConfig
from momapos.verification import Limits, PlanVerifier
from momapos.workflows import plan_by_hypothesis, scan_to_scene
from placement import arm
from rows import commands, keep_rows


@dataclass(frozen=True)
class Room:
    """A room and its scan."""

    name: str
    scene: Scene
    scan: Scan


def scanned(scene: Scene, folder: Path, frames: int, seed: int = 0) -> Path:
    """Return the folder of a room's scan; render it if needed."""
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        write_scan(synthetic_scan(scene, frames=frames, seed=seed, sensor=DepthSensor()), folder)
    return folder


def generated(folder: Path, count: int, frames: int = 100) -> Iterator[Room]:
    """Yield generated kitchens of all layouts in turn, each with a scan; generate missing ones."""
    for k in range(count):
        layout, seed = LAYOUTS[k % len(LAYOUTS)], k // len(LAYOUTS)
        home = folder / f"{layout}_{seed}"
        path = home / "scene" / "scene.json"
        if not path.exists():
            generate_kitchen(layout, seed=seed, out=path)
        scene = load_scene(path)
        yield Room(home.name, scene, read_scan(scanned(scene, home / "scan", frames, seed)))


MARGIN = 0.02
"""Maximum error of a plan in the true room [m]."""
MAX_HANDLE_ERROR = 0.15
"""Maximum distance of the handles of a matched door [m]."""


@dataclass(frozen=True)
class Door:
    """One joint of the room, and its results."""

    room: str
    name: str
    category: str
    match: str
    """The joint of the scan; "" if there is none."""
    frontal: float
    """Angle between the chosen view and the true normal [deg]; NaN if none was chosen."""
    waypoints: tuple[float, ...]
    """Errors of the handle's position at 0, 45 and 90 degrees, or 0, 50 and 100 % open [m]."""
    solvable: bool = False
    solved: bool = False
    reason: str = ""


def handle_at(scene: Scene, item: str, joint: str, share: float) -> np.ndarray:
    """Return the handle position of a part opened by a share of 90 degrees or of 30 cm [m]."""
    model = scene.object(item).model
    full = 0.3 if model.joint(joint).kind == "prismatic" else np.pi / 2
    found = opening_of(model, joint)
    limit = abs(found.wide - found.closed)
    to = found.closed + found.sign * max(min(share * full, limit), 1e-3)
    path = hand_path(scene, item, joint, to)
    return path[0] if share == 0 else path[-1]


def match(
    truth: Scene, scanned: Scene, T_truth_scene: np.ndarray
) -> dict[tuple[str, str], tuple[str, str]]:
    """Match joints of room and scan one to one: same kind, nearest handle."""
    ours, theirs = openable(truth), openable(scanned)
    pairs = []
    for a in ours:
        kind, place_a = truth.object(a[0]).model.joint(a[1]).kind, handle_at(truth, *a, 0.0)
        for b in theirs:
            if scanned.object(b[0]).model.joint(b[1]).kind == kind:
                place_b = apply(T_truth_scene, handle_at(scanned, *b, 0.0)[None])[0]
                gap = float(np.linalg.norm(place_a - place_b))
                pairs.append((gap, a, b))
    found: dict[tuple[str, str], tuple[str, str]] = {}
    for gap, a, b in sorted(pairs):
        if gap < MAX_HANDLE_ERROR and a not in found and b not in found.values():
            found[a] = b
    return found


def compare(room: Room, result: Modeled, scanned: Scene) -> list[Door]:
    """Compare every joint of the room with the scan."""
    back = invert(result.T_scene_scan)
    matches, doors = match(room.scene, scanned, back), []
    views = {d.detection.name: d.view for d in result.decisions}
    for item, joint in openable(room.scene):
        furniture = room.scene.object(item)
        same = matches.get((item, joint))
        frontal, errors = float("nan"), tuple[float, ...]()
        if same is not None:
            view = views[same[0]]
            _, outward = opening_direction(furniture, joint)
            outward = _square(outward)
            if view is not None:
                eye = result.frames[view.frame].T_world_camera[:3, 3]
                line = back[:3, :3] @ (eye - view.face.T_world_face[:3, 3])
                cosine = line @ outward / np.linalg.norm(line)
                frontal = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
            errors = tuple(
                float(np.linalg.norm(
                    handle_at(room.scene, item, joint, share)
                    - apply(back, handle_at(scanned, *same, share)[None])[0]
                ))
                for share in (0.0, 0.5, 1.0)
            )  # fmt: skip
        name = "" if same is None else "/".join(same)
        doors.append(Door(room.name, f"{item}/{joint}", furniture.category, name, frontal, errors))
    return doors


def _square(direction: np.ndarray) -> np.ndarray:
    """Return the horizontal axis nearest to a direction; fronts are parallel to the walls."""
    flat = np.zeros(3)
    axis = int(np.argmax(np.abs(direction[:2])))
    flat[axis] = np.sign(direction[axis])
    return flat


def answer(
    door: Door, room: Room, scanned: Scene, T_scene_truth: np.ndarray, robot_name: str
) -> Door:
    """Evaluate whether a feasible task is solved from the scan, and valid in the room."""
    robot, reach = arm(robot_name)
    config = PipelineConfig(place=PlaceConfig(grid=True), timeout=60.0)
    item, joint = door.name.split("/")
    task = make_task(room.scene, "open", item, joint)
    there = plan_base_placement(room.scene, robot, task, reach, config=config)
    if there.plan.status != "solved":
        return door
    door = replace(door, solvable=True)
    if not door.match:
        return replace(door, reason="not found in the scan")
    name, _, other = door.match.partition("/")
    taken, plan = plan_in_scan(
        room.scene, scanned, (item, joint), (name, other), robot, reach, config,
        moved(there.start, T_scene_truth),
    )  # fmt: skip
    if plan.status != "solved":
        return replace(door, reason=f"{plan.status} in the scan")
    refusal = why_not(plan, room.scene, taken, T_scene_truth, (item, joint), (name, other), robot)
    return replace(door, solved=not refusal, reason=refusal)


def plan_in_scan(
    truth: Scene,
    scanned: Scene,
    true: tuple[str, str],
    found: tuple[str, str],
    robot: Robot,
    reach: ReachScorer,
    config: PipelineConfig,
    start: np.ndarray,
) -> tuple[Scene, PlacementPlan]:
    """Plan the task of a room in its reconstructed scene.

    Args:
        truth, scanned: The room, and its reconstructed scene.
        true, found: The object and joint in each of them.
        robot, reach, config: How to plan.
        start: Start pose of the robot, in the scene's frame.

    Returns:
        The scene with the assumed joint of the part, see `plan_by_hypothesis`, and the plan.
    """

    def plan_in(scene: Scene, _: Task) -> list[PlacementResult]:
        task = task_in_scan(truth, scene, true, found)
        return [plan_base_placement(scene, robot, task, reach, start=start, config=config)]

    task = task_in_scan(truth, scanned, true, found)
    scene, _, (result,) = plan_by_hypothesis(scanned, task, plan_in)
    return scene, result.plan


def task_in_scan(
    truth: Scene, scanned: Scene, true: tuple[str, str], found: tuple[str, str]
) -> Task:
    """Return the task of a room in its reconstructed scene.

    A part with a smaller estimated than true range is opened to the end of the estimated range.
    """
    ours = opening_of(truth.object(true[0]).model, true[1])
    theirs = opening_of(scanned.object(found[0]).model, found[1])
    goal = make_task(truth, "open", *true).to
    assert goal is not None
    travel, whole = abs(goal - ours.closed), min(abs(theirs.wide - theirs.closed), np.pi / 2)
    kinds = [s.object(n).model.joint(j).kind for s, (n, j) in ((truth, true), (scanned, found))]
    # A drawer that was classified as a flap is opened by the flap's angle.
    travel = min(travel, whole) if len({kind == "prismatic" for kind in kinds}) == 1 else whole
    return make_task(scanned, "open", *found, theirs.closed + theirs.sign * travel)


def why_not(
    plan: PlacementPlan,
    truth: Scene,
    scanned: Scene,
    T_scene_truth: np.ndarray,
    true: tuple[str, str],
    found: tuple[str, str],
    robot: Robot,
    task: Task | None = None,
) -> str:
    """Return why a plan for the reconstructed scene fails the exact check in the room; "" if valid.

    The task in the room is by default to open the part.
    """
    assert plan.motion is not None
    assert plan.base_pose is not None
    ours = opening_of(truth.object(true[0]).model, true[1])
    theirs = opening_of(scanned.object(found[0]).model, found[1])
    q = plan.motion.object_q - theirs.closed
    base = moved(np.array(plan.base_pose), invert(T_scene_truth))
    T_truth_scene = pose_planar(base) @ invert(pose_planar(np.array(plan.base_pose)))
    motion = replace(
        plan.motion,
        Ts_world_tool=T_truth_scene @ plan.motion.Ts_world_tool,
        object_q=ours.closed + ours.sign * theirs.sign * q,
    )
    limits = Limits(
        penetration=MARGIN, slip_position=MARGIN, slip_rotation=np.radians(10.0),
        reach=Limits().reach + MARGIN, floor_edge=0.1, goal=1.0,
    )  # fmt: skip
    task = task or make_task(truth, "open", *true)
    refusal = PlanVerifier(truth, robot, task, limits).first_violation(_triple(base), motion)
    return refusal or ""


def moved(base: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Return a base pose (x, y, yaw) in another frame, ignoring the tilt of that frame."""
    x, y, _ = apply(T, np.array([[base[0], base[1], 0.0]]))[0]
    return np.array([x, y, base[2] + np.arctan2(T[1, 0], T[0, 0])])


def _triple(pose: np.ndarray) -> tuple[float, float, float]:
    return float(pose[0]), float(pose[1]), float(pose[2])


def kitchens(
    rooms: int = 20, robot: str = "segway_ur5e", frames: int = 100, no_answers: bool = False,
    folder: Path = Path("bench_out/scans"), out: Path = Path("bench_out"),
) -> None:  # fmt: skip
    """Compare scenes with the generated kitchens that they are scans of.

    A task counts if it is feasible in the kitchen. It is solved from the scan if `place` solves it
    in the reconstructed scene and the plan passes the exact check in the kitchen with a margin of
    2 cm.

    Args:
        rooms: Number of kitchens.
        robot: Robot of the library.
        frames: Number of frames of new scans.
        no_answers: Compare joints only.
        folder: Folder of kitchens and scans.
        out: Folder for scan.json.
    """
    tools, doors, times = default_tools(), list[Door](), []
    for room in generated(folder, rooms, frames):
        path = folder / room.name / "found" / "scene.json"
        result = scan_to_scene(room.scan, path, tools)
        made = load_scene(path)
        times.append({"frames": len(room.scan.frames), **result.timing})
        found = compare(room, result, made)
        if not no_answers:
            found = [answer(door, room, made, result.T_scene_scan, robot) for door in found]
        doors += found
        spent = {k: round(v, 1) for k, v in result.timing.items()}
        print(room.name, summary(found), spent, flush=True)
        for door in found:
            if door.reason:
                print("   ", door.name, door.match, door.reason, flush=True)
    print("all", summary(doors))
    for category in sorted({door.category for door in doors}):
        print(f"  {category:14}", summary([d for d in doors if d.category == category]))
    keep_rows({"doors": [asdict(door) for door in doors], "times": times}, out, "scan")


def summary(doors: list[Door]) -> str:
    """Return one line of results."""
    matched = [d for d in doors if d.match]
    angles = np.array([d.frontal for d in matched if np.isfinite(d.frontal)])
    errors = np.array([d.waypoints for d in matched]).reshape(-1, 3)
    solvable = [d for d in doors if d.solvable]
    text = f"{len(matched)} of {len(doors)} joints"
    if len(matched):
        median = ", ".join(f"{100 * v:.1f}" for v in np.median(errors, axis=0))
        text += f"; frontal {np.mean(angles <= 20):.0%}; handle {median} cm"
    if solvable:
        text += f"; solved {sum(d.solved for d in solvable)} of {len(solvable)}"
        reasons = Counter(d.reason for d in solvable if not d.solved)
        text += f" {dict(reasons.most_common(3))}" if reasons else ""
    return text


CHAINS: dict[str, tuple[ViewMethod, tuple[str, ...]]] = {
    "ours": ("voting", ()),
    "views": ("first", ("--set", "scan.views=first")),
    "paper": ("first", ("--method", "paper")),
}
"""Choice of views, and options of `momapos solve`."""
HALF = 0.5
"""Plans for a joint that is less probable are `assumed`, not solved [-]."""
Part = tuple[str, str]
"""Object and joint."""


@dataclass(frozen=True)
class Opening:
    """The answer for one part of a kitchen."""

    part: Part
    found: str = ""
    """The part in the scan; "" if there is none."""
    status: str = "not found"
    opened: bool = False
    probability: float = 1.0
    """Probability of the part's most probable joint [-]."""
    reason: str = ""


def solvable(kitchen: Scene, robot_name: str) -> list[Part]:
    """Return the parts that can be opened in a kitchen whose joints are known."""
    (robot, reach), parts = arm(robot_name), []
    for part in openable(kitchen):
        with contextlib.suppress(MomaposError):
            answer = plan_base_placement(kitchen, robot, make_task(kitchen, "open", *part), reach)
            parts += [part] if answer.plan.status == "solved" else []
    return parts


def found_in(kitchen: Scene, scan: Path, out: Path, views: ViewMethod) -> dict[Part, Part]:
    """Return the parts of a kitchen that a chain finds in its scan."""
    made = scan_to_scene(read_scan(scan), out, default_tools(), config=ScanConfig(views=views))
    return match(kitchen, load_scene(out), invert(made.T_scene_scan))


def solve(
    scan: Path, kitchen: str, found: Part, robot: str, out: Path, words: tuple[str, ...]
) -> Opening:
    """Run the command for one part of the scan."""
    name = "/".join(found)
    command = ["solve", str(scan), "open", name, "--robot", robot, "--world", kitchen, *words]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()) as errors:
        momapos([*command, "--out", str(out), "--no-pictures", "--json"])
    if not printed.getvalue():
        return Opening(found, name, "refused", reason=errors.getvalue().strip())
    record = json.loads(printed.getvalue())
    beliefs = load_scene(out / "scene.json").object(found[0]).hypotheses
    first = beliefs[found[1]][0].probability if found[1] in beliefs else 1.0
    done = record["done"] is True
    return Opening(found, name, record["status"], done, first, record["reason"])


def counts(openings: list[Opening]) -> str:
    """Return one line of results."""
    solved = [one for one in openings if one.status == "solved"]
    return (
        f"{sum(one.found != '' for one in openings)} of {len(openings)} found, "
        f"{len(solved)} solved, {sum(one.status == 'assumed' for one in openings)} assumed, "
        f"{sum(one.opened for one in openings)} opened; "
        f"solved below one half: {sum(one.probability < HALF for one in solved)}"
    )


def chains(
    kitchens: tuple[str, ...] = ("kitchen_small", "kitchen_island"),
    chains: tuple[Literal["ours", "views", "paper"], ...] = ("ours", "views", "paper"),
    robot: str = "segway_ur5e", frames: int = 60, folder: Path = Path("bench_out/chains"),
) -> None:  # fmt: skip
    """Open the doors and drawers of built-in kitchens from scans, by our chain and by the paper's.

    Every opening that can be planned in the kitchen itself is answered by `momapos solve SCAN open
    OBJECT/JOINT --world KITCHEN`, and the plan is executed in the true kitchen. "ours" has no
    further options: all images vote for the front. "views" is `--set scan.views=first`: section
    III-B of the paper, our placement. "paper" is `--method paper`: sections III-A to III-D.

    "Found" counts parts of which the scene has one of the same kind with its handle within 15 cm.
    Each part that is not found counts as not opened. "Below one half" counts plans with the status
    solved for a joint whose probability in the scene is smaller; there must be none.

    Args:
        kitchens: Built-in kitchens.
        chains: Chains to compare.
        robot: Robot of the library.
        frames: Number of frames of new scans.
        folder: Folder of the scans.
    """
    results: dict[str, list[Opening]] = {chain: [] for chain in chains}
    for name in kitchens:
        kitchen = load_scene(name)
        scan = scanned(kitchen, folder / name / "scan", frames)
        parts = solvable(kitchen, robot)
        for chain in chains:
            views, words = CHAINS[chain]
            home = folder / name / chain
            found, openings = found_in(kitchen, scan, home / "whole" / "scene.json", views), []
            for part in parts:
                one = Opening(part)
                if part in found:
                    answer = solve(scan, name, found[part], robot, home / "solved", words)
                    one = replace(answer, part=part)
                openings.append(one)
                done = "opened" if one.opened else one.reason
                print(f"  {chain} {'/'.join(part)}: {one.found} {one.status} {done}", flush=True)
            print(f"{name}, {chain}: {counts(openings)}", flush=True)
            results[chain] += openings
    for name, openings in results.items():
        print(f"all, {name}: {counts(openings)}")


if __name__ == "__main__":
    commands(__doc__, kitchens, chains)
