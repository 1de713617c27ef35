"""Tour files (momapos-tour, version 1), which name the plan files of several tasks in order."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec

from momapos.core import FileFormatError, read_bytes_bounded, write_file
from momapos.model.records import PlacementPlan, Status, status_of_all

from . import plan_members as members
from .plan_format import MAX_BYTES, TOUR, format_of, write_plan

VERSION = 1
MAX_STEPS = 20
"""Largest number of plans in a tour [-]."""


class TourStep(msgspec.Struct, frozen=True):
    """One task of a tour."""

    stop: Annotated[int, msgspec.Meta(ge=1, le=MAX_STEPS)]
    """Stop at which the task is done, from 1."""
    plan: Annotated[str, msgspec.Meta(min_length=1, max_length=255)]
    """Name of its plan file, in the folder of the tour."""


class TourFile(msgspec.Struct, frozen=True):
    """The content of a tour file."""

    status: Status
    """Status of the last plan; `assumed` if an earlier one is."""
    steps: Annotated[tuple[TourStep, ...], msgspec.Meta(min_length=1, max_length=MAX_STEPS)]
    """The tasks in order."""
    stops: int
    """Number of stops [-]."""
    driving: float
    """Total driving length [m]."""
    assumed: tuple[str, ...] = ()
    """Assumptions about the state between the tasks."""


def tour_to_dict(tour: TourFile, plans: Sequence[Any]) -> dict[str, Any]:
    """Convert a tour to a dictionary.

    Args:
        tour: The tour.
        plans: The "plan" of each step: a file name, or the plan itself.
    """
    data = msgspec.to_builtins(tour)
    steps = zip(data["steps"], plans, strict=True)
    return {
        "format": TOUR,
        "version": VERSION,
        **data,
        "steps": [{**s, "plan": p} for s, p in steps],
    }


def write_tour(
    path: Path, plans: Sequence[PlacementPlan], stops: Sequence[int], assumed: Sequence[str],
    status: Status | None = None,
) -> TourFile:  # fmt: skip
    """Write a tour, and its plans in the same folder as NAME_1.json and so on.

    Args:
        path: The tour file.
        plans: One plan per task, in order.
        stops: The stop of each task, from 1.
        assumed: Assumptions about the state between the tasks.
        status: Status of the tour, if it is not that of its plans: some tasks have none.

    Raises:
        InputError: A plan names a file that does not exist, or a file cannot be written.
    """
    tour = tour_of(path, plans, stops, assumed, status)
    for step, plan in zip(tour.steps, plans, strict=True):
        write_plan(plan, path.with_name(step.plan))
    data = tour_to_dict(tour, [step.plan for step in tour.steps])
    write_file(path, json.dumps(data, indent=1) + "\n")
    return tour


def tour_of(
    path: Path, plans: Sequence[PlacementPlan], stops: Sequence[int], assumed: Sequence[str],
    status: Status | None = None,
) -> TourFile:  # fmt: skip
    """Build the content of a tour file, see `write_tour`."""
    steps = tuple(
        TourStep(stop, f"{path.stem}_{number}.json") for number, stop in enumerate(stops, start=1)
    )
    driving = sum(plan.navigation_cost or 0.0 for plan in plans)
    return TourFile(status or status_of_all(plans), steps, max(stops), driving, tuple(assumed))


def is_tour(path: Path) -> bool:
    """Return whether a file's format is that of a tour; nothing else is checked."""
    return bool(format_of(path) == TOUR)


def read_tour(path: Path) -> TourFile:
    """Read a tour file, without the plans that it names.

    Raises:
        FileFormatError: The file is unusable.
    """
    content = read_bytes_bounded(path, MAX_BYTES).removeprefix(b"\xef\xbb\xbf")
    try:
        head = msgspec.json.decode(content, type=members.PlanHead)
        if head.format != TOUR or head.version != VERSION or isinstance(head.version, bool):
            raise FileFormatError(
                f"{path}: not a tour of version {VERSION}; its format is {head.format!r:.60}, its "
                f"version {head.version!r:.60}"
            )
        tour = msgspec.json.decode(content, type=TourFile)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a usable tour: {error}") from error
    for step in tour.steps:
        if Path(step.plan).name != step.plan or step.plan in (".", "..") or "\0" in step.plan:
            raise FileFormatError(
                f"{path}: plan {step.plan!r:.80} must name a file in the folder of the tour"
            )
    return tour
