"""The record of a latch: a joint of an object that must be turned before its part opens."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Latch:
    """A lever, knob or bolt on a part, which keeps the part closed until it is turned."""

    joint: str
    """The joint of the latch, on the part that it holds."""
    to: float
    """Value from which on the part is free [rad] or [m]."""
    holds: str
    """The joint that it holds."""

    def members(self) -> dict[str, str | float]:
        """Return the fields by name, as files hold them."""
        return asdict(self)
