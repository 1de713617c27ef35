"""Methods to compare and their variants, and scenes with opened containers."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import get_args

from momapos.core import InputError, unknown_name
from momapos.model.scene import Scene
from momapos.planning import PipelineConfig, apply_settings, parse_setting
from momapos.planning.placement import Method

from .bench_records import DEFAULT_PROTOCOL, Container, Protocol

METHODS: tuple[str, ...] = get_args(Method)


PINCH = ("families=pinch", "turning=false", "sliding=false")
ONE = (*PINCH, "turns=0", "tilts=0", "count=1")
FIXED: Mapping[str, tuple[str, ...]] = {
    "first": ("baselines.first_pose=true",),
    "pinch": tuple(f"motion.grasps.{one}" for one in PINCH),
    "one": tuple(f"motion.grasps.{one}" for one in ONE),
}
"""Settings of the protocols, which no variant may change."""


def method_config(
    text: str, timeout: float, protocol: Protocol = DEFAULT_PROTOCOL
) -> PipelineConfig:
    """Return the configuration of a method or a variant.

    Args:
        text: A method of `momapos place`, alone or followed by a colon and settings of
            `PipelineConfig`, as FIELD=VALUE between commas; see `momapos.planning.parse_setting`.
        timeout: Time to search for one answer [s].
        protocol: The conditions under which an answer counts.

    Raises:
        UnknownNameError: There is no such method or field.
        InputError: The text has another form, or a value is out of range.
    """
    name, colon, rest = text.partition(":")
    if name not in METHODS:
        raise unknown_name("method", name, METHODS, "--methods")
    config = PipelineConfig(timeout=timeout)
    config = replace(config, place=replace(config.place, method=name))  # type: ignore[arg-type]
    source = f"method {text!r}:"
    settings = [parse_setting(one, config, source) for one in rest.split(",")] if colon else []
    for fixed in ("timeout", "place.method"):
        if any(setting.path == fixed for setting in settings):
            raise InputError(f"{source} a variant can't set {fixed}")
    conditions = [
        parse_setting(one, config, f"protocol {protocol}:")
        for word in (protocol.commit, protocol.grasps)
        for one in FIXED.get(word, ())
    ]
    for fixed in {one.path for one in conditions} & {one.path for one in settings}:
        raise InputError(f"{source} a variant can't set {fixed}, which the protocol sets")
    return apply_settings(config, [*settings, *conditions])


def without(scene: Scene, names: Collection[str]) -> Scene:
    """Return the scene without some objects."""
    return replace(scene, objects=tuple(o for o in scene.objects if o.name not in names))


def opened(scene: Scene, box: Container, value: float, carried: Collection[str]) -> Scene:
    """Return the scene with an opened container.

    Args:
        scene: The scene before.
        box: The container.
        value: New value of its joint [rad] or [m].
        carried: Objects that move with it, also without touching it.
    """
    part = f"{box.object}/{box.joint}"
    objects = tuple(
        replace(item, on=part) if item.name in carried else item for item in scene.objects
    )
    return replace(scene, objects=objects).with_joint(box.object, box.joint, value)
