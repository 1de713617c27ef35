"""Define the types and checks of options that several commands share.

tyro tells a value from None quickly if the type is a `typing.Optional`; for `X | None` it imports
typeguard, which takes longer than everything else tyro does.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

from tyro.conf import Positional, UseAppendAction, arg

from momapos.core import InputError


def optional(metavar: str, default: object = None) -> Any:
    """Describe an option that is None unless the user gives it.

    Args:
        metavar: The value, in the help text.
        default: What applies without the option; shown in the help text.
    """
    hint = "" if default is None else f"(default: {default})"
    return arg(metavar=metavar, help_behavior_hint=hint)


Number = Optional[float]  # noqa: UP045
Text = Optional[str]  # noqa: UP045
OptionalFile = Annotated[Optional[Path], optional("FILE")]  # noqa: UP045
OptionalFolder = Annotated[Optional[Path], optional("DIR")]  # noqa: UP045
OptionalRobot = Annotated[Text, optional("ROBOT")]
OptionalCount = Annotated[Optional[int], optional("N")]  # noqa: UP045
RobotOption = Annotated[str, arg(metavar="ROBOT")]
ArmOption = Annotated[str, arg(metavar="ARM")]
Flag = Annotated[bool, arg(help_behavior_hint="")]
SceneArg = Annotated[Positional[str], arg(metavar="SCENE")]
PlanArg = Annotated[Positional[Path], arg(metavar="PLAN")]
RobotArg = Annotated[Positional[str], arg(metavar="ROBOT")]
Target = Annotated[Positional[str], arg(metavar="OBJECT[/JOINT]")]
ObjectArg = Annotated[Positional[str], arg(metavar="OBJECT")]
PoseArg = Annotated[Text, optional("X,Y,YAW")]
ValueArg = Annotated[Text, optional("VALUE")]
PoseFileArg = Annotated[Positional[Path], arg(metavar="POSES")]
PathFileArg = Annotated[Positional[Optional[Path]], arg(metavar="PATH")]  # noqa: UP045
GraspsArg = Annotated[Text, optional("FILE[@FRAME]")]
PlaceArg = Annotated[str, arg(metavar="PLACE")]
RobustArg = Annotated[Text, optional("LENGTH,ANGLE")]
BaseArg = Annotated[Text, optional("fixed|stops|moving|auto")]
SecondsArg = Annotated[Number, optional("SECONDS")]
MassArg = Annotated[Number, optional("KG")]
BoxArg = Annotated[Text, optional("LxWxH")]
if TYPE_CHECKING:
    JointsArg = tuple[str, ...]
    AreasArg = tuple[str, ...]
    LabelsArg = tuple[str, ...]
    PackagesArg = tuple[str, ...]
    XacroArg = tuple[str, ...]
    PartsArg = tuple[str, ...]
    PosesArg = tuple[str, ...]
    LinksArg = tuple[str, ...]
    HomeArg = tuple[str, ...]
    ObjectsArg = tuple[str, ...]
    SettingsArg = tuple[str, ...]
else:  # tyro takes the members of a plain tuple for texts, and imports typeguard for any other
    Several = UseAppendAction[tuple]
    JointsArg = Annotated[Several, arg(metavar="OBJECT/JOINT=VALUE")]
    AreasArg = Annotated[Several, arg(metavar="AREA")]
    LabelsArg = Annotated[Several, arg(metavar="OBJECT=LABEL")]
    PackagesArg = Annotated[Several, arg(metavar="NAME=DIR")]
    XacroArg = Annotated[Several, arg(metavar="NAME=VALUE")]
    PartsArg = Annotated[Several, arg(metavar="[NAME=]FILE")]
    PosesArg = Annotated[Several, arg(metavar="[PART=]X,Y,Z[,R,P,Y]")]
    LinksArg = Annotated[Several, arg(metavar="[PART=][OTHER/]LINK")]
    HomeArg = Annotated[Several, arg(metavar="JOINT=VALUE")]
    ObjectsArg = Annotated[Several, arg(metavar="OBJECT")]
    SettingsArg = Annotated[Several, arg(metavar="FIELD=VALUE")]
MAX_SEED = 2**63 - 1
DEFAULT_SAMPLES = 100
"""Base poses at which a tolerance is sampled [-]."""
MAX_SAMPLES = 10_000
EXIT_STATUS = {"solved": 0, "assumed": 3, "infeasible": 3, "timeout": 4}
"""Exit status of the commands that plan, by the status of the plan."""


def exit_status(status: str, *, allow_assumed: bool) -> int:
    """Return the exit status for a plan; with --allow-assumed an assumed plan counts as solved."""
    return EXIT_STATUS["solved" if allow_assumed and status == "assumed" else status]


def check_seed(seed: int) -> None:
    """Refuse a seed that is negative or has more than 63 bits.

    Raises:
        InputError: The seed is out of range.
    """
    if not 0 <= seed <= MAX_SEED:
        raise InputError(f"--seed must be between 0 and {MAX_SEED}")


def check_count(option: str, value: int, least: int, most: int) -> None:
    """Refuse a number that is out of range.

    Raises:
        InputError: The value of the option is below `least` or above `most`.
    """
    if not least <= value <= most:
        raise InputError(f"{option} must be between {least} and {most}, not {value}")


def check_samples(samples: int) -> None:
    """Refuse a number of tolerance samples that is out of range.

    Raises:
        InputError: It is below 1 or above the limit.
    """
    check_count("--tolerance-samples", samples, 1, MAX_SAMPLES)
