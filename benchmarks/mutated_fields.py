"""Mutate each field of plan files; let `verify`, an independent program and physics judge.

    python benchmarks/mutated_fields.py [PLAN ...] [--count 3000] [--seed 0] [--judged 300]
                                        [--runs 60] [--verifier verify_plan.py] [--out DIR]

The PLANs are mutated, by default plans of the built-in kitchens of all kinds (`SOURCES`). Each
mutated file has one field of the schema changed, in rotation, so that no field is left out: a
number by a random amount, states by an entry, a row, a column, a bump or an exchange, a name by
another one of the same files, a member by its absence. Where arm or base states changed, half of
the files get tool poses that agree with them.

A mutation is wrongly valid if `momapos verify` accepts it, and the independent program rejects it,
or `run --exact` fails where it succeeds with the original. These take seconds, so --judged of the
accepted ones are drawn for the program, and --runs of these for physics, as evenly over the fields
as possible. A field that is DESCRIPTIVE
holds words, statistics or the question, which change nothing physical: such a mutation stays valid.
"""

from __future__ import annotations

import copy
import functools
import itertools
import json
import operator
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import tyro

from momapos.apps.cli.loading import open_plan
from momapos.apps.cli.main import main as momapos
from momapos.apps.schemas import schema_of
from momapos.core import USER_CACHE, MomaposError
from momapos.model.plan_files import read_plan
from momapos.model.robots import Robot
from momapos.model.scene import Scene, as_planned
from momapos.simulation import run_exactly
from momapos.verification import find_file, plan_check, plan_claims, read_scene
from mutations import ACCEPTED, REFUSED, amount, loaded, ours, recompute_tool_poses, theirs
from placement import machine
from rows import commands, emit, keep_rows, markdown

SOURCES = (
    "open kitchen_small fridge/door_hinge --robot segway_ur5e",
    "open kitchen_small cabinet_right/drawer_top_slide --robot fetch",
    "close kitchen_small fridge/door_hinge --joint fridge/door_hinge=80deg --robot fetch",
    "open kitchen_island oven/door_hinge --robot fetch",
    "open kitchen_small fridge/door_hinge --robot ranger_rm63",
    "open kitchen_small microwave --robot stretch --base moving",
    "pick kitchen_small bottle --robot fetch",
    "place kitchen_small bottle --robot fetch",
    "open kitchen_small fridge/door_hinge --robot fetch then close fridge/door_hinge",
)
"""What `momapos place` plans; the last one is a tour of two plans with paths home."""
PHYSICAL = (
    "scene", "robot.urdf", "robot.base_link", "robot.tool_link", "robot.file", "robot.srdf",
    "robot.rest", "robot.arm", "robot.drive", "robot.min_turning_radius", "task.verb",
    "task.object", "task.joint", "task.to", "task.follower", "task.level", "task.speed",
    "task.poses", "status", "joints", "scene_joints",
    "scene_hypotheses", "resistance", "loads.payload", "start", "base_pose", "base_path",
    "approach", "approach_times", "home", "manipulation.q", "manipulation.object_q",
    "manipulation.T_world_tool", "manipulation.base", "manipulation.latch_q",
    "manipulation.times", "manipulation.holds", "manipulation.turn_axes",
    "manipulation.families", "region.keep_in", "region.keep_out", "overrides",
)  # fmt: skip
"""Fields that say where something is, how it moves or what it is."""
DESCRIPTIVE = {
    "format": "the reader checks it", "version": "the reader checks it",
    "robot.name": "a title", "task.farthest": "the question", "assumption": "words",
    "loads.efforts": "measured again", "loads.stability": "measured again",
    "loads.notes": "words", "feasible_to": "of infeasible answers",
    "feasible_from": "of infeasible answers", "feasible_sure": "of infeasible answers",
    "advice": "words", "manipulation.hold_words": "words", "navigation_cost": "a cost",
    "cost": "a cost", "candidates": "statistics", "importance": "statistics",
    "tolerance": "statistics", "region.facing": "the question",
    "region.most_driving": "the question", "notes": "words", "timing": "statistics",
    "method": "a title", "seed": "a number of the search", "versions": "titles",
    "hashes": "a note says that files changed",
}  # fmt: skip
"""Fields that change nothing physical, and why."""
STATES = ("approach", "home", "base_path", "manipulation.q", "manipulation.object_q",
          "manipulation.T_world_tool", "manipulation.base", "manipulation.latch_q",
          "manipulation.times", "approach_times")  # fmt: skip
OPTIONAL = ("robot.file", "robot.srdf", "robot.rest", "robot.arm", "robot.drive", "scene_joints",
            "resistance", "start", "base_path", "home", "manipulation.holds",
            "manipulation.latch_q", "manipulation.base", "manipulation.families",
            "manipulation.turn_axes", "manipulation.times", "approach_times", "loads.payload",
            "robot.min_turning_radius")  # fmt: skip
"""Fields that a mutation may remove."""


def fields_of(name: str) -> set[str]:
    """Return the fields of a plan schema: members, and those of robot, task and so on by dots."""
    schema = schema_of(name)
    parts, found = schema["$defs"], set()
    whole = {"PlanRobot", "PlanTask", "Manipulation", "PlanRegion", "MotionLoads"}
    for member, value in schema["properties"].items():
        refs = {r.rpartition("/")[2] for r in _refs(value)} & whole
        if refs:
            found |= {f"{member}.{key}" for key in parts[refs.pop()]["properties"]}
        else:
            found.add(member)
    return found


def _refs(value: dict[str, Any]) -> list[str]:
    return [one["$ref"] for one in (value, *value.get("anyOf", ())) if "$ref" in one]


@dataclass(frozen=True)
class Source:
    """A plan, with what it names."""

    file: Path
    content: dict[str, Any]
    scene: Scene
    robot: Robot

    def names(self, field: str) -> list[Any]:
        """Return other values of a field of names."""
        joints = [joint for item in self.scene.objects for joint in item.model.joints]
        item = self.scene.object(self.content["task"]["object"])
        pools: dict[str, list[Any]] = {
            "robot.base_link": list(self.robot.model.links),
            "robot.tool_link": list(self.robot.model.links),
            "robot.file": ["fetch", "segway_ur5e", "hsr", "no_such.toml"],
            "robot.urdf": [], "robot.srdf": [], "scene": [],
            "robot.arm": ["left", "right"], "robot.drive": ["differential", "omni", "car"],
            "task.verb": ["open", "close", "pick", "place"],
            "task.object": [item.name for item in self.scene.objects],
            "task.joint": [*item.model.joints, *joints], "task.follower": [*item.model.joints, "x"],
            "status": ["solved", "assumed"], "joints": list(self.robot.model.joints),
        }  # fmt: skip
        return pools.get(field, [])


def sources(folder: Path, given: list[Path]) -> Iterator[Source]:
    """Yield the given plans, or make some; those that `verify` rejects are left out."""
    files = list(given)
    for k, words in enumerate(() if given else SOURCES):
        out = folder / f"plan_{k}.json"
        tour = " then " in words
        status = momapos(["place", *words.split(), "--out", str(out)])
        if status:
            sys.exit(f"momapos place {words} has no plan")
        files += [out.with_name(f"plan_{k}_{n}.json") for n in (1, 2)] if tour else [out]
    for file in files:
        verdict, why = ours(file)
        if verdict != ACCEPTED:
            print(f"{file.name} is left out: {why}", flush=True)
            continue
        content, scene, robot = open_plan(file, None, None, "to mutate", allow_assumed=False)
        assert content.feasible
        yield Source(file, json.loads(file.read_text()), scene, robot)


def mutate(source: Source, field: str, rng: np.random.Generator) -> dict[str, Any] | None:
    """Return a plan with one field changed; None if the field does not apply to it."""
    plan = copy.deepcopy(source.content)
    *above, key = field.split(".")
    holder = plan
    for one in above:
        holder = holder.get(one) or {}
    if field not in PHYSICAL or not above or holder:
        value = holder.get(key)
    else:
        return None
    if field in OPTIONAL and value not in (None, {}, []) and rng.random() < 0.15:
        del holder[key]
        return plan
    changed = _changed(source, field, value, rng)
    if changed is None or changed == value:
        return None
    holder[key] = changed
    return plan


def _changed(source: Source, field: str, value: Any, rng: np.random.Generator) -> Any:
    names = source.names(field)
    if field in STATES and value:
        return _states(value, rng, grows=field.endswith("times"))
    if field == "manipulation.holds" and value:
        return _shifted(value, len(source.content["manipulation"]["q"]), rng)
    if field == "manipulation.families" and value:
        return [str(rng.choice(["pinch", "hook", "push", "suction", ""])) for _ in value]
    if field == "manipulation.turn_axes" and value:
        axis = rng.normal(size=3)
        return [(axis / np.linalg.norm(axis)).tolist() for _ in value]
    if field == "robot.rest":
        return _some(value or {}, source.robot.model.rest, rng)
    if field == "scene_joints":
        return _other_joints(source, value or {}, rng)
    if field in ("region.keep_in", "region.keep_out"):
        x, y = (source.content["base_pose"][k] + float(rng.normal(0.0, 1.0)) for k in ("x", "y"))
        e = abs(amount(rng, 0.02, 1.0))
        return [[[x - e, y - e], [x + e, y - e], [x + e, y + e], [x - e, y + e]]]
    if field == "robot.min_turning_radius":
        return abs(amount(rng, 0.05, 2.0))
    if field == "joints" and value:
        return _names_of(list(value), names, rng)
    if names:
        return rng.choice(names).item()
    return _generic(value, rng)


def _states(rows: Any, rng: np.random.Generator, *, grows: bool) -> Any:
    """Return states with an entry, a row, a column, a bump, an exchange or a scale changed."""
    array = np.array(rows, float)
    flat = array.reshape(len(array), -1)
    i, j = int(rng.integers(len(flat))), int(rng.integers(flat.shape[1]))
    kind, size = int(rng.integers(6)), amount(rng, 1e-3, 0.5)
    if grows:
        return np.maximum.accumulate(array * abs(amount(rng, 0.05, 5.0))).tolist()
    if kind == 0:
        flat[i, j] += size
    elif kind == 1:
        flat[i] += size * rng.normal(size=flat.shape[1])
    elif kind == 2:
        flat[:, j] += size
    elif kind == 3:
        flat[:, j] += size * np.exp(-(((np.arange(len(flat)) - i) / 8.0) ** 2))
    elif kind == 4:
        k = int(rng.integers(len(flat)))
        flat[[i, k]] = flat[[k, i]]
    else:
        flat[:, j] *= 1.0 + size
    return array.tolist()


def _shifted(holds: Any, count: int, rng: np.random.Generator) -> Any:
    holds = [list(one) for one in holds]
    k, end = int(rng.integers(len(holds))), int(rng.integers(2))
    holds[k][end] = int(np.clip(holds[k][end] + rng.integers(-20, 21), 0, count - 1))
    return holds


def _some(values: dict[str, float], rest: dict[str, float], rng: np.random.Generator) -> Any:
    name = str(rng.choice(sorted({*values, *rest, "no_such_joint"})))
    return {**values, name: values.get(name, rest.get(name, 0.0)) + amount(rng, 1e-3, 1.0)}


def _other_joints(source: Source, values: Any, rng: np.random.Generator) -> Any:
    places = [(o.name, j) for o in source.scene.objects for j in o.model.joints]
    name, joint = places[int(rng.integers(len(places)))]
    record = source.scene.object(name).joint(joint)
    low, high = np.clip([record.lower, record.upper], -3.0, 3.0)
    at = float(rng.uniform(low - 0.1 * (high - low), high))
    return {**values, name: {**values.get(name, {}), joint: at}}


def _names_of(names: list[str], pool: list[str], rng: np.random.Generator) -> list[str]:
    k = int(rng.integers(len(names)))
    if rng.random() < 0.4:
        i = int(rng.integers(len(names)))
        names[i], names[k] = names[k], names[i]
    elif rng.random() < 0.5:
        del names[k]
    else:
        names[k] = str(rng.choice(pool))
    return names


def _generic(value: Any, rng: np.random.Generator) -> Any:
    """Return another value of the same kind; None for an empty one."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value * (1.0 + amount(rng, 0.02, 1.0)) + amount(rng, 1e-3, 0.5)
    if isinstance(value, str):
        return value + "x"
    if isinstance(value, dict) and value:
        key = str(rng.choice(sorted(value)))
        other = _generic(value[key], rng)
        return None if other is None else {**value, key: other}
    if isinstance(value, list) and value:
        k = int(rng.integers(len(value)))
        other = _generic(value[k], rng)
        return None if other is None else [*value[:k], other, *value[k + 1 :]]
    return None


def physics(file: Path) -> tuple[str, str]:
    """Return the verdict of `run --exact` on a plan file, without other checks, and its reason."""
    try:
        plan = read_plan(file)
        folders = [file.resolve().parent, Path()]
        scene = read_scene(find_file("scene", plan.scene, folders, file), None)
        urdf = find_file("robot.urdf", plan.robot_urdf, folders, file)
        robot = plan_claims.read_robot_of(plan, urdf, folders, USER_CACHE)
        assert robot is not None
        record = run_exactly(plan, as_planned(scene, plan), robot)
    except MomaposError as error:
        return REFUSED, str(error)
    return (ACCEPTED, "") if record.success else (REFUSED, record.reason)


def drawn(rows: list[dict[str, Any]], runs: int, rng: np.random.Generator) -> list[int]:
    """Return indices of accepted physical mutations, as evenly over their fields as possible."""
    by_field: dict[str, list[int]] = defaultdict(list)
    for k in rng.permutation(len(rows)).tolist():
        if rows[k]["ours"] == ACCEPTED and rows[k]["field"] in PHYSICAL:
            by_field[rows[k]["field"]].append(k)
    turns = [(n, k) for some in by_field.values() for n, k in enumerate(some)]
    return [k for _, k in sorted(turns)[:runs]]


def judge(
    rows: list[dict[str, Any]],
    files: list[tuple[Path, Path]],
    chosen: list[int],
    runs: int,
    other: ModuleType | None,
) -> None:
    """Let geometry judge the chosen mutations, and physics the first of them.

    Args:
        rows: A row for each mutation, which gets the verdicts.
        files: Its file, and that of the plan.
        chosen: Indices of accepted mutations.
        runs: How many of them to run.
        other: The independent program; None for none.
    """
    whole: dict[Path, str] = {}
    ran: dict[Path, str] = {}
    for n, k in enumerate(chosen):
        (file, original), row = files[k], rows[k]
        if other is not None:
            if original not in whole:
                whole[original] = theirs(other, original)[0]
            if whole[original] == ACCEPTED:
                row["theirs"], row["their_why"] = theirs(other, file)
        if n < runs:
            if original not in ran:
                ran[original] = physics(original)[0]
            if ran[original] == ACCEPTED:
                row["physics"], row["reason"] = physics(file)
        if REFUSED in (row["theirs"], row["physics"]):
            emit(row)
    print(f"originals by geometry: {_named(whole)}; in physics: {_named(ran)}")


def _named(verdicts: dict[Path, str]) -> dict[str, str]:
    return {file.stem: verdict for file, verdict in verdicts.items()}


def report(rows: list[dict[str, Any]]) -> str:
    """Return a table by field."""
    lines = []
    for name in [*PHYSICAL, "descriptive", "all"]:
        own = DESCRIPTIVE if name == "descriptive" else (name,)
        mine = [row for row in rows if name == "all" or row["field"] in own]
        accepted = [row for row in mine if row["ours"] == ACCEPTED]
        later = []
        for judge_ in ("theirs", "physics"):
            seen = [row[judge_] == REFUSED for row in accepted if row[judge_]]
            later.append(f"{sum(seen)} of {len(seen)}")
        if mine:
            lines.append((name, len(mine), len(mine) - len(accepted), *later))
    head = ("field", "plans", "rejected", "then by geometry", "then by physics")
    return f"machine: {machine()}\n{len(rows)} mutated plans\n{markdown(head, lines)}"


def main(
    plans: tyro.conf.Positional[tuple[Path, ...]] = (), count: int = 3000, judged: int = 300,
    runs: int = 60, seed: int = 0, verifier: Path | None = None, out: Path | None = None,
) -> None:  # fmt: skip
    """Mutate plans, let all judge, and print a table by field.

    Args:
        plans: Plan files; by default those of `SOURCES`.
        count: Number of mutations.
        judged: Number of accepted ones for the independent program.
        runs: Number of these to run in physics.
        seed: Seed of the mutations.
        verifier: Independent check of plan files.
        out: Folder for mutated_fields.json.
    """
    # The files that the plans name stay the same; reading them takes most of the time.
    for module, name in (
        (plan_check, "read_scene"), (plan_check, "read_urdf"), (plan_claims, "load_robot"),
    ):  # fmt: skip
        setattr(module, name, functools.cache(getattr(module, name)))
    rng = np.random.default_rng(seed)
    other = None if verifier is None else loaded(verifier)
    rows: list[dict[str, Any]] = []
    files: list[tuple[Path, Path]] = []
    # Physical fields come three times as often.
    order = itertools.cycle([*PHYSICAL, *PHYSICAL, *PHYSICAL, *DESCRIPTIVE])
    with tempfile.TemporaryDirectory() as name:
        made = list(sources(Path(name), list(plans)))
        while len(rows) < count:
            field, source = next(order), made[int(rng.integers(len(made)))]
            changed = mutate(source, field, rng)
            if changed is None:
                continue
            poses = (plan["manipulation"]["T_world_tool"] for plan in (source.content, changed))
            moved = field in ("manipulation.q", "base_pose") and operator.eq(*poses)
            if moved and "base" not in changed["manipulation"] and rng.random() < 0.5:
                recompute_tool_poses(changed, source.robot)
            file = source.file.with_name(f"mutated_{len(rows)}.json")
            file.write_text(json.dumps(changed))
            verdict, why = ours(file)
            rows.append({
                "field": field, "plan": source.file.stem, "ours": verdict, "why": why,
                "theirs": "", "their_why": "", "physics": "", "reason": "",
            })  # fmt: skip
            files.append((file, source.file))
            if verdict != ACCEPTED:
                file.unlink()
        try:
            judge(rows, files, drawn(rows, judged, rng), runs, other)
        finally:
            for file, _ in files:
                file.unlink(missing_ok=True)
    print(report(rows))
    print(f"fields: {dict(Counter(row['field'] for row in rows))}")
    keep_rows(rows, out, "mutated_fields")


if __name__ == "__main__":
    commands(__doc__, main)
