"""A robot file derived from a URDF alone.

URDFs do not say which link stands on the floor, which joints are the arm, or where the tool is.
This module looks at names and geometry the way a person would, and puts every guess into words,
so that a wrong one is seen and corrected in the file that it writes.
"""

from __future__ import annotations

import json
import os
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.cache import write_atomic
from momapos.errors import InputError, RobotError
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.chain import Chain, build_chain
from momapos.kinematics.self_collision import arm_spheres
from momapos.kinematics.spheres import Spheres, build_spheres
from momapos.kinematics.urdf import read_urdf
from momapos.robots.gripper import (
    find_grip,
    find_grips,
    find_tool,
    fixed_to,
    listed,
    points_of,
)  # fmt: skip
from momapos.robots.robot import ASSUMED_FORCE, Robot, read_robot, read_srdf
from momapos.robots.states import inevitable_pairs, resting_state, sample_states, srdf_text, touches
from momapos.robots.tree import WHEEL, find_anchor, find_arms

if TYPE_CHECKING:
    from jaxtyping import Float

_OMNI = re.compile(r"mecanum|omni|swerve", re.I)
FLOOR_TOLERANCE = 0.03
"""How far the lowest point of the base may be from the base link's z = 0 [m]."""
MAX_CORNERS, MAX_LINKS = 16, 500


@dataclass(frozen=True)
class Derived:
    """What a URDF says about a robot, and what had to be assumed."""

    toml: str
    """Text of the robot file."""
    pairs: dict[tuple[str, str], str]
    """Pairs of links that cannot help touching, with the reason, for an SRDF."""
    assumptions: tuple[str, ...]
    """What was guessed, in words; what may be wrong altogether comes first."""
    urdf_name: str
    """How the robot file names the URDF."""


def write_robot(urdf: Path, out: Path | None = None, *, seed: int = 0) -> tuple[Path, Derived]:
    """Derive a robot file from a URDF and write it, with an SRDF beside it if the URDF has none.

    Both are written at the end, or nothing is.

    Args:
        urdf: The URDF.
        out: The robot file; the URDF's name with `.toml` where None.
        seed: Seed of the sampled arm states.

    Returns:
        The robot file, and what was derived.

    Raises:
        RobotError: A file exists already, cannot be written, or nothing can be derived.
        UrdfError: The URDF cannot be used.
    """
    out = out or urdf.with_suffix(".toml")
    if out.exists():
        raise RobotError(f"{out}: exists already; remove it, or choose another file with --out")
    if out.parent.exists() and not out.parent.is_dir():
        raise RobotError(f"{out}: cannot be written ({out.parent} is no folder)")
    name = os.path.relpath(urdf.resolve(), out.resolve().parent)
    derived = derive_robot(
        urdf, urdf_name=Path(name).as_posix(), srdf_name=f"{out.stem}.srdf", seed=seed
    )
    srdf = out.with_suffix(".srdf")
    if derived.pairs and srdf.exists():
        raise RobotError(f"{srdf}: exists already; remove it, or choose another file with --out")
    files = {srdf: srdf_text(out.stem, derived.pairs)} if derived.pairs else {}
    try:
        _try_out(urdf, out, derived, files)
        for path, text in {**files, out: derived.toml}.items():
            write_atomic(path, text.encode())
    except OSError as error:
        for path in files:
            path.unlink(missing_ok=True)
        raise RobotError(f"{error.filename}: cannot be written ({error.strerror})") from error
    return out, derived


def _try_out(urdf: Path, out: Path, derived: Derived, files: dict[Path, str]) -> None:
    """Read the robot file before it is written, from a folder of its own.

    Raises:
        RobotError: It cannot be read; the message names the file as it would be called.
    """
    with tempfile.TemporaryDirectory(prefix="momapos-") as folder:
        draft = Path(folder) / out.name
        for path, text in files.items():
            draft.with_name(path.name).write_text(text, encoding="utf-8")
        here = Path(os.path.relpath(urdf.resolve(), draft.resolve().parent)).as_posix()
        toml = derived.toml.replace(_key("urdf", derived.urdf_name), _key("urdf", here), 1)
        draft.write_text(toml, encoding="utf-8")
        try:
            read_robot(draft)
        except InputError as error:
            raise RobotError(str(error).replace(str(draft), str(out))) from error


def derive_robot(
    urdf: Path, *, urdf_name: str | None = None, srdf_name: str | None = None, seed: int = 0
) -> Derived:
    """Derive a robot file from a URDF.

    Args:
        urdf: The file. An SRDF beside it is believed.
        urdf_name: How the robot file names the URDF; its file name where None.
        srdf_name: How it names the SRDF, where one is needed; the URDF's name where None.
        seed: Seed of the sampled arm states.

    Raises:
        UrdfError: The URDF cannot be used.
        RobotError: It has no arm, no base geometry, or no link at floor height.
    """
    model = Articulated(read_urdf(urdf))
    if len(model.links) > MAX_LINKS:
        raise RobotError(f"{urdf}: {len(model.links)} links; a robot has at most {MAX_LINKS}")
    notes: list[str] = []
    anchor = find_anchor(model, notes)
    joints, others = find_arms(model, anchor, notes)
    base_link = _base_link(model, anchor, joints, notes)
    known = read_srdf(urdf.with_suffix(".srdf"))
    for other in others:
        model = _at_rest(model, base_link, other, joints, known, np.random.default_rng(seed), notes)
    last = model.joint(joints[-1]).child
    tool_link, gripper, fingers = find_tool(model, last, notes)
    approach, closing, opening = find_grip(model, last, tool_link, fingers, notes)
    footprint = _footprint(model, base_link, joints, notes)
    drive = _drive(model, notes)
    chain, segments = build_chain(model, base_link, tool_link, joints)
    spheres = build_spheres(model, segments, known, gripper)
    q = sample_states(chain, np.random.default_rng(seed))
    pairs = {} if known else inevitable_pairs(chain, spheres, q)
    disabled = known | {frozenset(pair) for pair in pairs}
    spheres = arm_spheres(model, chain, segments, disabled, gripper)
    home = _home(chain, spheres, q, notes)
    grips = find_grips(model, last, fingers, notes)
    srdf_name = srdf_name or urdf.with_suffix(".srdf").name
    _note_pairs(pairs, bool(known), srdf_name, notes)
    notes.sort(key=lambda note: not note.startswith("IMPORTANT"))
    text = _toml(
        name=re.sub(r"\W+", "_", model.urdf.name).strip("_") or "robot",
        urdf=urdf_name or urdf.name, srdf=srdf_name if pairs else "", base_link=base_link,
        tool_link=tool_link, joints=joints,
        gripper=gripper, home=home, footprint=footprint, drive=drive, approach=approach,
        closing=closing, opening=opening, grips=grips, rest=model.held,
    )  # fmt: skip
    return Derived(text, pairs, tuple(notes), urdf_name or urdf.name)


def _at_rest(
    model: Articulated,
    base_link: str,
    other: tuple[str, ...],
    joints: Sequence[str],
    known: frozenset[frozenset[str]],
    rng: np.random.Generator,
    notes: list[str],
) -> Articulated:
    """The robot with another arm in a compact state, where it stays."""
    last = model.joint(other[-1]).child
    chain, segments = build_chain(model, base_link, last, other)
    own = [i for i, name in enumerate(other) if name not in joints]
    q = sample_states(chain, rng)
    shared = [i for i in range(len(other)) if i not in own]
    q[:, shared] = q[0, shared]
    spheres = build_spheres(model, segments, known, [last])
    pairs = {} if known else inevitable_pairs(chain, spheres, q)
    disabled = known | {frozenset(pair) for pair in pairs}
    found = resting_state(chain, arm_spheres(model, chain, segments, disabled, [last]), q)
    if found is None:
        return model
    held = {other[i]: float(found[0][i]) for i in own}
    notes.append(f"rest: the other arm is kept within {found[1]:.2f} m of the base's origin")
    return Articulated(model.urdf, {**model.held, **held})


# ------------------------------------------------------------------------------------ the base


def _base_links(model: Articulated, joints: Sequence[str]) -> list[str]:
    arm = set(model.moved_by(joints[0]))
    return [name for name in model.links if name not in arm]


def _base_link(model: Articulated, anchor: str, joints: Sequence[str], notes: list[str]) -> str:
    """A link fixed to the base whose z = 0 is the floor."""
    rigid = fixed_to(model, anchor)
    usual: tuple[str, ...] = ("base_footprint", "base_link")
    preferred = [name for name in usual if name in rigid]
    body = _base_links(model, joints)
    offsets = {}
    for name in dict.fromkeys([*preferred, anchor, *rigid]):
        points = points_of(model, name, body)
        if not len(points):
            raise RobotError(
                f"{model.urdf.path}: no link below the arm has collision geometry; add the base's"
            )
        offsets[name] = float(points[:, 2].min())
        if abs(offsets[name]) <= FLOOR_TOLERANCE:
            notes.append(f"base_link: {name}, whose x axis is taken as forward")
            return name
    name = (preferred or [anchor])[-1]
    raise RobotError(
        f"{model.urdf.path}: no link of the base lies on the floor: the base's lowest point is "
        f"at z = {offsets[name]:.3f} m in {name!r}; add to the URDF: "
        f'<link name="base_footprint"/><joint name="base_footprint_joint" type="fixed">'
        f'<parent link="{name}"/><child link="base_footprint"/>'
        f'<origin xyz="0 0 {offsets[name]:.4f}"/></joint>'
    )


def _footprint(
    model: Articulated, base_link: str, joints: Sequence[str], notes: list[str]
) -> Float[np.ndarray, "k 2"]:
    """Outline of all that does not move with the arm, seen from above."""
    from scipy.spatial import ConvexHull

    points = points_of(model, base_link, _base_links(model, joints))[:, :2]
    outline = points[ConvexHull(points).vertices]
    if len(outline) > MAX_CORNERS:
        # Around it, so that nothing sticks out: where neighboring tangents meet.
        angle = np.arange(MAX_CORNERS) * 2 * np.pi / MAX_CORNERS
        normal = np.stack([np.cos(angle), np.sin(angle)], -1)
        reach = (outline @ normal.T).max(0)
        pairs = np.stack([normal, np.roll(normal, -1, 0)], 1)
        ends = np.stack([reach, np.roll(reach, -1)], -1)
        outline = np.linalg.solve(pairs, ends[..., None])[..., 0]
        outline = outline[np.linalg.norm(outline - np.roll(outline, 1, 0), axis=1) > 1e-4]
    size = np.ptp(outline, axis=0)
    notes.append(f"footprint: outline of the base's geometry, {size[0]:.2f} x {size[1]:.2f} m")
    return outline


def _drive(model: Articulated, notes: list[str]) -> str:
    names = [*model.urdf.links, *(joint.name for joint in model.urdf.joints)]
    if any(_OMNI.search(name) for name in names):
        notes.append("drive: omni, as its wheels are named so")
        return "omni"
    wheels = any(WHEEL.search(name) for name in names)
    if not wheels:
        notes.append(
            "IMPORTANT: there are no wheels: is this a mobile robot? An arm alone needs a base in "
            "its URDF"
        )
    notes.append("drive: differential, with speeds that are a guess")
    return "differential"


# ------------------------------------------------------------------------------------ the files


def examine(robot: Robot, *, seed: int = 0) -> list[str]:
    """Say what looks wrong about a robot whose file is consistent; mostly nothing."""
    doubts: list[str] = []
    if not robot.chain.upright:
        doubts.append(
            "the arm's first axis is not vertical: there is no reachability map for such an arm, "
            "and 'momapos place' needs one"
        )
    body = _base_links(robot.model, robot.arm_joints)
    points = points_of(robot.model, robot.base_link, body)
    if not len(points):
        return ["the base has no collision geometry: nothing that it could hit is checked"]
    low = float(points[:, 2].min())
    if abs(low) > FLOOR_TOLERANCE:
        doubts.append(f"the base's lowest point is {low:.3f} m from the z = 0 of {robot.base_link}")
    edge = np.roll(robot.footprint, -1, 0) - robot.footprint
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
    offset = np.einsum("ij,ij->i", normal, robot.footprint)
    out = float((points[:, :2] @ normal.T - offset).max())
    if out > 0.02:
        doubts.append(f"the base sticks {out:.2f} m out of its footprint")
    if touches(robot.chain, robot.spheres, robot.home[None], floor=True)[0]:
        doubts.append("the arm touches the robot or the floor at home")
    share = touches(
        robot.chain, robot.spheres, sample_states(robot.chain, np.random.default_rng(seed))
    ).mean()
    if share > 0.9:
        doubts.append(
            f"the arm touches the robot in {100 * share:.0f} % of its states: are pairs of links "
            "missing in the SRDF?"
        )
    return doubts


def _note_pairs(
    pairs: dict[tuple[str, str], str], known: bool, srdf: str, notes: list[str]
) -> None:
    if known:
        notes.append("self-collision: the pairs in the SRDF beside the URDF are not checked")
    elif pairs:
        always = sum(why == "Always" for why in pairs.values())
        words = f"{always} touch in almost every state, {len(pairs) - always} are neighbors that"
        notes.append(
            f"self-collision: {len(pairs)} pairs of links are never checked, of which {words} "
            f"touch at rest and often; {srdf} names them with the reason"
        )


def _home(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"], notes: list[str]
) -> Float[np.ndarray, " n"]:
    found = resting_state(chain, spheres, q)
    if found is None:
        notes.append("IMPORTANT: home: no state free of self-collision was found; give one")
        return q[0]
    home, reach = found
    notes.append(
        f"home: of {len(q)} states the one that keeps the arm within {reach:.2f} m of the "
        f"base's origin, {listed(home)}"
    )
    return home


def _key(name: str, value: str) -> str:
    """A line of a robot file."""
    return f"{name} = {json.dumps(value, ensure_ascii=False)}"


def _toml(**v: Any) -> str:
    """Text of a robot file; the texts are names that came out of an XML file."""

    def quoted(value: str) -> str:
        return json.dumps(value, ensure_ascii=False)

    def names(values: Sequence[str]) -> str:
        return f"[{', '.join(map(quoted, values))}]"

    srdf = _key("srdf", v["srdf"]) + "\n" if v["srdf"] else ""
    held = "".join(f"{quoted(name)} = {value:g}\n" for name, value in v["rest"].items())
    rest = f"\n[rest]\n{held}" if held else ""
    corners = ", ".join(listed(corner) for corner in v["footprint"])
    return f"""# Derived by 'momapos robot check'; see docs/robots.md for every key.
name = {quoted(v["name"])}
{_key("urdf", v["urdf"])}
{srdf}base_link = {quoted(v["base_link"])}
tool_link = {quoted(v["tool_link"])}
arm_joints = {names(v["joints"])}
gripper_links = {names(v["gripper"])}
home = {listed(v["home"])}

[base]
footprint = [{corners}]
drive = {quoted(v["drive"])}
max_speed = 0.5
max_yaw_rate = 1.0
max_acceleration = 0.5
max_yaw_acceleration = 1.0

[tool]
approach_axis = {listed(v["approach"])}
closing_axis = {listed(v["closing"])}
opening = {v["opening"]:g}
grips = {quoted(v["grips"])}
# force = {ASSUMED_FORCE:g}    # of each finger, or pull of a cup [N]; assumed while it is not given
{rest}"""
