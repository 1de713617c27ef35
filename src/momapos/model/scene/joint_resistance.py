"""What resists the motion of a part: seal or latch, friction and weight, by the joint's value."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import GRAVITY, owner_cache
from momapos.model.records import JointResistance, Task
from momapos.model.urdf import Articulated, Hull, opening_of

from .resistance_config import ResistanceConfig
from .scene import Scene
from .scene_object import SceneObject

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MAX_HINGE_SLOPE = 0.5
"""Largest vertical share of a horizontal hinge's direction, the sine of 30 degrees [-]."""
MIN_OFFSET = 0.01
"""Distance from its hinge within which a center of mass has no weight that matters [m]."""
AT_STOP = 1e-3
"""Largest distance of a joint's value from a limit or the closed value at it [rad] or [m]."""
_STEP = 1e-5
"""Difference of joint values for the derivative of a height [rad] or [m]."""


@dataclass(frozen=True, eq=False)
class MotionResistance:
    """Resistance of a joint at the values of a motion, each term along the motion [Nm] or [N].

    Positive terms resist the motion. Negative ones drive it, and a hand must hold the part back.
    """

    values: Float[np.ndarray, " v"]
    """Joint values [rad] or [m]."""
    seal: Float[np.ndarray, " v"]
    """Seal or latch, only near the closed value; 0 for a closing part, which it pulls closed."""
    friction: Float[np.ndarray, " v"]
    damping: Float[np.ndarray, " v"]
    weight: Float[np.ndarray, " v"]
    spring: Float[np.ndarray, " v"]
    by_file: Mapping[str, str] = field(default_factory=dict)
    """Friction, damping and spring by the object's files, in words; without what they lack."""

    @property
    def along(self) -> Float[np.ndarray, " v"]:
        """Sum of all terms; negative where the hand must hold the part back.

        Damping counts where it resists. It does not hold a part back that moves slowly.
        """
        slow = self.seal + self.friction + self.weight + self.spring
        fast = slow + self.damping
        return np.where(np.abs(fast) > np.abs(slow), fast, slow)

    @property
    def total(self) -> Float[np.ndarray, " v"]:
        """What a hand must transmit, in either direction."""
        return np.abs(self.along)

    @property
    def largest(self) -> float:
        """The largest total [Nm] or [N]."""
        return float(self.total.max())

    def source(self, index: int) -> str:
        """Return the file's value if it is most of the total at a value, in words; else ""."""
        terms = {
            "friction": self.friction[index], "damping": self.damping[index],
            "spring": self.spring[index],
        }  # fmt: skip
        key = max(terms, key=terms.__getitem__)
        return self.by_file.get(key, "") if terms[key] > self.total[index] / 2 else ""


def resistance_along(
    item: SceneObject,
    joint: str,
    values: Float[np.ndarray, " v"],
    lever: float | Float[np.ndarray, " v"],
    config: ResistanceConfig,
    speed: Float[np.ndarray, " v"] | None = None,
) -> MotionResistance:
    """Return what resists a motion of a joint, at each of its values.

    The generalized force of the weight is the derivative of the potential energy, so that it holds
    for any joint and the mimic joints that follow it.

    Args:
        item: The object.
        joint: Its joint.
        values: Joint values in the order of the motion [rad] or [m].
        lever: Travel of the handle per unit of the joint, at each value or at all: the distance
            from a hinge [m/rad], 1 for a slide. The object's own `lever` has priority.
        config: Assumed values.
        speed: Speed of the joint at each value [rad/s] or [m/s]; None for the usual one of a hand
            that begins and ends at rest.
    """
    known = known_resistance(item, joint, config)
    assert known.seal_force is not None
    assert known.seal_travel is not None
    assert known.friction is not None
    assert known.damping is not None
    towards = np.sign(values[-1] - values[0])
    away = values - opening_of(item.model, joint).closed
    arm = np.maximum(lever if known.lever is None else known.lever, 1e-6)
    share = np.maximum(0.0, 1.0 - np.abs(away) * arm / known.seal_travel)
    if speed is None:
        speed = np.broadcast_to(config.hand_speed / np.maximum(lever, 1e-6), len(values)).copy()
        if item.joint(joint).kind != "prismatic":
            speed = np.minimum(speed, config.turn_speed)
        speed[[0, -1]] = 0.0
    opens = (away * towards >= 0.0) & (np.abs(away) < np.abs(away[-1]))
    return MotionResistance(
        values=values,
        seal=np.where(opens, known.seal_force * arm * share, 0.0),
        friction=np.full(len(values), known.friction),
        damping=known.damping * np.abs(speed),
        weight=-towards * weight_at(item, joint, values, config),
        spring=-towards * spring_at(item, joint, values),
        by_file=_file_words(item, joint),
    )


def weight_at(
    item: SceneObject, joint: str, values: Float[np.ndarray, " v"], config: ResistanceConfig
) -> Float[np.ndarray, " v"]:
    """Return the torque [Nm] or force [N] of a part's weight, positive toward larger values.

    Zero for a part whose weight springs bear.
    """
    known = known_resistance(item, joint, config)
    if known.balanced:
        return np.zeros(len(values))
    masses = part_masses(item.model, item.model.moved_by(joint), config, known.mass)
    poses = item.moving_poses(joint, np.concatenate([values - _STEP, values + _STEP]))
    lifted = np.zeros(2 * len(values))
    for link, (mass, center) in masses.items():
        T = poses[link]
        lifted += mass * (T[:, 2, :3] @ center + T[:, 2, 3])
    before, after = np.split(lifted, 2)
    return -GRAVITY * (after - before) / (2 * _STEP)


def spring_at(
    item: SceneObject, joint: str, values: Float[np.ndarray, " v"]
) -> Float[np.ndarray, " v"]:
    """Return the torque [Nm] or force [N] of a part's spring, positive toward larger values."""
    known, opening = stated_resistance(item, joint), opening_of(item.model, joint)
    away = np.asarray(values) - opening.closed
    side = np.where(np.abs(away) > AT_STOP, np.sign(away), opening.sign)
    return -side * (known.spring or 0.0)


def stays_in_place(
    item: SceneObject, joint: str, values: Float[np.ndarray, " v"], config: ResistanceConfig
) -> Bool[np.ndarray, " v"]:
    """Check at joint values [rad] or [m] that friction or a stop holds a released part in place."""
    friction, record = known_resistance(item, joint, config).friction, item.joint(joint)
    assert friction is not None
    force = weight_at(item, joint, values, config) + spring_at(item, joint, values)
    stop = np.where(force > 0.0, record.upper - values, values - record.lower)
    return (np.abs(force) < friction) | (stop < AT_STOP)


def release_problem(item: SceneObject, joint: str, value: float, config: ResistanceConfig) -> str:
    """Return why a part does not stay at a value [rad] or [m] when it is released, else ""."""
    at = np.array([value])
    if stays_in_place(item, joint, at, config)[0]:
        return ""
    weight, spring = abs(weight_at(item, joint, at, config)[0]), abs(spring_at(item, joint, at)[0])
    friction = known_resistance(item, joint, config).friction
    what, force = ("spring", spring) if spring > weight else ("weight", weight)
    unit = "N" if item.joint(joint).kind == "prismatic" else "Nm"
    return (
        f"{item.name}/{joint} does not stay there when the hand lets go: its {what} moves it with "
        f"{force:.3g} {unit}, and friction holds {friction:.3g} {unit}"
    )


def stated_resistance(item: SceneObject, joint: str) -> JointResistance:
    """Return what the scene states about a joint, else friction and damping of its file."""
    given = item.resistance.get(joint, JointResistance())
    found = _file_values(item.model, joint)
    friction, damping = (
        sum(found[key].values()) or None if value is None else value
        for key, value in (("friction", given.friction), ("damping", given.damping))
    )
    return replace(given, friction=friction, damping=damping)


@owner_cache()
def known_resistance(item: SceneObject, joint: str, config: ResistanceConfig) -> JointResistance:
    """Return the resistance of a joint with assumed values where the scene gives none.

    All fields but `lever`, `spring` and `closer` have a value.
    """
    given = stated_resistance(item, joint)
    record = item.joint(joint)
    if record.kind == "prismatic":
        friction, damping = config.slide_friction, config.slide_damping
    else:
        friction, damping = config.hinge_friction, config.hinge_damping
    sealed = record.kind != "prismatic" and has_seal(item, joint, config)
    assumed: dict[str, Any] = {
        "seal_force": config.seal_force if sealed else config.latch_force,
        "seal_travel": config.seal_travel, "friction": friction, "damping": damping,
        "balanced": is_flap(item, joint, config),
    }  # fmt: skip
    if given.mass is None:
        masses = part_masses(item.model, item.model.moved_by(joint), config)
        assumed["mass"] = sum(mass for mass, _ in masses.values())
    return replace(given, **{k: v for k, v in assumed.items() if getattr(given, k) is None})


def is_flap(item: SceneObject, joint: str, config: ResistanceConfig) -> bool:
    """Check whether a part is a door that stands on a horizontal hinge, or hangs from one.

    Its weight would throw it open or closed, so real ones have springs: dishwashers, ovens,
    lift-up doors. A lid that lies on its hinge's side is none; many have no springs.
    """
    record = item.joint(joint)
    if record.kind == "prismatic":
        return False
    poses = item.link_poses({joint: opening_of(item.model, joint).closed})
    masses = part_masses(item.model, item.model.moved_by(joint), config)
    total = sum(mass for mass, _ in masses.values())
    middle = sum(m * (poses[n][:3, :3] @ at + poses[n][:3, 3]) for n, (m, at) in masses.items())
    axis, hinge = poses[record.child][:3, :3] @ record.axis, poses[record.child][:3, 3]
    away = middle / max(total, 1e-12) - hinge
    away -= (away @ axis) * axis
    length = float(np.linalg.norm(away))
    upright = abs(away[2]) > np.sqrt(0.5) * max(length, MIN_OFFSET)
    return bool(upright and abs(axis[2]) < MAX_HINGE_SLOPE)


def assumes_springs(item: SceneObject, joint: str, config: ResistanceConfig) -> bool:
    """Check whether springs are only assumed to bear the weight of a part, see `is_flap`."""
    given = item.resistance.get(joint, JointResistance())
    return given.balanced is None and is_flap(item, joint, config)


def _file_values(model: Articulated, joint: str) -> dict[str, dict[str, float]]:
    """Return friction and damping of a joint and of those that follow it, by their `<dynamics>`.

    They act along the joint, by the work of each. An explicit 0 counts as nothing, because
    exporters write it by default.
    """
    found: dict[str, dict[str, float]] = {"friction": {}, "damping": {}}
    for one in model.joints.values():
        follows = one.mimic is not None and one.mimic.joint == joint
        ratio = abs(one.mimic.ratio) if one.mimic is not None and follows else one.name == joint
        acting = {"friction": ratio * one.friction, "damping": ratio**2 * one.damping}
        for key, value in acting.items():
            if value:
                found[key][one.name] = value
    return found


def scene_after(scene: Scene, task: Task) -> Scene:
    """Return the scene that a task leaves, with its part at the goal.

    A part that was pressed springs back, if its spring exceeds its friction.

    Args:
        scene: The scene before the task.
        task: The task; an object that it picks up or places stays where it is.
    """
    if task.joint is None or task.to is None:
        return scene
    item = scene.object(task.object)
    goal = np.array([task.to])
    if task.verb == "press" and not stays_in_place(item, task.joint, goal, ResistanceConfig())[0]:
        return scene
    return scene.with_joint(task.object, task.joint, task.to)


def _file_words(item: SceneObject, joint: str) -> dict[str, str]:
    """Return the friction, damping and spring that count by the object's files, in words."""
    given = item.resistance.get(joint, JointResistance())
    slides = item.joint(joint).kind == "prismatic"
    units = {"friction": "N" if slides else "Nm", "damping": "Ns/m" if slides else "Nms/rad"}
    spring = (
        {"spring": f"{given.spring:.3g} {units['friction']} by its spring"} if given.spring else {}
    )
    return spring | {
        key: f"{sum(of.values()):.3g} {units[key]} by <dynamics {key}> of {' and '.join(of)}"
        for key, of in _file_values(item.model, joint).items()
        if of and getattr(given, key) is None
    }


def has_seal(item: SceneObject, joint: str, config: ResistanceConfig) -> bool:
    """Decide from names whether a door has a seal.

    The words of the joint and of its link decide. If they say nothing, those of the object's
    category do, then those of its name.
    """
    record = item.joint(joint)
    for text in (f"{joint} {record.child}", item.category, item.name):
        words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).lower()
        seal = max((words.rfind(word) for word in config.sealed), default=-1)
        plain = max((at for word in config.unsealed for at in _whole(word, words)), default=-1)
        if max(seal, plain) >= 0:
            return seal > plain
    return False


def _whole(word: str, text: str) -> list[int]:
    """Return where a word stands in a text, alone or in the plural."""
    pattern = rf"(?<![a-z]){re.escape(word)}(?:e?s)?(?![a-z])"
    return [found.start() for found in re.finditer(pattern, text)]


@owner_cache()
def part_masses(
    model: Articulated,
    links: Sequence[str],
    config: ResistanceConfig,
    total: float | None = None,
) -> dict[str, tuple[float, Float[np.ndarray, "3"]]]:
    """Return mass [kg] and center of mass in the link's frame [m] of links that move together.

    Links have the mass in their file. Others have the assumed density, with their sum in its
    bounds; the minimum holds where no link has a mass in the file.

    Args:
        model: The object.
        links: The links, at least one.
        config: Assumed density and bounds.
        total: Known mass of all links together [kg].
    """
    volumes = {link: _volume_of(model.hulls[link]) for link in links}
    given = {link: model.urdf.links[link] for link in links if model.urdf.links[link].mass > 0}
    masses = {link: (one.mass, np.array(one.center)) for link, one in given.items()}
    assumed = config.density * sum(v for link, (v, _) in volumes.items() if link not in given)
    least = 0.0 if given else config.least_mass
    factor = np.clip(assumed, least, config.most_mass) / assumed if assumed > 0 else 0.0
    for link, (volume, center) in volumes.items():
        if link not in given:
            masses[link] = (float(factor * config.density * volume), center)
    found = sum(mass for mass, _ in masses.values())
    if found <= 0:
        masses[links[0]], found = (least, np.zeros(3)), least
    if total is not None and found > 0:
        masses = {link: (mass * total / found, at) for link, (mass, at) in masses.items()}
    return {link: masses[link] for link in links}


def object_mass(
    item: SceneObject, config: ResistanceConfig
) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return mass [kg] and center of mass [m] of a whole object at rest, in its root's frame."""
    model = item.model
    masses = part_masses(model, model.links, config, item.mass)
    total = sum(mass for mass, _ in masses.values())
    moment = np.zeros(3)
    for link, (mass, center) in masses.items():
        T = model.rest_poses[link]
        moment += mass * (T[:3, :3] @ center + T[:3, 3])
    return total, moment / max(total, 1e-12)


def _volume_of(hulls: Sequence[Hull]) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return volume [m^3] and centroid [m] of some hulls."""
    found = [_volume(hull) for hull in hulls]
    total = sum(volume for volume, _ in found)
    if total <= 0:
        return 0.0, np.zeros(3)
    return total, np.asarray(sum(volume * center for volume, center in found) / total)


def _volume(hull: Hull) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return volume [m^3] and centroid [m] of a hull."""
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    parts = np.einsum("fi,fi->f", np.cross(a, b), c) / 6
    total = float(parts.sum())
    if total <= 0:
        return 0.0, hull.vertices.mean(0)
    return total, ((a + b + c) / 4 * parts[:, None]).sum(0) / total
