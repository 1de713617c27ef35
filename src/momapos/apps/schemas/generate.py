"""Generate JSON Schemas and tables of members from the records that files are read into."""

from __future__ import annotations

import ast
import inspect
import json
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal

import msgspec

from momapos.model.plan_files import PlanAssumption
from momapos.model.records import Status, Verb

WORDS: dict[str, dict[str, str]] = {
    "Plan": {
        "format": "Name of the format.",
        "version": "Version of the format.",
        "scene": "Path of the scene file, relative to the plan.",
        "robot": "The robot.",
        "task": "The task.",
        "status": "Whether there is a motion; `assumed`: for a less probable joint.",
        "joints": "Names of the joints in each state: arm, and what follows it.",
        "scene_joints": "Joint values that differ from the scene file, by object and joint "
                        "[rad] or [m].",
        "scene_hypotheses": "Index of the assumed hypothesis, by object and joint.",
        "assumption": "What an assumed plan assumes.",
        "resistance": "Known resistance of the moved part, by object and joint.",
        "overrides": "Forces and masses that the user has set, against or beyond the files.",
        "loads": "Worst loads of the motion.",
        "feasible_to": "Largest feasible value of an infeasible task [rad] or [m].",
        "feasible_from": "A base pose from which it is feasible.",
        "feasible_sure": "Whether the part itself is blocked beyond this value.",
        "advice": "A change with which a plan exists.",
        "start": "Pose of the base before the task.",
        "base_pose": "Pose of the base at which the arm moves.",
        "base_path": "Poses of the base from the start to the base pose: x [m], y [m], yaw [rad].",
        "approach": "States of the arm from home to the grasp [rad] or [m].",
        "approach_times": "Time of each state of the approach [s].",
        "home": "States of the arm on its way home after the task [rad] or [m].",
        "manipulation": "The motion from the grasp on.",
        "navigation_cost": "Length of the drive [m].",
        "cost": "Terms of the cost of the base pose, by name.",
        "candidates": "The base poses that were examined.",
        "importance": "The objects that were modeled with joints.",
        "tolerance": "How far the base may be from its pose.",
        "region": "Where the base was allowed to stand.",
        "notes": "What a user should know, one line each.",
        "timing": "Computing time by stage, and `total` of the search [s].",
        "method": "Method of choosing base poses.",
        "seed": "Seed of the search.",
        "versions": "Versions of the packages that the answer depends on.",
    },
    "PlanRobot": {
        "name": "Name of the robot.",
        "urdf": "Path of its URDF, relative to the plan.",
        "base_link": "Link on the floor.",
        "tool_link": "Link whose frame is the tool frame.",
        "file": "Name of a library robot, or path of a robot file.",
        "srdf": "Path of an SRDF that is not next to the URDF.",
        "rest": "Values of joints that the plan does not move, by joint [rad] or [m].",
        "arm": "The arm, of a robot with several.",
        "drive": "How the base drives.",
        "min_turning_radius": "Least turning radius of a car-like base [m].",
    },
    "PlanTask": {
        "verb": "What to do.",
        "object": "The object.",
        "joint": "The joint to move; null for a rigid object.",
        "to": "Value that it must reach [rad] or [m].",
        "farthest": "Whether this is the largest value that works.",
        "follower": "Joint that the user named, which follows `joint`; empty if none.",
    },
    "PlanPose": {"x": "[m]", "y": "[m]", "yaw": "[rad]"},
    "Manipulation": {
        "q": "States of the arm, in the order of `joints` [rad] or [m].",
        "object_q": "Value of the moved joint at each state [rad] or [m].",
        "T_world_tool": "Pose of the tool frame in the world at each state, 4 x 4.",
        "latch_q": "Value of the latch at each state [rad] or [m].",
        "times": "Time of each state from the grasp on [s].",
        "holds": "First and last state of each phase in which the hand holds the part.",
        "turn_axes": "Axis about which the hand may turn in each phase, in the moved link's frame.",
        "families": "Kind of grasp of each phase: pinch, hook, push or suction.",
        "hold_words": "What is held and how, of each phase.",
    },
    "PlanNearestMiss": {"base_pose": "The base pose.", "reason": "What stopped it."},
    "PlanCandidates": {
        "sampled": "Number of base poses [-].",
        "checked": "Number of base poses that were checked for an arm path [-].",
        "rejections": "Number of rejected base poses, by reason [-].",
        "nearest": "The rejected base pose that came nearest.",
    },
    "PlanImportance": {
        "scorer": "How objects were scored.",
        "alpha": "Score from which objects are modeled [-].",
        "names": "Modeled objects.",
        "scores": "Score of each object [-].",
        "rounds": "How often a plan was checked again with more objects [-].",
    },
    "PlanRegion": {
        "keep_in": "Areas in which the base must stand: corners x, y [m].",
        "keep_out": "Areas that it must not touch, standing or driving: corners x, y [m].",
        "facing": "Largest angle between its x axis and the direction to the grasp [rad].",
        "most_driving": "Longest drive [m].",
    },
    "PlanTolerance": {
        "radius": "Replanning succeeded from all sampled poses within this distance [m],",
        "turn": "and within this turn [rad].",
        "samples": "Number of sampled poses [-].",
    },
    "PlanCostTerm": {"value": "Before weighting.", "weight": "Its weight."},
    "PlanAssumption": {
        "kind": "Assumed kind of the part.",
        "probability": "Its probability [-].",
        "instead_of": "Most probable kind.",
        "instead_probability": "Its probability [-].",
        "feasible_to": "How far the most probable joint opens [rad] or [m].",
    },
}  # fmt: skip
"""Descriptions by record and member."""


DIALECT = "https://json-schema.org/draft/2020-12/schema"
Schema = dict[str, Any]
_NONZERO = ("seal_travel", "lever", "mass")
"""Members of a resistance that are above 0."""
_BASE: Schema = {
    "type": "array",
    "description": "Pose of the base at each state: x [m], y [m], yaw [rad].",
    "items": {
        "type": "array", "minItems": 3, "maxItems": 3, "prefixItems": [{"type": "number"}] * 3,
        "items": False,
    },
}  # fmt: skip


def schema_of(name: str) -> Schema:
    """Return the JSON Schema of a format, one of `SCHEMAS`."""
    title, make = SCHEMAS[name]
    head = {"$schema": DIALECT, "$id": f"urn:momapos:schema:{name}", "title": title}
    return {**head, **make(), "title": title}


def _scene() -> Schema:
    from momapos.model.scene import SceneFile

    made = _schema(SceneFile)
    entry = made["$defs"]["SceneEntry"]
    entry["oneOf"] = [{"required": ["urdf"]}, {"required": ["box"]}]
    known = made["$defs"]["JointResistance"]
    known["additionalProperties"] = False
    for name, member in known["properties"].items():
        if name != "balanced":
            member["anyOf"][0] |= {"minimum": 1e-6 if name in _NONZERO else 0, "maximum": 1e5}
    return made


def _robot() -> Schema:
    from momapos.model.robots import RobotFile

    made = _schema(RobotFile)
    arm = ["tool_link", "arm_joints", "gripper_links", "home", "tool"]
    made["$defs"]["RobotArm"]["required"] = arm
    made["oneOf"] = [{"required": arm, "not": {"required": ["arms"]}}, {"required": ["arms"]}]
    return made


def _plan(version: int) -> Schema:
    from momapos.model.plan_files import FORMAT, Plan

    made = _with_head(_schema(Plan), FORMAT, version)
    motion = made["$defs"]["Manipulation"]
    motion["properties"].pop("base", None)
    if version > 1:
        motion["properties"]["base"] = _BASE
        motion["required"] = [*motion["required"], "base"]
    hashes = {"type": "object", "additionalProperties": {"type": "string"}}
    made["properties"]["hashes"] = {
        **hashes, "description": "SHA-256 of the files of scene and robot."
    }  # fmt: skip
    return made


def _tour() -> Schema:
    from momapos.model.plan_files import TOUR, TourFile

    return _with_head(_schema(TourFile), TOUR, 1)


def _run() -> Schema:
    from momapos.simulation import FORMAT, VERSION, RunRecord

    made = _with_head(_schema(RunRecord), FORMAT, VERSION)
    made["properties"] |= {
        "success": {"type": "boolean", "description": "Whether the task was done."},
        "reason": {"type": "string", "description": "Why it was not; empty if it was."},
        "driven": {"type": "number", "description": "Driven distance [m]."},
    }
    return made


def _solve() -> Schema:

    return _schema(SolveFile)


def _row() -> Schema:
    from momapos.apps.bench import Row

    return _schema(Row)


SCHEMAS: Mapping[str, tuple[str, Callable[[], Schema]]] = {
    "scene": ("Scene (momapos-scene, version 1)", _scene),
    "robot": ("Robot file (version 1), its TOML as JSON", _robot),
    "plan": ("Plan (momapos-plan, version 1)", lambda: _plan(1)),
    "plan2": ("Plan in which the base moves with the arm (momapos-plan, version 2)",
              lambda: _plan(2)),
    "tour": ("Tour (momapos-tour, version 1)", _tour),
    "run": ("Record of a run in physics (momapos-run, version 1)", _run),
    "solve": ("Record of a task in a scanned room (momapos-solve, version 1)", _solve),
    "bench-row": ("Row of a benchmark's results", _row),
}  # fmt: skip
"""Title and generator of each schema, by name."""


def _with_head(made: Schema, name: str, version: int) -> Schema:
    """Add the format and the version of a file, which its record does not hold."""
    head = {
        "format": {"const": name, "description": "Name of the format."},
        "version": {"const": version, "description": "Version of the format."},
    }
    made["properties"] = {**head, **made["properties"]}
    made["required"] = [*head, *made["required"]]
    return made


def _schema(kind: type) -> Schema:
    """Return the schema of a record, with the docstrings of its members as descriptions."""
    _, parts = msgspec.json.schema_components([kind], ref_template="#/$defs/{name}")
    kinds = _records(kind)
    for name, part in parts.items():
        docs = (_member_docs(kinds[name]) if name in kinds else {}) | WORDS.get(name, {})
        for member, words in docs.items():
            if member in part.get("properties", {}):
                _describe(part["properties"], member, words)
        if "description" in part:
            part["description"] = " ".join(part["description"].partition("\n\n")[0].split())
    top = parts.pop(kind.__name__)
    return {**top, **({"$defs": parts} if parts else {})}


def _describe(properties: Schema, member: str, words: str) -> None:
    properties[member] = {**properties[member], "description": words}


def _records(kind: type) -> dict[str, type]:
    """Return a record and those that it contains, by name."""
    found: dict[str, type] = {}

    def visit(one: msgspec.inspect.Type) -> None:
        if isinstance(one, msgspec.inspect.StructType | msgspec.inspect.DataclassType):
            if one.cls.__name__ in found:
                return
            found[one.cls.__name__] = one.cls
            for member in one.fields:
                visit(member.type)
            return
        for part in ("item_type", "key_type", "value_type", "type"):
            if isinstance(inner := getattr(one, part, None), msgspec.inspect.Type):
                visit(inner)
        for inner in (*getattr(one, "types", ()), *getattr(one, "item_types", ())):
            visit(inner)

    visit(msgspec.inspect.type_info(kind))
    return found


def _member_docs(kind: type) -> dict[str, str]:
    """Return the docstrings below a record's members, by their names in the file."""
    docs: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if not getattr(base, "__annotations__", None):
            continue
        names = {f.name: f.encode_name for f in _struct_fields(base)}
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        for member, doc in pairwise(getattr(tree, "body", [])):
            if (
                isinstance(member, ast.AnnAssign)
                and isinstance(member.target, ast.Name)
                and isinstance(doc, ast.Expr)
                and isinstance(doc.value, ast.Constant)
            ):
                name = member.target.id
                docs[names.get(name, name)] = " ".join(str(doc.value.value).split())
    return docs


def _struct_fields(kind: type) -> tuple[msgspec.structs.FieldInfo, ...]:
    return msgspec.structs.fields(kind) if issubclass(kind, msgspec.Struct) else ()


def field_list(names: Sequence[str] = tuple(SCHEMAS)) -> str:
    """Return the members of formats as tables in Markdown; each row of a record stands once."""
    parts: list[str] = []
    listed: set[tuple[str, str]] = set()
    for name in names:
        made = schema_of(name)
        parts.append(f"## {made['title']}\n\n`momapos schema {name}`: {made['description']}\n")
        inner = sorted(made.get("$defs", {}).items())
        for record, part in (("", made), *((one, of) for one, of in inner if "properties" in of)):
            words = part.get("description", "")
            rows = [row for row in _rows(part) if (words, row) not in listed]
            if record and rows:
                parts.append(f"### {name}: {record}\n\n{words}\n")
            if len(rows) < len(part["properties"]) and rows:
                parts.append("The other members are those listed above.\n")
            if rows:
                parts.append("\n".join([*_HEAD, *rows, ""]))
            listed |= {(words, row) for row in rows}
    return "\n".join(parts)


_HEAD = ("| member | value | default | meaning |", "|---|---|---|---|")


def _rows(record: Schema) -> list[str]:
    required = set(record.get("required", ()))
    rows = []
    for member, part in record["properties"].items():
        default = f"`{json.dumps(part['default'])}`" if "default" in part else ""
        words = part.get("description", "").replace("|", "\\|")
        given = "required" if member in required else default
        rows.append(f"| `{member}` | {_value(part).replace('|', 'or')} | {given} | {words} |")
    return rows


def _value(part: Schema) -> str:
    """Return the type of a member in words."""
    if "const" in part:
        return f"`{part['const']}`"
    if "enum" in part:
        return ", ".join("null" if one is None else f"`{one}`" for one in part["enum"])
    if "$ref" in part:
        return str(part["$ref"].rpartition("/")[2])
    if "anyOf" in part:
        return " or ".join(dict.fromkeys(map(_value, part["anyOf"])))
    kind = part.get("type", "any")
    if kind == "array":
        return " ".join(_items(part))
    if kind == "object" and isinstance(part.get("additionalProperties"), dict):
        return f"{_value(part['additionalProperties'])} by name"
    return str(kind)


def _items(part: Schema) -> Iterator[str]:
    first: Any = part.get("prefixItems")
    if first:
        kinds = list(dict.fromkeys(map(_value, first)))
        yield (
            f"{len(first)} x {kinds[0]}"
            if len(kinds) == 1
            else f"[{', '.join(map(_value, first))}]"
        )
    else:
        yield f"list of {_value(part.get('items', {}))}"


class SolveFile(msgspec.Struct, kw_only=True):
    """Record of a task in a scanned room; all files are in its folder."""

    format: Literal["momapos-solve"]
    version: Literal[1]
    verb: Verb
    object: str
    joint: str | None
    to: float | None
    """Value that the task requests [rad] or [m]."""
    robot: str
    method: str
    """Method of choosing base poses."""
    seed: int
    status: Status
    """Status of the plan."""
    assumption: PlanAssumption | None = None
    done: bool | None
    """Whether the run did the task; null if nothing was run."""
    reason: str
    """Why the run failed."""
    cloud: str
    """The fused cloud."""
    scene: str
    plan: str
    run: str | None
    """The record of the run."""
    alphas: list[float]
    """Importance thresholds at which the room was modeled, in order [-]."""
    views: str
    """How images of fronts are chosen."""
    stand_ins: dict[str, str] = {}
    """What does the work of networks of the paper, by network."""
    modeled: list[str]
    """Objects with joints."""
    timing: dict[str, float]
    """Computing time by stage, and "total" [s]."""
