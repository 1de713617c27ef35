"""Compare the verdicts of `momapos verify` and of an independent program on whole and broken plans.

    python benchmarks/mutations.py corrupted [--count 500] [--plans 25] [--set development|test]
        [--robots fetch ...] [--verifier verify_plan.py] [--out DIR]
    python benchmarks/mutations.py agreement VERIFIER [--plans 200] [--robots fetch ...] [--seed 0]
        [--sources cases kitchens objects] [--out DIR]

Tool poses are recomputed after a change of arm states, so that the states themselves are checked.
"""

from __future__ import annotations

import argparse
import copy
import importlib.util
import json
import operator
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np

from momapos.apps.bench.articulated import SETS, set_of
from momapos.core import USER_CACHE, MomaposError
from momapos.core.geometry import pose_planar
from momapos.model.plan_files import write_plan
from momapos.model.robots import Robot
from momapos.model.scene import Scene, builtin_names, load_scene
from momapos.planning import plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.verification import find_file, read_scene, verify_files
from objects import CONFIG, Subset, object_tasks, saved
from placement import ROBOTS, SCENES, arm, machine, scene_of, shared
from rows import commands, emit, keep_rows, markdown

Corruption = Callable[[dict[str, Any], np.random.Generator], bool]
"""Changes the content of a plan file; returns False if it does not apply to the plan."""
CORRUPTIONS: dict[str, Corruption] = {}
ROWS = ("q", "object_q", "T_world_tool")
ACCEPTED, REFUSED = "accepted", "refused"


def corruption(function: Corruption) -> Corruption:
    """Register a corruption under its name."""
    CORRUPTIONS[function.__name__] = function
    return function


def amount(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a log-uniform size with random sign."""
    return float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(low), np.log(high))))


def recompute_tool_poses(plan: dict[str, Any], robot: Robot) -> None:
    """Recompute the tool poses from the arm states and the base pose."""
    base, motion = plan["base_pose"], plan["manipulation"]
    T_world_base = pose_planar(np.array([base["x"], base["y"], base["yaw"]]))
    motion["T_world_tool"] = (T_world_base @ robot.chain.tool_poses(np.array(motion["q"]))).tolist()


def random_grasp(plan: dict[str, Any], rng: np.random.Generator) -> tuple[int, int, int]:
    """Return the index of a random grasp interval, and its first and last state."""
    k = int(rng.integers(len(plan["manipulation"]["holds"])))
    return k, *plan["manipulation"]["holds"][k]


@corruption
def base_moved(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Move the base by 5 mm to 20 cm, or by 0.5 to 20 degrees."""
    key = str(rng.choice(["x", "y", "yaw"]))
    plan["base_pose"][key] += amount(rng, 0.009, 0.35) if key == "yaw" else amount(rng, 0.005, 0.2)
    return True


@corruption
def one_state_off(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Change one joint of one state by 0.01 to 0.5."""
    q = plan["manipulation"]["q"]
    q[rng.integers(len(q))][rng.integers(len(q[0]))] += amount(rng, 0.01, 0.5)
    return True


@corruption
def one_tool_pose_off(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Move one tool pose by 1 to 100 mm."""
    T = plan["manipulation"]["T_world_tool"]
    T[rng.integers(len(T))][rng.integers(3)][3] += amount(rng, 0.001, 0.1)
    return True


@corruption
def hand_twists(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Add a linearly growing turn of 1 to 30 degrees to a wrist joint during one grasp."""
    _, first, last = random_grasp(plan, rng)
    q = np.array(plan["manipulation"]["q"])
    if last - first < 2:
        return False
    joint = q.shape[1] - 1 - int(rng.integers(3))
    q[first : last + 1, joint] += amount(rng, 0.02, 0.5) * np.linspace(0, 1, last - first + 1)
    q[last + 1 :, joint] += q[last, joint] - plan["manipulation"]["q"][last][joint]
    plan["manipulation"]["q"] = q.tolist()
    return True


@corruption
def door_lags_behind(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Distort the part's values between the same ends, by 1 to 50 %."""
    value = np.array(plan["manipulation"]["object_q"])
    share = (value - value[0]) / (value[-1] - value[0])
    bent = share ** (1 + abs(amount(rng, 0.01, 0.5)))
    plan["manipulation"]["object_q"] = (value[0] + bent * (value[-1] - value[0])).tolist()
    return True


@corruption
def hold_shifted(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Shift the first or last state of a grasp by 1 to 10 states."""
    k, *ends = random_grasp(plan, rng)
    ends[rng.integers(2)] += int(rng.choice([-1, 1]) * rng.integers(1, 11))
    plan["manipulation"]["holds"][k] = ends
    return True


@corruption
def one_hold_for_all(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Replace two grasps by one, without a release."""
    motion = plan["manipulation"]
    if len(motion["holds"]) < 2:
        return False
    motion["holds"] = [[0, len(motion["q"]) - 1]]
    kept = int(rng.integers(2))
    for key in ("turn_axes", "families", "hold_words"):
        motion[key] = [motion[key][kept]]
    return True


@corruption
def no_path_between_holds(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Remove some or all states between two grasps."""
    motion = plan["manipulation"]
    if len(motion["holds"]) < 2:
        return False
    (first, end), (begin, last) = motion["holds"]
    cut = int(rng.integers(end + 1, begin))
    gone = range(cut, begin)
    for key in ROWS:
        motion[key] = [row for i, row in enumerate(motion[key]) if i not in gone]
    motion["holds"] = [[first, end], [begin - len(gone), last - len(gone)]]
    return True


@corruption
def waypoints_between_holds_cut(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Replace some states between two grasps by a straight line."""
    motion = plan["manipulation"]
    if len(motion["holds"]) < 2 or motion["holds"][1][0] - motion["holds"][0][1] < 4:
        return False
    end, begin = motion["holds"][0][1], motion["holds"][1][0]
    a = int(rng.integers(end, begin - 2))
    b = int(rng.integers(a + 2, begin + 1))
    share = np.linspace(0, 1, b - a + 1)[:, None]
    ends = np.array(motion["q"][a]), np.array(motion["q"][b])
    motion["q"][a : b + 1] = (ends[0] + share * (ends[1] - ends[0])).tolist()
    return True


@corruption
def part_moves_untouched(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Move the part by 0.001 to 0.05 while the hand is away."""
    motion = plan["manipulation"]
    if len(motion["holds"]) < 2:
        return False
    step = abs(amount(rng, 0.001, 0.05)) * np.sign(motion["object_q"][-1] - motion["object_q"][0])
    for i in range(motion["holds"][1][0], len(motion["object_q"]) - 1):
        motion["object_q"][i] += step
    return True


@corruption
def another_axis(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Tilt the axis about which the hand may turn by 5 to 90 degrees, or remove it."""
    axes = plan["manipulation"]["turn_axes"]
    with_axis = [i for i, axis in enumerate(axes) if axis is not None]
    if not with_axis:
        return False
    k = int(rng.choice(with_axis))
    if rng.random() < 0.2:
        axes[k] = None
        return True
    axis = np.array(axes[k])
    across = np.cross(axis, rng.normal(size=3))
    across /= np.linalg.norm(across)
    tilt = rng.uniform(np.radians(5), np.pi / 2)
    axes[k] = (np.cos(tilt) * axis + np.sin(tilt) * across).tolist()
    return True


@corruption
def stops_early(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Remove the last 1 to 30 % of the states."""
    motion = plan["manipulation"]
    count = len(motion["q"])
    left = count - max(1, int(rng.uniform(0.01, 0.3) * count))
    for key in ROWS:
        motion[key] = motion[key][:left]
    motion["holds"][-1][1] = left - 1
    return True


@corruption
def states_left_out(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Remove some states within a grasp: a wider step, or a jump."""
    k, first, last = random_grasp(plan, rng)
    if last - first < 8:
        return False
    gone = int(rng.integers(1, min(30, last - first - 4)))
    at = int(rng.integers(first + 1, last - gone))
    motion = plan["manipulation"]
    for key in ROWS:
        del motion[key][at : at + gone]
    holds = motion["holds"]
    holds[k][1] -= gone
    for later in holds[k + 1 :]:
        later[0], later[1] = later[0] - gone, later[1] - gone
    return True


@corruption
def two_states_exchanged(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Swap two states that are 1 to 10 apart."""
    motion = plan["manipulation"]
    i = int(rng.integers(len(motion["q"]) - 1))
    j = min(len(motion["q"]) - 1, i + int(rng.integers(1, 11)))
    for key in ROWS:
        motion[key][i], motion[key][j] = motion[key][j], motion[key][i]
    return True


@corruption
def approach_cut(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Remove some states of the approach."""
    approach = plan["approach"]
    if len(approach) < 4:
        return False
    a = int(rng.integers(1, len(approach) - 2))
    b = int(rng.integers(a + 1, len(approach)))
    del approach[a:b]
    return True


@corruption
def another_goal(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Change the task's value by 1 to 30 %."""
    plan["task"]["to"] *= 1 + amount(rng, 0.01, 0.3)
    return True


def corrupted_plans(
    robots: tuple[str, ...], subset: str | None, count: int, folder: Path
) -> Iterator[tuple[Path, Robot]]:
    """Yield plan files of openings of objects in which the hand turns or regrasps."""
    found = 0
    for k, (name, _, scene, joint) in enumerate(object_tasks(subset, robots)):
        robot, reach = arm(name)
        try:
            written = saved(scene, folder)
            task = make_task(written, "open", "object", joint)
            plan = plan_base_placement(written, robot, task, reach, config=CONFIG).plan
        except MomaposError as error:
            print(f"{name}, {scene.name}/{joint}: {error}", file=sys.stderr)
            continue
        holds = () if plan.motion is None else plan.motion.holds
        if len(holds) < 2 and all(hold.turn_axis is None for hold in holds):
            continue
        write_plan(plan, folder / f"plan_{k}.json")
        yield folder / f"plan_{k}.json", robot
        found += 1
        if found == count:
            return


def loaded(verifier: Path) -> ModuleType:
    """Import the independent program."""
    sys.path.insert(0, str(verifier.resolve().parent))
    spec = importlib.util.spec_from_file_location(verifier.stem, verifier)
    if spec is None or spec.loader is None:
        sys.exit(f"{verifier} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def ours(file: Path, root: Path = Path("/")) -> tuple[str, str]:
    """Return the verdict of `momapos verify` on a plan file, and its first reason."""
    try:
        bad = verify_files(file, root).violations
    except MomaposError as error:
        return REFUSED, str(error).replace(str(file), "plan")
    return (REFUSED, bad[0].name) if bad else (ACCEPTED, "")


def theirs(module: ModuleType, file: Path, root: Path = Path("/")) -> tuple[str, str]:
    """Return the verdict of the independent program, and its first reason."""
    options = argparse.Namespace(skip_approach=False, allow_hinge_grasp=True)
    try:
        report, _ = module.verify(json.loads(file.read_text()), file.parent, str(root), options)
    except (OSError, KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        return REFUSED, f"unreadable: {error}"
    bad = report.violations()
    return (REFUSED, f"{bad[0]['check']}: {bad[0]['detail']}") if bad else (ACCEPTED, "")


def broken(
    content: dict[str, Any],
    robot: Robot,
    rng: np.random.Generator,
    kinds: Sequence[str] | None = None,
) -> tuple[str, dict[str, Any]]:
    """Return the name of a corruption that applies to a plan, and the corrupted content.

    Args:
        content: The plan.
        robot: Its robot.
        rng: Source of the corruption and its amount.
        kinds: Corruptions to try in this order, each once; None to draw one that applies.

    Raises:
        ValueError: None of `kinds` applies.
    """
    names = iter(kinds) if kinds else iter(lambda: str(rng.choice(sorted(CORRUPTIONS))), None)
    for name in names:
        changed = copy.deepcopy(content)
        if CORRUPTIONS[name](changed, rng):
            poses = (plan["manipulation"]["T_world_tool"] for plan in (content, changed))
            if operator.eq(*poses):
                recompute_tool_poses(changed, robot)
            return name, changed
    raise ValueError(f"none of {', '.join(kinds or ())} applies to the plan")


def corrupted(
    robots: tuple[str, ...] = ROBOTS, subset: Subset = None, plans: int = 25, count: int = 500,
    verifier: Path | None = None, seed: int = 0, out: Path | None = None,
) -> None:  # fmt: skip
    """Check that `momapos verify` rejects all corrupted plans that an independent checker rejects.

    Plans of the objects of objects.py in which the hand turns about a bar or regrasps are corrupted
    in random ways and by random amounts. A corrupted plan that only the other program rejects is a
    miss. Plans that both accept were changed by less than the tolerances.

    Args:
        robots: Robots of the library.
        subset: Only the objects of one set.
        plans: Number of plans to corrupt.
        count: Number of corrupted plans.
        verifier: Independent check of plan files.
        seed: Seed of the corruptions.
        out: Folder for mutations.json.
    """
    rng, rows = np.random.default_rng(seed), list[dict[str, Any]]()
    other = None if verifier is None else loaded(verifier)
    with tempfile.TemporaryDirectory() as name:
        sources = list(corrupted_plans(robots, subset, plans, Path(name)))
        if not sources:
            sys.exit("no plan turns or regrasps; use more --robots")
        for k in range(count):
            source, robot = sources[k % len(sources)]
            kind, content = broken(json.loads(source.read_text()), robot, rng)
            file = source.with_name("corrupted.json")
            file.write_text(json.dumps(content))
            mine, why = ours(file)
            their, reason = ("", "") if other is None else theirs(other, file)
            rows.append({"spoil": kind, "plan": source.stem, "ours": mine, "why": why,
                         "theirs": their, "their_why": reason})  # fmt: skip
            if their == REFUSED and mine == ACCEPTED:
                emit(rows[-1])
    lines = []
    for name in [*sorted(CORRUPTIONS), "all"]:
        some = [row for row in rows if name in ("all", row["spoil"])]
        by_us, by_them = (sum(row[key] == REFUSED for row in some) for key in ("ours", "theirs"))
        missed = sum(row["theirs"] == REFUSED and row["ours"] == ACCEPTED for row in some)
        lines.append((name.replace("_", " "), len(some), by_us, by_them, missed))
    head = ("corruption", "plans", "rejected", "by the other", "missed")
    print(f"machine: {machine()}\n{len(rows)} corrupted plans\n{markdown(head, lines)}")
    keep_rows(rows, out, "mutations")


BROKEN = ("base_moved", "one_state_off", "states_left_out", "door_lags_behind")
"""How valid plans are broken, in turn; see `mutations.py`."""
WHOLE = "as planned"
SOURCES: tuple[Literal["cases", "kitchens", "objects"], ...] = ("cases", "kitchens", "objects")
PICKED = {"tray_mesh": "can", "tray_box": "can"}
"""Objects that are picked in the small inputs, by file."""


@dataclass(frozen=True)
class Question:
    """One task of one robot; the scene is read or built when it is needed."""

    source: str
    robot: str
    name: str
    """Empty for objects of the test set, which are not to be examined."""
    scene: Callable[[Path], Scene]
    """Returns the scene, as it is in a file; may write the file into a folder."""
    request: tuple[str, ...]
    root: Path


def small_inputs(robots: tuple[str, ...]) -> Iterator[Question]:
    """Yield every opening of the small inputs, and what is picked there."""
    folder = shared().parent / "findings" / "cases"
    for file in sorted([*folder.glob("furniture/*.json"), *folder.glob("rooms/**/*.json")]):
        try:
            scene = load_scene(file)
        except MomaposError as error:
            print(f"{file.stem}: {error}", file=sys.stderr)
            continue
        found: list[tuple[str, ...]] = [("open", *pair) for pair in openable(scene)]
        found += [("pick", item) for name, item in PICKED.items() if name == file.stem]
        for robot in robots:
            for request in found:
                yield Question(
                    "cases", robot, file.stem, partial(unchanged, scene), request, Path("/")
                )


def others(
    robots: tuple[str, ...], sources: tuple[str, ...], rng: np.random.Generator
) -> list[Question]:
    """Return openings of kitchens and objects, in random order, both kinds in turn."""
    kinds: list[list[Question]] = []
    if "kitchens" in sources:
        root = shared() / "bestman"
        scenes = {Path(name).stem: scene_of(name) for name in (*builtin_names(), *SCENES)}
        kinds.append([
            Question("kitchens", robot, name, partial(unchanged, scene), ("open", *pair), root)
            for name, scene in scenes.items()
            for pair in openable(scene)
            for robot in robots
        ])  # fmt: skip
    if "objects" in sources:
        kinds.append([
            Question(
                "objects", robot, name if set_of(name) == SETS[0] else "",
                partial(saved, scene), ("open", "object", joint), Path("/"),
            )
            for robot, name, scene, joint in object_tasks(None, robots)
        ])  # fmt: skip
    shuffled = [[one[i] for i in rng.permutation(len(one))] for one in kinds]
    most = max(map(len, shuffled), default=0)
    return [one[i] for i in range(most) for one in shuffled if i < len(one)]


def unchanged(scene: Scene, _folder: Path) -> Scene:
    """Return a scene that was read from a file."""
    return scene


def planned(question: Question, folder: Path, seed: int) -> Path | None:
    """Return the file of a plan; None if there is none."""
    robot, reach = arm(question.robot)
    try:
        scene = question.scene(folder)
        task, clock = make_task(scene, *question.request), time.process_time
        plan = plan_base_placement(
            scene, robot, task, reach, config=CONFIG, seed=seed, clock=clock
        ).plan
    except MomaposError as error:
        if question.name:
            print(f"{question.name} {' '.join(question.request)}: {error}", file=sys.stderr)
        return None
    if plan.status != "solved":
        return None
    write_plan(plan, folder / "plan.json")
    return folder / "plan.json"


def compared(question: Question, kind: str, file: Path, other: Any) -> dict[str, Any]:
    """Return both verdicts on a plan file as a row; print a disagreement."""
    mine, why = ours(file, question.root)
    their, their_why = theirs(other, file, question.root)
    cause = "" if mine == their else cause_of(why, their_why, file, question.root)
    row = {
        "source": question.source, "robot": question.robot, "scene": question.name,
        "request": question.request, "kind": kind, "ours": mine, "why": why, "theirs": their,
        "their_why": their_why, "cause": cause,
    }  # fmt: skip
    if not question.name:
        row |= {"request": (), "why": "", "their_why": ""}
    if cause:
        emit(row)
    return row


def cause_of(why: str, their_why: str, file: Path, root: Path) -> str:
    """Return the known difference that a disagreement comes from, or that it is unknown.

    Args:
        why: Our first reason; empty if we accept the plan.
        their_why: The first reason of the other program.
        file: The plan.
        root: Folder of the scene's models.
    """
    if why.startswith("base path"):
        return "the drive, which the other program does not check"
    if why == "grasp slips: rotation in the moved part":
        return "the axis about which the hand may turn, which is any for the other program"
    name = json.loads(file.read_text())["scene"]
    scene = read_scene(find_file("scene", name, [file.parent, root], file), root, USER_CACHE)
    for item in scene.objects:
        for link, elements in item.model.static_elements.items():
            if f" in {item.name}/{link} by" in their_why:
                if any(len(element.hulls) > 1 for element in elements):
                    return "pieces of a hollow mesh, a hull for the other program"
                return "another shape of the same link"
    return "unknown"


def agreement(
    verifier: Path, plans: int = 200, robots: tuple[str, ...] = ROBOTS,
    sources: tuple[Literal["cases", "kitchens", "objects"], ...] = SOURCES, seed: int = 0,
    out: Path | None = None,
) -> None:  # fmt: skip
    """Compare both verdicts on plans of three sources, whole and broken in one way each.

    The first plans open everything in the small inputs of other people (furniture and rooms); the
    others open doors and drawers of the built-in kitchens, of the kitchens of placement.py and of
    the rooms of objects.py, drawn at random. Each valid plan is also broken in one way in turn: the
    base moved, a joint value changed, states left out, the part moved without the hand.
    Disagreements are printed, those on objects of the `test` set without their names.

    Args:
        verifier: Independent check of plan files.
        plans: Number of other plans.
        robots: Robots of the library.
        sources: Where the plans come from.
        seed: Seed of the drawn plans, and of the search.
        out: Folder for agreement.json.
    """
    rng, other, rows = np.random.default_rng(seed), loaded(verifier), list[dict[str, Any]]()
    cases = list(small_inputs(robots[:1])) if "cases" in sources else []
    for question in (*cases, *others(robots, sources, rng)):
        if question.source != "cases" and not plans:
            break
        with tempfile.TemporaryDirectory() as name:
            file = planned(question, Path(name), seed)
            if file is None:
                continue
            plans -= question.source != "cases"
            rows.append(compared(question, WHOLE, file, other))
            keep_rows(rows, out, "agreement")
            if rows[-1]["ours"] == REFUSED:
                continue
            content = json.loads(file.read_text())
            kinds = BROKEN if "holds" in content["manipulation"] else BROKEN[:2]
            kind = kinds[len(rows) // 2 % len(kinds)]
            kind, content = broken(content, arm(question.robot)[0], rng, (kind, kinds[0]))
            file.write_text(json.dumps(content))
            rows.append(compared(question, kind, file, other))
    lines = []
    for source, kind in dict.fromkeys((row["source"], row["kind"]) for row in rows):
        some = [row for row in rows if (row["source"], row["kind"]) == (source, kind)]
        counts = Counter((row["ours"] == REFUSED, row["theirs"] == REFUSED) for row in some)
        pairs = ((False, False), (True, True), (False, True), (True, False))
        lines.append((source, kind.replace("_", " "), len(some), *(counts[one] for one in pairs)))
    head = ("plans", "kind", "compared", "both valid", "both invalid", "only ours valid",
            "only theirs valid")  # fmt: skip
    print(f"machine: {machine()}", markdown(head, lines), "", sep="\n")
    whole = Counter(row["cause"] for row in rows if row["kind"] == WHOLE)
    every = Counter(row["cause"] for row in rows if row["cause"])
    found = [(cause, whole[cause], n - whole[cause]) for cause, n in every.items()]
    print(markdown(("disagreement comes from", "whole plans", "broken plans"), found))
    keep_rows(rows, out, "agreement")


if __name__ == "__main__":
    commands(__doc__, corrupted, agreement)
