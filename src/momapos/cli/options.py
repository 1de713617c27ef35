"""Types of options that several commands share.

tyro tells a value from None at once where the type is a `typing.Optional`; for `X | None` it
imports typeguard, which takes longer than all else that it does.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

from tyro.conf import arg

OptionalPath = Optional[Path]  # noqa: UP045
OptionalText = Optional[str]  # noqa: UP045
OptionalNumber = Optional[float]  # noqa: UP045
Target = Annotated[str, arg(metavar="OBJECT[/JOINT]")]
Thing = Annotated[str, arg(metavar="OBJECT")]
StartArg = Annotated[OptionalText, arg(metavar="X,Y,YAW")]
ToArg = Annotated[OptionalText, arg(metavar="VALUE")]
