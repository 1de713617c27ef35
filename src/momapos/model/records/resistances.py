"""The record of what is known about the resistance of a joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from momapos.core import check_fields, compare_by_content, finite_number

MAX_VALUE = 1e5
"""Maximum force, torque, damping, mass, travel or lever; excludes mistaken units [-]."""


@dataclass(frozen=True)
class JointResistance:
    """Known resistance of a joint; None where momapos assumes a value, see `ResistanceConfig`.

    Raises:
        InputError: A value is not finite, negative or larger than 1e5.
    """

    seal_force: float | None = None
    """Pull at the handle that opens the closed part, with its seal, latch or catch [N]."""
    seal_travel: float | None = None
    """Travel of the handle over which this pull fades to nothing [m]."""
    lever: float | None = None
    """Travel of the point where these two are measured per unit of the joint: its distance from a
    hinge [m], 1 for a slide. None for the handle's."""
    friction: float | None = None
    """Dry friction [Nm] or [N]."""
    damping: float | None = None
    """Damping [Nms/rad] or [Ns/m]."""
    mass: float | None = None
    """Mass of all that the joint moves [kg]."""
    balanced: bool | None = None
    """Whether springs bear the weight of the part, as in most dishwashers and lift-up doors."""

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("seal_force", "seal_travel", "lever", "friction", "damping", "mass"):
            value = getattr(self, name)
            if value is not None:
                least = 1e-6 if name in ("seal_travel", "lever", "mass") else 0.0
                number = finite_number(f"JointResistance.{name}", value, least, MAX_VALUE)
                object.__setattr__(self, name, number)

    def members(self) -> dict[str, float | bool]:
        """Return the known values by name, as files hold them."""
        return {key: value for key, value in asdict(self).items() if value is not None}


@compare_by_content
@dataclass(frozen=True, eq=False)
class Overrides:
    """What a user has set of forces and masses, against or beyond what the files state."""

    resistance: Mapping[str, Mapping[str, JointResistance]] = field(default_factory=dict)
    """Resistance by object and joint."""
    mass: Mapping[str, float] = field(default_factory=dict)
    """Mass of whole objects [kg]."""
    assumed: Mapping[str, float] = field(default_factory=dict)
    """Settings of `ResistanceConfig` that are not the default, by name."""

    @property
    def any(self) -> bool:
        """Return whether anything is set."""
        return bool(self.resistance or self.mass or self.assumed)


NO_OVERRIDES: Overrides = Overrides()
