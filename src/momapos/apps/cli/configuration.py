"""Configurations on the command line: --config FILE, --set FIELD=VALUE and --help-all."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal, Optional

from tyro.conf import arg

from momapos.core import InputError, finite_number
from momapos.planning import PipelineConfig
from momapos.planning.importance import ScorerName
from momapos.planning.placement import Method

from .options import (
    ArmOption,
    Flag,
    Number,
    OptionalCount,
    OptionalFile,
    RobotOption,
    SettingsArg,
    check_seed,
    optional,
)


@dataclass(frozen=True)
class ConfigOptions:
    """Options for fields that have none of their own."""

    config: Annotated[OptionalFile, optional("FILE.toml")] = None
    """Read further settings from this file, in tables such as [importance]."""
    set: SettingsArg = ()
    """Set one field, such as importance.k0=1; several numbers as 0.5+1.5."""
    help_all: Flag = False
    """List all fields for --config and --set, and exit."""


ConfigArgs = Annotated[ConfigOptions, arg(name="")]
NO_SETTINGS = ConfigOptions()
Views = Literal["voting", "first"]


@dataclass(frozen=True)
class ScanSettings:
    """How a scan is read and modeled."""

    voxel: float = 0.015
    """Voxel size for the fusion of depth images [m]."""
    views: Optional[Views] = None  # noqa: UP045 (see cli.options)
    """How the front of an object is chosen: by a vote of all images, or by the first image that
    passes, as in the paper. None: first for solve with the paper's placement method, else
    voting."""
    grid: bool = False
    """Snap parts to URDFormer's grid of 13 marks."""
    depth_topic: Optional[str] = None  # noqa: UP045 (see cli.options)
    """Topic of the depth images in a recording; none: found by type and name."""
    color_topic: Optional[str] = None  # noqa: UP045 (see cli.options)
    """Topic of the color images."""
    info_topic: Optional[str] = None  # noqa: UP045 (see cli.options)
    """Topic of the camera info."""
    fixed_frame: Optional[str] = None  # noqa: UP045 (see cli.options)
    """Fixed frame of a recording; none: the root of tf."""

    def __post_init__(self) -> None:
        finite_number("voxel", self.voxel, 1e-3, 1.0)


@dataclass(frozen=True)
class Configuration(PipelineConfig):
    """All that a configuration file can hold: the pipeline's settings, and those of scans."""

    scan: ScanSettings = field(default_factory=ScanSettings)

    @property
    def pipeline(self) -> PipelineConfig:
        """The pipeline's part."""
        return PipelineConfig(
            **{item.name: getattr(self, item.name) for item in fields(PipelineConfig)}
        )


DEFAULT = Configuration()
MethodOption = Annotated[Optional[Method], optional("METHOD", DEFAULT.place.method)]  # noqa: UP045
TimeoutOption = Annotated[Number, optional("SECONDS", f"{DEFAULT.timeout:g}")]
AlphaOption = Annotated[Number, optional("SCORE", DEFAULT.importance.resolved.alpha)]
ScorerOption = Annotated[Optional[ScorerName], optional("SCORER", "reach")]  # noqa: UP045
OWN = {
    "method": "place.method", "timeout": "timeout", "alpha": "importance.alpha",
    "scorer": "importance.scorer", "polish": "place.polish",
}  # fmt: skip
"""Fields that have an option of their own, by the option's name."""
PIPELINE = tuple(item.name for item in fields(PipelineConfig))
"""Names of the pipeline's fields and tables."""


@dataclass(frozen=True)
class SearchOptions:
    """Options of the commands that search for a base pose."""

    robot: RobotOption = "fetch"
    """A library robot or a robot file."""
    arm: ArmOption = "any"
    """The arm of a robot with several, such as left; any: the arm of the cheapest plan."""
    tolerance: Flag = False
    """Measure the tolerance of the base pose, which takes longer than to find it."""
    method: MethodOption = None
    """ours, exhaustive (a grid), or a baseline such as paper or habitat (docs/baselines.md)."""
    timeout: TimeoutOption = None
    """Processor time after which the command ends with what is known (default for solve: of each
    search). Compiling kernels, drawing and running in physics do not count."""
    alpha: Annotated[Number, optional("SCORE")] = None
    """Objects of lower importance stay boxes, in [0, 1] (default: 0.45 from a scan and in scenes of
    more than 50 objects, else 0)."""
    polish: OptionalCount = None
    """Maximum number of steps to cheaper base poses nearby, which are as robust; 0: the first one
    that works, at once (ours; default: 16)."""
    seed: int = 0
    """The same seed gives the same plan."""
    allow_assumed: Flag = False
    """Accept a plan for a joint type that is not the most probable one (status `assumed`)."""

    def __post_init__(self) -> None:
        check_seed(self.seed)

    def load_config(self, options: ConfigOptions, used: Sequence[str]) -> Configuration:
        """Read the configuration; see the function `load_config`."""
        return load_config(
            options, used, method=self.method, timeout=self.timeout, alpha=self.alpha,
            polish=self.polish,
        )  # fmt: skip


def load_config(options: ConfigOptions, used: Sequence[str], **own: Any) -> Configuration:
    """Put a configuration together: defaults, then --config, then --set, then own options.

    Args:
        options: The file and the settings.
        used: Names of the fields and tables that the command uses. A file may hold others, so that
            several commands can share it.
        own: Values of options in `OWN`; None where an option is not given.

    Raises:
        InputError: A setting is unknown, or has a value of the wrong type or out of range.
    """
    from momapos.planning import Setting, apply_settings, parse_setting, read_settings

    settings = [] if options.config is None else read_settings(options.config, DEFAULT)
    for text in options.set:
        setting = parse_setting(text, DEFAULT, "--set")
        if setting.path.partition(".")[0] not in used:
            raise InputError(
                f"--set {setting.path}: this command doesn't use it; it uses {', '.join(used)}"
            )
        settings.append(setting)
    settings += [
        Setting(OWN[name], value, f"--{name}") for name, value in own.items() if value is not None
    ]
    return apply_settings(DEFAULT, settings)


def all_fields(used: Sequence[str]) -> str:
    """List the fields that a command uses, with defaults and documentation.

    Args:
        used: See `load_config`.
    """
    from momapos.planning import list_fields

    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else 10_000
    wrapper = textwrap.TextWrapper(width, subsequent_indent="    ", break_on_hyphens=False)
    lines = [
        "Set a field with --set FIELD=VALUE, or in a file for --config; a dot stands for a table.",
        "",
    ]
    for item in list_fields(DEFAULT):
        if item.path.partition(".")[0] in used:
            lines += wrapper.wrap(f"{item.path} = {item.value}  {item.text}")
    return "\n".join(lines)
