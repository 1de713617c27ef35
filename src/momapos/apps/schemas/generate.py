"""Generate JSON Schemas from the records that files are read into."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import msgspec

from .plan_words import WORDS

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
    return {"$schema": DIALECT, "title": title, **make()}


def _scene() -> Schema:
    from .scene_file import SceneFile

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
    from .robot_file import RobotFile

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
    from .solve_file import SolveFile

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
