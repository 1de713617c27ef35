"""Check that `momapos verify` rejects all corrupted plans that an independent checker rejects.

    python benchmarks/mutations.py [--count 500] [--plans 25] [--set development|test] [--kitchens]
                                   [--robots fetch ...] [--verifier verify_plan.py] [--out DIR]

Plans of the objects of `objects.py`, or of the built-in kitchens, in which the hand turns about a
bar or regrasps, are corrupted in random ways and by random amounts. The files are checked with
`momapos verify` and with an independent program, which --verifier names. A corrupted plan that only
the other program rejects is a miss. Plans that both accept were changed by less than the
tolerances. Tool poses are recomputed after a change of arm states, so that the states themselves
are checked.
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
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from momapos.apps.bench.articulated import SETS
from momapos.core import MomaposError, default_cache_dir
from momapos.core.geometry import pose_planar
from momapos.model.plan_files import write_plan
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, builtin_names, copied, load_scene, save_scene
from momapos.planning import plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.reachability import load_reach_map
from momapos.verification import verify_files
from objects import CONFIG, tasks
from placement import ROBOTS, machine
from rows import keep_rows

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


def openings(args: argparse.Namespace) -> Iterator[tuple[str, Scene, str, str]]:
    """Yield robot, room, object and joint of each opening."""
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
    """Yield plan files of openings in which the hand turns or regrasps."""
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


def corrupted(
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


def report(rows: list[dict[str, Any]]) -> str:
    """Return a table by corruption."""
    lines = [f"machine: {machine()}", f"{len(rows)} corrupted plans"]
    lines += ["| corruption | plans | rejected | by the other | missed |", "|---|---|---|---|---|"]
    for name in [*sorted(CORRUPTIONS), "all"]:
        mine = [row for row in rows if name in ("all", row["spoil"])]
        refused = sum(row["ours"] == REFUSED for row in mine)
        other = Counter(row["theirs"] for row in mine)[REFUSED]
        missed = sum(row["theirs"] == REFUSED and row["ours"] == ACCEPTED for row in mine)
        lines.append(f"| {name.replace('_', ' ')} | {len(mine)} | {refused} | {other} | {missed} |")
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500, help="number of corrupted plans")
    parser.add_argument("--plans", type=int, default=25, help="number of plans to corrupt")
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
            sys.exit("no plan turns or regrasps; use more --robots")
        for k in range(args.count):
            source, robot = sources[k % len(sources)]
            kind, content = corrupted(json.loads(source.read_text()), robot, rng)
            file = source.with_name("corrupted.json")
            file.write_text(json.dumps(content))
            verdict, why = ours(file)
            their_verdict, reason = ("", "") if other is None else theirs(other, file)
            row = {"spoil": kind, "plan": source.stem, "ours": verdict, "why": why}
            rows.append({**row, "theirs": their_verdict, "their_why": reason})
            if their_verdict == REFUSED and verdict == ACCEPTED:
                print(json.dumps(rows[-1]), flush=True)
    print(report(rows))
    keep_rows(rows, args.out, "mutations")


if __name__ == "__main__":
    main()
