"""Options that several commands share: their types and checks.

tyro tells a value from None at once where the type is a `typing.Optional`; for `X | None` it
imports typeguard, which takes longer than all else that it does.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn, Optional

from tyro.conf import UseAppendAction, arg
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from momapos.core import InputError

OptionalPath = Optional[Path]  # noqa: UP045
OptionalText = Optional[str]  # noqa: UP045
OptionalNumber = Optional[float]  # noqa: UP045
OptionalCount = Optional[int]  # noqa: UP045
Target = Annotated[str, arg(metavar="OBJECT[/JOINT]")]
Thing = Annotated[str, arg(metavar="OBJECT")]
PoseArg = Annotated[OptionalText, arg(metavar="X,Y,YAW")]
ValueArg = Annotated[OptionalText, arg(metavar="VALUE")]
RoomArg = Annotated[OptionalText, arg(metavar="LENGTH,ANGLE")]
BoxArg = Annotated[OptionalText, arg(metavar="LxWxH")]
if TYPE_CHECKING:
    JointsArg = tuple[str, ...]
    AreasArg = tuple[str, ...]
    LabelsArg = tuple[str, ...]
    PackagesArg = tuple[str, ...]
    XacroArg = tuple[str, ...]
    ObjectsArg = tuple[str, ...]
else:  # tyro takes the members of a plain tuple for texts, and imports typeguard for any other
    JointsArg = Annotated[UseAppendAction[tuple], arg(metavar="OBJECT/JOINT=VALUE")]
    AreasArg = Annotated[UseAppendAction[tuple], arg(metavar="AREA")]
    LabelsArg = Annotated[UseAppendAction[tuple], arg(metavar="OBJECT=LABEL")]
    PackagesArg = Annotated[UseAppendAction[tuple], arg(metavar="NAME=DIR")]
    XacroArg = Annotated[UseAppendAction[tuple], arg(metavar="NAME=VALUE")]
    ObjectsArg = Annotated[UseAppendAction[tuple], arg(metavar="OBJECT")]
MAX_SEED = 2**63 - 1
MAX_SAMPLES = 10_000
EXIT_STATUS = {"solved": 0, "infeasible": 3, "timeout": 4}
"""Of commands that answer, by the status of the answer."""


def check_seed(seed: int) -> None:
    """Refuse what is no seed.

    Raises:
        InputError: It is negative or has more than 63 bits.
    """
    if not 0 <= seed <= MAX_SEED:
        raise InputError(f"--seed must be between 0 and {MAX_SEED}")


def check_samples(samples: int) -> None:
    """Refuse what is no number of poses for a tolerance.

    Raises:
        InputError: It is below one or beyond all sense.
    """
    if not 1 <= samples <= MAX_SAMPLES:
        raise InputError(f"--tolerance-samples must be between 1 and {MAX_SAMPLES}, not {samples}")


def unread(kind: type, plain: Collection[str], words: Sequence[str]) -> ConstructorRegistry | None:
    """A rule for tyro: what belongs to a configuration is no option where none of it is given.

    tyro finds the help and the types of all options before it looks at the words, and imports
    typeguard for those that are tuples of numbers; that takes longer than all else it does.

    Args:
        kind: The configuration.
        plain: Names of all options of the command that are not in it.
        words: What follows the command.

    Returns:
        The rule; None where a word may be one of its options, or asks for help about them.
    """
    if any(w.startswith("-") and w.partition("=")[0] not in plain for w in words):
        return None
    registry = ConstructorRegistry()

    def whole(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[object] | None:
        if info.type is not kind:
            return None
        return PrimitiveConstructorSpec(
            nargs=1,
            metavar=kind.__name__,
            instance_from_str=_refuse,
            is_instance=lambda value: isinstance(value, kind),
            str_from_instance=lambda _: [kind.__name__],
        )

    registry.primitive_rule(whole)
    return registry


def _refuse(words: list[str]) -> NoReturn:
    raise ValueError(f"{words} is no configuration")
