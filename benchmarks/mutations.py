"""Spoiled plans: does our check refuse all that an independent one refuses?

    python benchmarks/mutations.py [--count 500] [--plans 25] [--set development|test] [--kitchens]
                                   [--robots fetch ...] [--verifier verify_plan.py] [--out DIR]

Takes plans of the objects of `objects.py`, or of the built-in kitchens, in which the hand turns
about a bar or takes hold a second time, spoils each in random ways and by random amounts, and
checks the spoiled files with `momapos verify` and with an independent program, which is imported
where one is named. A spoiled plan that the other refuses and ours does not is a miss. What both let
pass was spoiled by less than the tolerances. Tool poses are computed anew where arm states change,
so that the states are judged and not the poses beside them.
"""

from __future__ import annotations

import argparse
import copy
import importlib.util
import json
import operator
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from momapos.core.cache import default_cache_dir
from momapos.core.errors import MomaposError
from momapos.core.geometry.transforms import pose_planar
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.model_copies import copied
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_names import builtin_names
from momapos.planning.grasps.tasks import make_task, openable
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from momapos.verification.plan_check import verify_files
from objects import CONFIG, SETS, tasks
from placement import ROBOTS, machine
from rows import keep_rows

Spoil = Callable[[dict[str, Any], np.random.Generator], bool]
"""Changes the content of a plan file; False where the plan has nothing of the kind."""
SPOILS: dict[str, Spoil] = {}
ROWS = ("q", "object_q", "T_world_tool")
ACCEPTED, REFUSED = "accepted", "refused"


def spoil(function: Spoil) -> Spoil:
    """Register a way to spoil a plan under its name."""
    SPOILS[function.__name__] = function
    return function


def amount(rng: np.random.Generator, low: float, high: float) -> float:
    """A random size of random sign, as many small ones as large ones."""
    return float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(low), np.log(high))))


def tools_anew(plan: dict[str, Any], robot: Robot) -> None:
    """Tool poses that fit the arm states and the base pose."""
    base, motion = plan["base_pose"], plan["manipulation"]
    T_world_base = pose_planar(np.array([base["x"], base["y"], base["yaw"]]))
    motion["T_world_tool"] = (T_world_base @ robot.chain.tool_poses(np.array(motion["q"]))).tolist()


def some_hold(plan: dict[str, Any], rng: np.random.Generator) -> tuple[int, int, int]:
    """The index of a hold, and its first and last state."""
    k = int(rng.integers(len(plan["manipulation"]["holds"])))
    return k, *plan["manipulation"]["holds"][k]


@spoil
def base_moved(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """By 5 mm to 20 cm, or by 0.5 to 20 degrees."""
    key = str(rng.choice(["x", "y", "yaw"]))
    plan["base_pose"][key] += amount(rng, 0.009, 0.35) if key == "yaw" else amount(rng, 0.005, 0.2)
    return True


@spoil
def one_state_off(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """One joint of one state, by 0.01 to 0.5."""
    q = plan["manipulation"]["q"]
    q[rng.integers(len(q))][rng.integers(len(q[0]))] += amount(rng, 0.01, 0.5)
    return True


@spoil
def one_tool_pose_off(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """The pose beside one state, by 1 to 100 mm."""
    T = plan["manipulation"]["T_world_tool"]
    T[rng.integers(len(T))][rng.integers(3)][3] += amount(rng, 0.001, 0.1)
    return True


@spoil
def hand_twists(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Over one hold a joint of the wrist turns more and more, to 1 to 30 degrees."""
    _, first, last = some_hold(plan, rng)
    q = np.array(plan["manipulation"]["q"])
    if last - first < 2:
        return False
    joint = q.shape[1] - 1 - int(rng.integers(3))
    q[first : last + 1, joint] += amount(rng, 0.02, 0.5) * np.linspace(0, 1, last - first + 1)
    q[last + 1 :, joint] += q[last, joint] - plan["manipulation"]["q"][last][joint]
    plan["manipulation"]["q"] = q.tolist()
    return True


@spoil
def door_lags_behind(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """The part's values are bent between the same ends, by 1 to 50 %."""
    value = np.array(plan["manipulation"]["object_q"])
    share = (value - value[0]) / (value[-1] - value[0])
    bent = share ** (1 + abs(amount(rng, 0.01, 0.5)))
    plan["manipulation"]["object_q"] = (value[0] + bent * (value[-1] - value[0])).tolist()
    return True


@spoil
def hold_begins_elsewhere(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """The first or last state of a hold is 1 to 10 states earlier or later."""
    k, *ends = some_hold(plan, rng)
    ends[rng.integers(2)] += int(rng.choice([-1, 1]) * rng.integers(1, 11))
    plan["manipulation"]["holds"][k] = ends
    return True


@spoil
def one_hold_for_all(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """The plan does not say that the hand lets go."""
    motion = plan["manipulation"]
    if len(motion["holds"]) < 2:
        return False
    motion["holds"] = [[0, len(motion["q"]) - 1]]
    kept = int(rng.integers(2))
    for key in ("turn_axes", "families", "hold_words"):
        motion[key] = [motion[key][kept]]
    return True


@spoil
def no_way_between_holds(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """The states between two holds are left out, all or some of them."""
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


@spoil
def way_between_holds_cut(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Some states between two holds lie on the straight line between their neighbors."""
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


@spoil
def part_moves_untouched(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """The part goes on by 0.001 to 0.05 while the hand is away."""
    motion = plan["manipulation"]
    if len(motion["holds"]) < 2:
        return False
    step = abs(amount(rng, 0.001, 0.05)) * np.sign(motion["object_q"][-1] - motion["object_q"][0])
    for i in range(motion["holds"][1][0], len(motion["object_q"]) - 1):
        motion["object_q"][i] += step
    return True


@spoil
def another_axis(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """The axis about which the hand may turn is tilted by 5 to 90 degrees, or gone."""
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


@spoil
def stops_early(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """The last 1 to 30 % of the states are missing."""
    motion = plan["manipulation"]
    count = len(motion["q"])
    left = count - max(1, int(rng.uniform(0.01, 0.3) * count))
    for key in ROWS:
        motion[key] = motion[key][:left]
    motion["holds"][-1][1] = left - 1
    return True


@spoil
def states_left_out(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Some states in the middle of a hold are missing: a wider step, or a jump."""
    k, first, last = some_hold(plan, rng)
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


@spoil
def two_states_exchanged(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Two states, 1 to 10 apart, change places."""
    motion = plan["manipulation"]
    i = int(rng.integers(len(motion["q"]) - 1))
    j = min(len(motion["q"]) - 1, i + int(rng.integers(1, 11)))
    for key in ROWS:
        motion[key][i], motion[key][j] = motion[key][j], motion[key][i]
    return True


@spoil
def approach_cut(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """Some of the states on the way to the grasp are left out."""
    approach = plan["approach"]
    if len(approach) < 4:
        return False
    a = int(rng.integers(1, len(approach) - 2))
    b = int(rng.integers(a + 1, len(approach)))
    del approach[a:b]
    return True


@spoil
def another_goal(plan: dict[str, Any], rng: np.random.Generator) -> bool:
    """The task asks for 1 to 30 % more or less."""
    plan["task"]["to"] *= 1 + amount(rng, 0.01, 0.3)
    return True


def openings(args: argparse.Namespace) -> Iterator[tuple[str, Scene, str, str]]:
    """Robot, room, object and joint of what is opened."""
    if not args.kitchens:
        for name, _, scene, joint in tasks(args.set, args.robots):
            yield name, scene, "object", joint
        return
    scenes = [load_scene(name) for name in builtin_names()]
    for name in args.robots:
        for scene in scenes:
            for item, joint in openable(scene):
                yield name, scene, item, joint


def plans(args: argparse.Namespace, folder: Path) -> Iterator[tuple[Path, Robot]]:
    """Plan files of openings in which the hand turns or takes hold a second time."""
    robots = {name: load_robot(name) for name in args.robots}
    found = 0
    for k, (name, scene, item, joint) in enumerate(openings(args)):
        robot = robots[name]
        reach = load_reach_map(robot, default_cache_dir(), None)
        file = folder / f"scene_{k}.json"
        try:
            with copied(scene, file) as near:
                written = save_scene(near, file)
            task = make_task(written, "open", item, joint)
            plan = plan_base_placement(written, robot, task, reach, config=CONFIG).plan
        except MomaposError as error:
            print(f"{name}, {scene.name}/{joint}: {error}", file=sys.stderr)
            continue
        holds = () if plan.motion is None else plan.motion.holds
        if len(holds) < 2 and all(hold.turn_axis is None for hold in holds):
            continue
        out = folder / f"plan_{k}.json"
        write_plan(plan, out)
        yield out, robot
        found += 1
        if found == args.plans:
            return


def loaded(verifier: Path) -> ModuleType:
    """The independent program as a module."""
    sys.path.insert(0, str(verifier.resolve().parent))
    spec = importlib.util.spec_from_file_location(verifier.stem, verifier)
    if spec is None or spec.loader is None:
        sys.exit(f"{verifier} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def ours(file: Path) -> tuple[str, str]:
    """What `momapos verify` says of a plan file, and its first reason."""
    try:
        bad = verify_files(file, Path("/")).violations
    except MomaposError as error:
        return REFUSED, str(error).replace(str(file), "plan")
    return (REFUSED, bad[0].name) if bad else (ACCEPTED, "")


def theirs(module: ModuleType, file: Path) -> tuple[str, str]:
    """What the independent program says."""
    options = argparse.Namespace(skip_approach=False, allow_hinge_grasp=True)
    try:
        report, _ = module.verify(json.loads(file.read_text()), file.parent, "/", options)
    except (OSError, KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        return REFUSED, f"unreadable: {error}"
    bad = report.violations()
    return (REFUSED, bad[0]["check"]) if bad else (ACCEPTED, "")


def spoiled(
    content: dict[str, Any], robot: Robot, rng: np.random.Generator
) -> tuple[str, dict[str, Any]]:
    """A way to spoil a plan that it has something for, and the spoiled content."""
    while True:
        name = str(rng.choice(sorted(SPOILS)))
        changed = copy.deepcopy(content)
        if SPOILS[name](changed, rng):
            poses = (plan["manipulation"]["T_world_tool"] for plan in (content, changed))
            if operator.eq(*poses):
                tools_anew(changed, robot)
            return name, changed


def report(rows: list[dict[str, Any]]) -> str:
    """A table by way of spoiling."""
    lines = [f"machine: {machine()}", f"{len(rows)} spoiled plans"]
    lines += ["| spoiled by | plans | refused | by the other | missed |", "|---|---|---|---|---|"]
    for name in [*sorted(SPOILS), "all"]:
        mine = [row for row in rows if name in ("all", row["spoil"])]
        refused = sum(row["ours"] == REFUSED for row in mine)
        other = Counter(row["theirs"] for row in mine)[REFUSED]
        missed = sum(row["theirs"] == REFUSED and row["ours"] == ACCEPTED for row in mine)
        lines.append(f"| {name.replace('_', ' ')} | {len(mine)} | {refused} | {other} | {missed} |")
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500, help="spoiled plans")
    parser.add_argument("--plans", type=int, default=25, help="plans to spoil")
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--set", choices=SETS, help="only the objects of one set")
    parser.add_argument("--kitchens", action="store_true", help="the built-in kitchens")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--verifier", type=Path, help="independent check of plan files")
    parser.add_argument("--out", type=Path, help="folder for mutations.json")
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    other = None if args.verifier is None else loaded(args.verifier)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        sources = list(plans(args, Path(name)))
        if not sources:
            sys.exit("no plan turns or takes hold twice; ask for more --robots")
        for k in range(args.count):
            source, robot = sources[k % len(sources)]
            kind, content = spoiled(json.loads(source.read_text()), robot, rng)
            file = source.with_name("spoiled.json")
            file.write_text(json.dumps(content))
            verdict, why = ours(file)
            said, reason = ("", "") if other is None else theirs(other, file)
            row = {"spoil": kind, "plan": source.stem, "ours": verdict, "why": why}
            rows.append({**row, "theirs": said, "their_why": reason})
            if said == REFUSED and verdict == ACCEPTED:
                print(json.dumps(rows[-1]), flush=True)
    print(report(rows))
    keep_rows(rows, args.out, "mutations")


if __name__ == "__main__":
    main()
