"""Configure the assumed resistance of parts. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from momapos.core import refuse_below, unknown_name


@dataclass(frozen=True)
class ResistanceConfig:
    """Mass and resistance of doors and drawers whose files and scene give none.

    Grasps must transmit these, and the simulation moves parts against them. The order of magnitude
    follows forces that people and robots measured at household doors and drawers (Jain and Kemp,
    Autonomous Robots 35, 2013): the largest force occurs at the start, and refrigerators need more
    than cabinets.
    """

    density: float = 300.0
    """Density of moving parts with contents, over the volume of their hulls [kg/m^3]."""
    least_mass: float = 0.5
    """Minimum mass of a part without inertial data [kg]."""
    most_mass: float = 25.0
    """Maximum mass of such a part [kg]; limits the mass of a hollow drawer with a solid hull."""
    hinge_friction: float = 0.4
    """Dry friction of hinges [Nm]."""
    hinge_damping: float = 0.5
    """Damping of hinges [Nms/rad]."""
    slide_friction: float = 4.0
    """Dry friction of slides [N]."""
    slide_damping: float = 8.0
    """Damping of slides [Ns/m]."""
    hand_speed: float = 0.25
    """Speed of the hand with which damping resists where a plan has no times: the largest one that
    the trajectories of plans have by default [m/s]."""
    turn_speed: float = 1.0
    """Largest speed of a hinge or knob at it: about half the speed limit of a wrist [rad/s]."""
    seal_force: float = 30.0
    """Pull at the handle that opens a closed door with a seal [N]."""
    latch_force: float = 6.0
    """Pull at the handle that opens any other closed part, with a catch or spring [N]."""
    seal_travel: float = 0.01
    """Travel of the handle over which that pull fades to nothing: a magnetic gasket lets go within
    a few millimeters [m]."""
    sealed: tuple[str, ...] = ("fridge", "refrigerator", "freezer", "oven", "dishwasher")
    """Words in the names of a joint and its link, else of the object, whose doors have a seal."""
    unsealed: tuple[str, ...] = (
        "cabinet", "cupboard", "counter", "shelf", "table", "hood", "stand", "cart", "wardrobe",
        "knob", "dial", "button", "switch", "lever",
    )  # fmt: skip
    """Words that name what has no seal, also if they follow one of those: an oven cabinet."""

    def __post_init__(self) -> None:
        refuse_below(self, 1e-6, "seal_travel")
        refuse_below(
            self, 0, "density", "hinge_friction", "hinge_damping", "slide_friction",
            "slide_damping", "hand_speed", "turn_speed", "seal_force", "latch_force",
        )  # fmt: skip
        refuse_below(self, 0.001, "least_mass")
        refuse_below(self, self.least_mass, "most_mass")

    def changed(self) -> dict[str, float]:
        """Return the numbers that are not the default, by name."""
        usual = ResistanceConfig()
        ours = {item.name: getattr(self, item.name) for item in fields(ResistanceConfig)}
        return {
            name: float(value)
            for name, value in ours.items()
            if isinstance(value, float) and value != getattr(usual, name)
        }


def assumed_with(settings: Mapping[str, float]) -> ResistanceConfig:
    """Return the assumed values with other settings, see `ResistanceConfig.changed`.

    Raises:
        InputError: A setting is unknown, or out of range.
    """
    known = [item.name for item in fields(ResistanceConfig) if item.type == "float"]
    for name in settings:
        if name not in known:
            raise unknown_name("setting", name, known, "overrides.assumed")
    return ResistanceConfig(**settings)  # type: ignore[arg-type]
