"""Derive a robot file from a URDF alone, and write it with its SRDF and URDF.

URDFs do not state which link is on the floor, which joints form an arm, or where the tool is. This
module infers them from names and geometry and reports every assumption, so that the user can
correct the robot file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Cache, RobotError, UrdfError, resolved, unknown_name, write_atomic
from momapos.model.urdf import Articulated, Urdf

from .amended_urdf import BOX, AddedFrame, Amendments, Mount
from .base_guess import (
    drive_of,
    find_base_link,
    find_drive,
    find_footprint,
    lift_as_base,
    refuse_unknown_axle,
    refuse_without_base,
)
from .fingers import find_force, jaws
from .gripper_guess import find_grip, find_grips, find_tool
from .homes import NESTED, ArmToRest, find_homes, true_claims
from .joint_tree import MIN_ARM_JOINTS, ArmChain, NoArmError, arm_names, find_anchor, find_arms
from .robot import Robot, load_arms
from .robot_names import library_names
from .robot_text import ArmText, RobotText
from .running_gear import RunningGear, drawn_meshes, drive_plugin, find_running_gear
from .srdf import Srdf, find_srdf, srdf_next_to, srdf_text
from .xacro import (
    Expanded,
    expand_xacro,
    is_xacro,
    off_by_default,
    with_relative_meshes,
)

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_LINKS = 500
ReportProgress = Callable[[float, str], None]
"""Receives the completed share of the work, and the current step."""


@dataclass(frozen=True)
class RobotSource:
    """Input of a derived robot file."""

    urdf: Path
    mount: Mount | None = None
    """Carrier of the arm."""
    packages: Mapping[str, Path] = field(default_factory=dict)
    """Package folders by name."""
    content: str | None = None
    """Content of the URDF, if it is not in a file yet."""
    visual_hulls: bool = False
    """Whether bodies without collision shapes get the hulls of what is drawn."""
    near: Path | None = None
    """File whose folder is searched for an SRDF; None for the URDF."""
    home: Mapping[str, float] = field(default_factory=dict)
    """Values of joints of arms whose homes are given [rad] or [m]; their others rest at zero."""


@dataclass(frozen=True)
class Derived:
    """A derived robot file and its assumptions."""

    toml: str
    """Content of the robot file."""
    pairs: Mapping[tuple[str, str], str]
    """Pairs of links in permanent contact with the reason, for an SRDF; includes the pairs of the
    URDF's own SRDF if that lacks some, or has some that are not true."""
    assumptions: tuple[str, ...]
    """Assumptions, one line each, the most important first."""
    srdf: str = ""
    """Name of the SRDF to write next to the robot file, with these pairs; "" for none."""


@dataclass(frozen=True)
class _Arm:
    """An arm with its tool."""

    chain: ArmChain
    text: ArmText
    frame: AddedFrame | None


def derive_robot(
    source: Path | RobotSource,
    out: Path | None = None,
    *,
    seed: int = 0,
    cache: Cache | None = None,
    report: ReportProgress = lambda _share, _what: None,
) -> Derived:
    """Derive a robot file from a URDF.

    Args:
        source: The URDF and its options. An SRDF next to it is used.
        out: Future robot file, which paths are relative to; None for next to the URDF.
        seed: Seed of the sampled arm states.
        cache: Stores expensive geometry.
        report: Receives the progress.

    Raises:
        UrdfError: The URDF is invalid.
        RobotError: The robot has no arm or no base; the message says what would help.
    """
    if isinstance(source, Path):
        source = RobotSource(source)
    urdf, out = source.urdf, out or source.urdf.with_suffix(".toml")
    report(0.0, "reading")
    amendments = Amendments(
        mount=source.mount, packages=source.packages, visual_hulls=source.visual_hulls,
        content=source.content,
    )  # fmt: skip
    model = Articulated(amendments.read(urdf, cache)[0], cache=cache)
    notes = list(model.urdf.notes)
    if len(model.links) > MAX_LINKS:
        raise RobotError(f"{urdf}: {len(model.links)} links; a robot has at most {MAX_LINKS}")
    anchor = find_anchor(model, notes)
    srdf = find_srdf(source.near or urdf, model.urdf.name)
    report(0.1, "geometry")
    drawn = drawn_meshes(source.content, urdf)
    gear = find_running_gear(model, anchor, drawn)
    guess = drive_of(gear)
    refuse_unknown_axle(model, guess)
    chains = _chains(model, anchor, source, srdf, gear, notes)
    couplings = {name: mimic for chain in chains for name, mimic in chain.coupled}
    firsts = [chain.joints[0] for chain in chains]
    base_link, floor = find_base_link(model, anchor, firsts, gear, guess, notes)
    names = arm_names(model, chains)
    arms = {
        name: _tool(model, chain, name, drawn, notes)
        for name, chain in zip(names, chains, strict=True)
    }
    frames = [frame for frame in (floor, *(arm.frame for arm in arms.values())) if frame]
    record, _ = replace(amendments, frames=tuple(frames), coupled=couplings).read(urdf, cache)
    model = _same_shapes(record, model, {**model.held, **_resting_fingers(model, arms)})
    footprint = find_footprint(model, base_link, firsts, notes)
    boxed = source.mount is not None and source.mount.box is not None
    plugin = drive_plugin(source.content, urdf)
    drive = find_drive(model, anchor, boxed, guess, plugin, notes)
    waiting = [ArmToRest(name, arm.chain, arm.text) for name, arm in arms.items()]
    given, srdf = srdf, true_claims(model, base_link, waiting, srdf, seed, notes)
    homes = find_homes(
        model, base_link, waiting, footprint, srdf, seed, notes,
        lambda share, what: report(0.2 + 0.8 * share, what), _given_homes(model, waiting, source),
    )  # fmt: skip
    model, pairs = homes.model, homes.pairs
    arms = {
        name: replace(arm, text=replace(arm.text, home=homes.states[name]))
        for name, arm in arms.items()
    }
    _note_pairs(pairs, srdf, notes)
    written, kept = "", _kept_srdf(srdf, urdf, out)
    if pairs or srdf is not given:
        written = _new_srdf(given, out)
        kept = written
    if source.mount is not None and BOX in model.links:
        notes.append(f"base: a driving box of {' x '.join(f'{v:g}' for v in _box(source))} m")
    notes.sort(key=lambda note: not note.startswith("IMPORTANT"))
    taken = {joint for arm in arms.values() for joint in arm.text.joints}
    mount_urdf = None if source.mount is None else source.mount.urdf
    text = RobotText(
        name=_name(model, out, notes),
        urdf=_relative(urdf, out),
        srdf=kept,
        base_link=base_link,
        footprint=footprint,
        drive=drive,
        min_turning_radius=guess.radius if guess is not None and drive == "car" else 0.0,
        arms={name: arm.text for name, arm in arms.items()},
        rest={joint: value for joint, value in model.held.items() if joint not in taken},
        coupled=couplings,
        frames=frames,
        mount=source.mount,
        visual_hulls=source.visual_hulls,
        mount_urdf="" if mount_urdf is None else _relative(mount_urdf, out),
        packages={name: _relative(folder, out) for name, folder in source.packages.items()},
    )
    known = dict(srdf.reasons) if written else {}
    return Derived(text.text(), {**known, **pairs}, tuple(dict.fromkeys(notes)), written)


def _chains(
    model: Articulated,
    anchor: str,
    source: RobotSource,
    srdf: Srdf,
    gear: RunningGear,
    notes: list[str],
) -> list[ArmChain]:
    """Find the arms, without a lift that belongs to the base.

    Raises:
        RobotError: There is no arm, or no base below it.
    """
    chains = find_arms(model, anchor, _fingers(model, srdf), gear.joints, notes)
    _note_groups(model, chains, srdf, notes)
    if source.mount is None:
        refuse_without_base(model, anchor, [chain.joints[0] for chain in chains], gear)
    return [replace(chain, joints=lift_as_base(model, chain.joints, notes)) for chain in chains]


def _given_homes(
    model: Articulated, arms: Sequence[ArmToRest], source: RobotSource
) -> dict[str, Float[np.ndarray, " n"]]:
    """Return the given homes by arm.

    Raises:
        RobotError: A joint is in no arm, or beyond its limits.
    """
    every = [joint for arm in arms for joint in arm.text.joints]
    for name, value in source.home.items():
        if name not in every:
            raise unknown_name("joint of an arm", name, every, source.urdf.name)
        joint = model.joint(name)
        if not joint.lower <= value <= joint.upper:
            raise RobotError(
                f"--home {name}={value:g} is beyond its limits, {joint.lower:g} to {joint.upper:g}"
            )
    return {
        arm.name: np.array([source.home.get(name, model.rest[name]) for name in arm.text.joints])
        for arm in arms
        if source.home.keys() & set(arm.text.joints)
    }


def _resting_fingers(model: Articulated, arms: dict[str, _Arm]) -> dict[str, float]:
    """Return the rest values of fingers that differ from the URDF's.

    The gripper rests open, because planning, drawing and execution start with an open gripper.
    """
    return {
        name: value
        for arm in arms.values()
        for name, value in arm.text.grip.rest.items()
        if value != model.rest[name]
    }


def _kept_srdf(srdf: Srdf, urdf: Path, out: Path) -> str:
    """Return the user's SRDF for the robot file; "" if it is next to the URDF, or if none is."""
    if srdf.path is None or srdf.path == srdf_next_to(resolved(urdf)):
        return ""
    return _relative(srdf.path, out)


def _new_srdf(given: Srdf, out: Path) -> str:
    """Return the name of an SRDF to write, which is not that of the user's."""
    name = out.with_suffix(".srdf")
    return f"{out.stem}_checked.srdf" if given.path == resolved(name) else name.name


def _fingers(model: Articulated, srdf: Srdf) -> set[str]:
    """Return the links below the parent link of an SRDF's end effector."""
    return {
        link
        for parent, links in srdf.hands.items()
        if parent in model.links
        for link in model.links_below(parent)
        if link != parent and link in links
    }


def _note_groups(
    model: Articulated, chains: Sequence[ArmChain], srdf: Srdf, notes: list[str]
) -> None:
    """Compare each arm with the most similar joint group of the SRDF."""
    groups = {name: group.members(model) for name, group in srdf.groups.items()}
    for own in (set(chain.joints) for chain in chains):
        shared = {name: len(own & group) / len(own | group) for name, group in groups.items()}
        name = max(shared, key=lambda name: shared[name], default="")
        if not name or len(own & groups[name]) < MIN_ARM_JOINTS:
            continue
        more, less = sorted(groups[name] - own), sorted(own - groups[name])
        words = [f"{', '.join(more)} too"] * bool(more) + [f"no {', '.join(less)}"] * bool(less)
        differs = " and ".join(words) or "the same joints"
        notes.append(f"arm_joints: the SRDF's group {name!r} has {differs}")


def _same_shapes(record: Urdf, model: Articulated, held: Mapping[str, float]) -> Articulated:
    """Return a model with other joints, frames and rest values, but the same link shapes."""
    again = Articulated(record, held, model.cache)
    for what in ("hulls", "boxes"):
        if what in vars(model):
            vars(again)[what] = {name: getattr(model, what).get(name, ()) for name in again.links}
    return again


def _tool(
    model: Articulated, chain: ArmChain, name: str, drawn: Collection[str], notes: list[str]
) -> _Arm:
    """Return the tool of an arm, as far as it does not depend on states of the arm."""
    mine: list[str] = []
    link, gripper, fingers = find_tool(model, chain.last, mine)
    grip = find_grip(model, chain.last, link, fingers, mine)
    grips = find_grips(model, chain.last, fingers, drawn, mine)
    force = None
    if fingers and grips == "fingers":
        sides = jaws(model, link, fingers, grip.closing)
        force = find_force(model, link, sides, np.stack([grip.closing, grip.approach]), mine)
    frame = None
    if grip.grasp is not None:
        x, y, z = (round(float(v), 4) for v in grip.grasp)
        frame = AddedFrame(f"{name}_grasp_frame" if name else "grasp_frame", link, (x, y, z))
    notes += [_of_arm(note, name) for note in mine]
    tool_link = link if frame is None else frame.name
    text = ArmText(
        chain.joints, tool_link, tuple(gripper), np.zeros(len(chain.joints)), grip, grips, force
    )
    return _Arm(chain, text, frame)


def _of_arm(note: str, name: str) -> str:
    if not name:
        return note
    if note.startswith("IMPORTANT: "):
        return f"IMPORTANT: {name}: {note.removeprefix('IMPORTANT: ')}"
    return f"{name}: {note}"


def _note_pairs(pairs: dict[tuple[str, str], str], srdf: Srdf, notes: list[str]) -> None:
    if srdf.path is not None:
        notes.append(
            f"self-collision: the {len(srdf.disabled)} pairs in {srdf.path} are not checked"
        )
    if pairs:
        always = sum(why == "Always" for why in pairs.values())
        nested = sum(why == NESTED for why in pairs.values())
        stages = f", and {nested} are stages of a telescope" if nested else ""
        neighbors = len(pairs) - always - nested
        notes.append(
            f"self-collision: {len(pairs)} pairs of links are never checked: {always} touch in "
            f"almost every state, {neighbors} are neighbors that touch often{stages}; see the SRDF"
        )


def _name(model: Articulated, out: Path, notes: list[str]) -> str:
    """Return the URDF's robot name, or another one if it belongs to a library robot."""
    name = re.sub(r"\W+", "_", model.urdf.name).strip("_") or "robot"
    if name not in library_names():
        return name
    own = re.sub(r"\W+", "_", out.stem).strip("_")
    own = own if own and own not in library_names() else f"my_{name}"
    notes.append(f"name: {own}, because {name} is a library robot")
    return own


def _relative(path: Path, out: Path) -> str:
    return Path(os.path.relpath(resolved(path), resolved(out).parent)).as_posix()


def _box(source: RobotSource) -> tuple[float, ...]:
    return () if source.mount is None or source.mount.box is None else source.mount.box


def write_robot(
    source: Path | RobotSource,
    out: Path | None = None,
    *,
    args: Mapping[str, str] | None = None,
    expanded: Expanded | None = None,
    seed: int = 0,
    cache: Cache | None = None,
    report: ReportProgress = lambda _share, _what: None,
    inspect: Callable[[Sequence[Robot]], None] = lambda _arms: None,
) -> tuple[Path, Derived]:
    """Derive a robot file from a URDF or xacro file and write it.

    An SRDF is written next to it if links in permanent contact are missing in the URDF's own SRDF;
    for other files than URDFs also the expanded URDF.

    Args:
        source: The file, and its options.
        out: The robot file; None for the file's name with `.toml`.
        args: Arguments of the xacro file by name.
        expanded: The URDF of a file that is none; a xacro file is expanded here.
        seed: Seed of the sampled arm states.
        cache: Stores expensive geometry.
        report: Receives the progress.
        inspect: Receives the arms; if it raises, nothing is written.

    Returns:
        The robot file, and what was derived.

    Raises:
        RobotError: A file exists already or cannot be written, or nothing can be derived.
        NoArmError: The robot has no arm; the expanded URDF is written if `out` is given.
        UrdfError: The URDF is invalid.
    """
    source = RobotSource(source) if isinstance(source, Path) else source
    plain = source.urdf.with_suffix("") if is_xacro(source.urdf) else source.urdf
    chosen, out = out is not None, out or plain.with_suffix(".toml")
    _refuse_existing(out)
    if out.parent.exists() and not out.parent.is_dir():
        raise RobotError(f"{out}: cannot be written ({out.parent} is no folder)")
    urdf = out.with_suffix(".urdf")
    if is_xacro(source.urdf) or expanded is not None:
        _refuse_existing(urdf)
    if expanded is None and is_xacro(source.urdf):
        expanded = expand_xacro(source.urdf, source.packages, args or {})
    alone: NoArmError | None = None
    with _all_or_nothing() as write:
        if expanded is None:
            derived = derive_robot(source, out, seed=seed, cache=cache, report=report)
        else:
            for name, text in expanded.meshes.items():
                _refuse_existing(out.parent / name)
                write(out.parent / name, text)
            try:
                derived = _derive_expanded(source, urdf, expanded, out, seed, cache, report)
                write(urdf, expanded.urdf)
            except NoArmError as error:
                if (
                    not chosen or source.urdf == urdf
                ):  # a switch may bring the arm, or a part lack it
                    raise
                write(urdf, with_relative_meshes(expanded, urdf))
                alone = error
        if alone is None:
            if derived.srdf:
                srdf = out.with_name(derived.srdf)
                _refuse_existing(srdf)
                write(srdf, srdf_text(out.stem, derived.pairs))
            write(out, derived.toml)
            inspect(load_arms(out, cache=cache))
    if alone is not None:
        raise NoArmError(f"{alone}; its URDF is written to {urdf}") from alone
    return out, derived


def _derive_expanded(
    source: RobotSource,
    urdf: Path,
    expanded: Expanded,
    out: Path,
    seed: int,
    cache: Cache | None,
    report: ReportProgress,
) -> Derived:
    """Derive a robot file from an expanded file; say what the file leaves out by default."""
    near = source.urdf
    source = replace(
        source, urdf=urdf, packages=expanded.packages, content=expanded.urdf, near=near
    )
    try:
        derived = derive_robot(source, out, seed=seed, cache=cache, report=report)
    except (RobotError, UrdfError) as error:  # the URDF is not written
        off = f"; {off_by_default(near, expanded)}" if expanded.off else ""
        raise type(error)(str(error).replace(str(urdf), str(near)) + off) from error
    notes = [*expanded.notes, *derived.assumptions]
    if expanded.off:
        notes.append(f"xacro: {off_by_default(near, expanded)}")
    return replace(derived, assumptions=tuple(notes))


def _refuse_existing(path: Path) -> None:
    if path.exists():
        raise RobotError(f"{path}: exists already; remove it, or choose another file")


@contextmanager
def _all_or_nothing() -> Iterator[Callable[[Path, str], None]]:
    """Yield a function that writes files; after an error, all that it wrote is removed.

    Raises:
        RobotError: A file cannot be written.
    """
    written: list[Path] = []
    folders: list[Path] = []

    def write(path: Path, text: str) -> None:
        new = [folder for folder in (path.parent, *path.parent.parents) if not folder.exists()]
        folders[:0] = new
        write_atomic(path, text.encode())
        written.append(path)

    try:
        yield write
    except BaseException as error:  # also on an interrupt
        for path in written:
            path.unlink(missing_ok=True)
        for folder in folders:
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
        if isinstance(error, OSError):
            raise RobotError(f"{error.filename}: cannot be written ({error.strerror})") from error
        raise
