"""Options that several commands share: their types and checks.

tyro tells a value from None at once where the type is a `typing.Optional`; for `X | None` it
imports typeguard, which takes longer than all else that it does.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

from tyro.conf import UseAppendAction, arg

from momapos.errors import InputError

OptionalPath = Optional[Path]  # noqa: UP045
OptionalText = Optional[str]  # noqa: UP045
OptionalNumber = Optional[float]  # noqa: UP045
Target = Annotated[str, arg(metavar="OBJECT[/JOINT]")]
Thing = Annotated[str, arg(metavar="OBJECT")]
PoseArg = Annotated[OptionalText, arg(metavar="X,Y,YAW")]
ToArg = Annotated[OptionalText, arg(metavar="VALUE")]
if TYPE_CHECKING:
    JointsArg = tuple[str, ...]
else:  # tyro takes the members of a plain tuple for texts, and imports typeguard for any other
    JointsArg = Annotated[UseAppendAction[tuple], arg(metavar="OBJECT/JOINT=VALUE")]
MAX_SEED = 2**63 - 1


def check_seed(seed: int) -> None:
    """Refuse what is no seed.

    Raises:
        InputError: It is negative or has more than 63 bits.
    """
    if not 0 <= seed <= MAX_SEED:
        raise InputError(f"--seed must be between 0 and {MAX_SEED}")
