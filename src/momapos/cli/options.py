"""Checks of options that many commands share."""

from __future__ import annotations

from momapos.errors import InputError

MAX_SEED = 2**63 - 1


def check_seed(seed: int) -> None:
    """Refuse what is no seed.

    Raises:
        InputError: It is negative or has more than 63 bits.
    """
    if not 0 <= seed <= MAX_SEED:
        raise InputError(f"--seed must be between 0 and {MAX_SEED}")
