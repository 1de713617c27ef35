"""Parse values with units: 90deg, 1.2rad, 0.3m, 30cm."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from .errors import TaskError

ANGLES = {"deg": math.pi / 180, "rad": 1.0}
LENGTHS = {"cm": 0.01, "mm": 0.001, "m": 1.0}
GRAVITY = 9.81
"""[m/s^2]"""
MAX = "max"
"""Keyword in place of a value: open the part as far as possible."""
EXAMPLES = "write it as 90deg, 1.2rad, 0.3m or 30cm"
_QUANTITY = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([a-z]*)\s*")


@dataclass(frozen=True)
class Quantity:
    """A number with an optional unit."""

    value: float
    """In SI units if a unit is given, otherwise the plain number."""
    unit: str
    """The unit as written, or ""."""
    text: str

    def angle(self, what: str) -> float:
        """Return the value as an angle [rad].

        Raises:
            TaskError: The unit is a length.
        """
        return self._of(ANGLES, what, "an angle; write it as 90deg or 1.2rad")

    def length(self, what: str) -> float:
        """Return the value as a length [m].

        Raises:
            TaskError: The unit is an angle.
        """
        return self._of(LENGTHS, what, "a length; write it as 0.3m or 30cm")

    def _of(self, units: dict[str, float], what: str, rule: str) -> float:
        if self.unit and self.unit not in units:
            raise TaskError(f"{what} {self.text} is not {rule}")
        return self.value


def parse_quantity(text: str) -> Quantity:
    """Parse a number with or without a unit.

    Raises:
        TaskError: The text is neither.
    """
    match = _QUANTITY.fullmatch(text)
    factors = {"": 1.0, **ANGLES, **LENGTHS}
    try:
        if match and match[2] in factors:
            return Quantity(float(match[1]) * factors[match[2]], match[2], text.strip())
    except ValueError:
        match = None
    raise TaskError(f"{text[:80]!r} is not a value; {EXAMPLES}")


def parse_speed(text: str, what: str) -> float:
    """Parse a speed: 0.05m/s, 5cm/s, or a number [m/s].

    Raises:
        TaskError: The text is none.
    """
    return parse_quantity(text.strip().removesuffix("/s")).length(what)


def length_text(value: float) -> str:
    """Return a length in words: 0.30 m, or 4 mm where it is below 1 cm."""
    return f"{1000 * value:.3g} mm" if 0.0 < abs(value) < 0.01 else f"{value:.2f} m"


def contact_text(one: str, other: str, depth: float) -> str:
    """Return a contact in words: forearm_link 4 mm in shelf/door, or 4 mm from it.

    Args:
        one, other: The shapes.
        depth: How deep they overlap, negative for a distance [m].
    """
    size = 1000 * abs(depth)
    digits = f"{size:.0f}" if size >= 1.0 else f"{size:.1g}"
    return f"{one} {digits} mm {'in' if depth >= 0.0 else 'from'} {other}"
