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

    made = _closed(_schema(SceneFile))
    entry = made["$defs"]["SceneEntry"]
    entry["oneOf"] = [{"required": ["urdf"]}, {"required": ["box"]}]
    known = made["$defs"]["JointResistance"]
    for name, member in known["properties"].items():
        if name != "balanced":
            member["anyOf"][0] |= {"minimum": 1e-6 if name in _NONZERO else 0, "maximum": 1e5}
    return made


def _robot() -> Schema:
    from momapos.model.robots import RobotFile

    made = _closed(_schema(RobotFile))
    arm = made["$defs"]["RobotArm"]
    made["properties"] = arm["properties"] | made["properties"]
    made["required"].remove("arms")
    alone = {"required": arm["required"], "not": {"required": ["arms"]}}
    made["oneOf"] = [alone, {"required": ["arms"]}]
    return made


def _closed(made: Schema) -> Schema:
    """Allow no further members of a file's records, which the reader leaves out."""
    for part in (made, *made["$defs"].values()):
        part["additionalProperties"] = False
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
        docs = _member_docs(kinds[name]) if name in kinds else {}
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
    """Name of the format."""
    version: Literal[1]
    """Version of the format."""
    verb: Verb
    """What to do."""
    object: str
    """The object, by its name in the scene."""
    joint: str | None
    """The joint to move; null for a movable object."""
    to: float | None
    """Value that the task requests [rad] or [m]."""
    robot: str
    """Name of the robot."""
    method: str
    """Method of choosing base poses."""
    seed: int
    """Seed of the search."""
    status: Status
    """Status of the plan."""
    assumption: PlanAssumption | None = None
    """What an assumed plan assumes."""
    done: bool | None
    """Whether the run did the task; null if nothing was run."""
    reason: str
    """Why the run failed."""
    cloud: str
    """The fused cloud."""
    scene: str
    """The scene."""
    plan: str
    """The plan."""
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
