"""Check what a plan states about its scene against the scene file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from momapos.model.records import JointResistance, Overrides, PlacementPlan, Task
from momapos.model.scene import (
    ResistanceConfig,
    Scene,
    SceneObject,
    assumed_with,
    known_resistance,
    object_mass,
    stated_resistance,
)

from .report import Check, verdict

SAME_SHARE = 0.01
"""Largest difference of a resistance or mass from the file's, as a share of it [-]: files and plans
are rounded."""
SAME_VALUE = 1e-6
"""Joint values that differ by less are the same [rad] or [m]."""


def scene_checks(plan: PlacementPlan, scene: Scene) -> Iterator[Check]:
    """Check that task, resistance and mass of a plan do not contradict its scene file.

    Args:
        plan: The plan.
        scene: The scene of the file, with joints as in the plan and what its user has set.
    """
    item, task = scene.object(plan.task.object), plan.task
    if task.follower:
        joint = item.model.joints.get(task.follower)
        follows = joint is not None and joint.mimic is not None and joint.mimic.joint == task.joint
        yield verdict("task.follower follows task.joint", follows, f"{task.follower!r:.80}")
    known, found = _stated(item, task), []
    for name, value in _assumed(plan).items():
        if name in known and not _same(value, known[name]):
            found.append(f"{name} {value:g}, the scene states {known[name]:g}")
    yield verdict("resistance and mass are as the scene states", not found, "; ".join(found))


def scene_notes(plan: PlacementPlan, scene: Scene, filed: Scene) -> Iterator[str]:
    """Yield what a plan assumes about its scene that the file does not state.

    Args:
        plan: The plan.
        scene: The scene of the file, with joints as in the plan and what its user has set.
        filed: The scene of the file.
    """
    for name, joints in plan.scene_joints.items():
        before = filed.object(name).values()
        for joint, value in joints.items():
            if abs(value - before[joint]) > SAME_VALUE:
                yield (
                    f"the plan begins with {name}/{joint} at {value:.4g}, where the scene file has "
                    f"{before[joint]:.4g}"
                )
    yield from _override_notes(plan.overrides)
    item, assumed = scene.object(plan.task.object), _assumed(plan)
    if plan.task.joint is not None and not assumed:
        yield (
            f"the plan states no resistance of {item.name}/{plan.task.joint}; what the scene "
            "states, or momapos assumes, is used"
        )
    usual, stated = _usual(item, plan), _stated(item, plan.task)
    other = [
        f"{name} {value:.4g}, usually {usual[name]:.4g}"
        for name, value in assumed.items()
        if name not in stated and usual[name] is not None and not _same(value, usual[name])
    ]
    if other:
        yield (
            f"the plan assumes of {item.name} what no file states, and other values than usual: "
            f"{'; '.join(other)}; its loads are checked with both"
        )


def assumes_otherwise(plan: PlacementPlan, scene: Scene) -> bool:
    """Return whether a plan assumes another resistance or mass than its files and momapos do."""
    usual = _usual(scene.object(plan.task.object), plan)
    return any(
        usual[name] is None or not _same(value, usual[name])
        for name, value in _assumed(plan).items()
    )


def _assumed(plan: PlacementPlan) -> dict[str, float]:
    """Return the resistance of the task's joint, or the object's mass, that a plan states."""
    task = plan.task
    if task.joint is None:
        payload = None if plan.loads is None else plan.loads.payload
        return {} if payload is None else {"mass": payload}
    stated = plan.resistance.get(task.object, {}).get(task.joint, JointResistance())
    return stated.members()


def _stated(item: SceneObject, task: Task) -> dict[str, float]:
    """Return the resistance of the task's joint, or the mass, that the scene's files state."""
    links = item.model.links
    if task.joint is None:
        mass = all(item.model.urdf.links[link].mass > 0.0 for link in links)
        stated = {} if item.mass is None else {"mass": item.mass}
        return stated or ({"mass": object_mass(item, ResistanceConfig())[0]} if mass else {})
    known = stated_resistance(item, task.joint).members()
    links = item.model.moved_by(task.joint)
    if "mass" not in known and all(item.model.urdf.links[link].mass > 0.0 for link in links):
        mass_of = known_resistance(item, task.joint, ResistanceConfig()).mass
        assert mass_of is not None
        known["mass"] = mass_of
    return known


def _usual(item: SceneObject, plan: PlacementPlan) -> Mapping[str, float | None]:
    """Return the resistance of the task's joint, or the mass, by the files and what is assumed."""
    config = assumed_with(plan.overrides.assumed)
    if plan.task.joint is None:
        return {"mass": object_mass(item, config)[0]}
    known = known_resistance(item, plan.task.joint, config)
    return {**dict.fromkeys(_FIELDS), **known.members()}


def with_usual(scene: Scene, plan: PlacementPlan) -> Scene:
    """Return the scene with the usual resistance of the task's joint, or the usual mass."""
    item, config = scene.object(plan.task.object), assumed_with(plan.overrides.assumed)
    if plan.task.joint is None:
        return scene.with_mass(item.name, object_mass(item, config)[0])
    known = known_resistance(item, plan.task.joint, config)
    return scene.with_resistance({item.name: {plan.task.joint: known}})


def _override_notes(overrides: Overrides) -> Iterator[str]:
    set_by_user = [f"the mass of {name} to {mass:g} kg" for name, mass in overrides.mass.items()]
    set_by_user += [
        f"{key} of {name}/{joint} to {value:g}"
        for name, joints in overrides.resistance.items()
        for joint, known in joints.items()
        for key, value in known.members().items()
    ]
    set_by_user += [f"the assumed {key} to {value:g}" for key, value in overrides.assumed.items()]
    if set_by_user:
        yield f"the user of the plan has set {', '.join(set_by_user)}"


_FIELDS = tuple(JointResistance.__dataclass_fields__)


def _same(one: float, other: float | None) -> bool:
    return other is not None and math.isclose(one, other, rel_tol=SAME_SHARE, abs_tol=1e-6)
