"""Find the conventions of a recording: direction of the poses, camera axes, unit of depth.

Files rarely state them. Under the right ones, the surfaces of an image lie on those of the next
image after the motion of the camera; under wrong ones, they don't. The comparison is relative to
the depth, so that a wrong unit does not look more exact.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core import InputError
from momapos.core.geometry import invert
from momapos.model.records import Frame

from .pose_check import Surface, agreement

if TYPE_CHECKING:
    from jaxtyping import Float

PoseDirection = Literal["given", "inverted"]
"""Poses map from the camera to the world, or the other way."""
CameraAxes = Literal["opencv", "opengl"]
"""Camera axes: x right, y down, z forward; or x right, y up, z backward."""
SCALES = (1.0, 1000.0, 5000.0, 256.0)
"""Usual units of integer depth per meter: meters, millimeters, TUM, KITTI [1/m]."""
PAIRS = 16
"""Number of pairs of images that are compared [-]."""
AGREED = 0.4
"""Minimum agreement of other conventions than the usual [-]: right ones reach 0.6 to 0.85 in
rendered and recorded kitchens, wrong poses and axes 0.25."""
REFUSED = 0.25
"""Recordings that agree less are refused [-]; noise and drift lower the agreement, too."""
CLEAR = 0.05
"""Agreement of a pair that differs by less is equal [-]."""
BETTER_SHARE = 0.8
"""Conventions are better by far if they are in this share of the pairs that differ [-]."""
MIN_PAIRS = 3
"""A recording with fewer pairs that can be compared is not refused [-]."""
FACTORS = (0.1, 0.2, 0.4, 0.5, 0.63, 1.6, 2.0, 2.5, 5.0, 10.0)
"""Other units of depth are told by the agreement at these multiples of the chosen one [-]."""
PLAUSIBLE = (0.3, 10.0)
"""Range of the median depth in a room [m]."""
OPTIONS = "--poses, --camera-axes, --depth-scale and --up"
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Conventions:
    """Meaning of the numbers in a recording."""

    poses: PoseDirection = "given"
    axes: CameraAxes = "opencv"
    scale: float = 1000.0
    """Units of integer depth per meter [1/m]."""

    def text(self) -> str:
        """Return them in words."""
        where = "camera to world" if self.poses == "given" else "world to camera"
        axes = "OpenCV" if self.axes == "opencv" else "OpenGL"
        return f"poses from {where}, {axes} camera axes, depth in 1/{self.scale:g} m"


@dataclass(frozen=True)
class Stated:
    """Conventions that the user states; None where they are to be found."""

    poses: PoseDirection | None = None
    axes: CameraAxes | None = None
    scale: float | None = None


def with_conventions(
    frames: Sequence[Frame], usual: float, stated: Stated, where: str
) -> tuple[tuple[Frame, ...], tuple[str, ...]]:
    """Return frames with poses from camera to world, OpenCV axes and depth in meters.

    Args:
        frames: As read: in recording order, with depth in units of 1 / `usual` meters.
        usual: Units per meter by which the depth was divided.
        stated: What the user states; nothing else is tried for it.
        where: Name of the scan in errors.

    Returns:
        The frames, and one line if they are not as usual.

    Raises:
        InputError: Surfaces agree under no conventions.
    """
    usually = Conventions("given", "opencv", usual)
    first = Conventions(stated.poses or "given", stated.axes or "opencv", stated.scale or usual)
    poses = [frame.T_world_camera for frame in frames]
    surfaces = [Surface.of(frame) for frame in frames] if _with_depth(frames) else []
    pairs = _pairs(len(surfaces))
    tried = list(dict.fromkeys((first, *_possible(first, stated, _median_depth(frames), usually))))
    trial = _Trial(surfaces, poses, pairs, usual)
    best = _choose(tried, trial)
    if best is None:
        most = max(trial.mean(one) for one in tried)
        raise InputError(
            f"{where}: surfaces of neighboring images agree under no usual poses, camera axes and "
            f"unit of depth (at best to {100 * most:.0f} %); state them by {OPTIONS}, or check "
            "the poses"
        )
    if stated.scale is None and trial.is_known(best):
        _refuse_other_unit(best, trial, where)
    said: tuple[str, ...] = ()
    if best != first:
        said = (
            f"{where}: read with {best.text()}; surfaces agree to {100 * trial.mean(best):.0f} % "
            f"then, and to {100 * trial.mean(first):.0f} % with {first.text()}",
        )
    return tuple(_applied(frame, best, usual) for frame in frames), said


def _with_depth(frames: Sequence[Frame]) -> bool:
    return len(frames) > 1 and all(frame.depth is not None for frame in frames)


def _median_depth(frames: Sequence[Frame]) -> float:
    seen = [f.depth[::8, ::8][f.depth[::8, ::8] > 0] for f in frames if f.depth is not None]
    flat = np.concatenate([np.zeros(0), *seen])
    return float(np.median(flat)) if len(flat) else 0.0


def _possible(
    first: Conventions, stated: Stated, depth: float, usual: Conventions
) -> Iterable[Conventions]:
    """Return all conventions that the user does not exclude, with depth of a room."""
    directions: tuple[PoseDirection, ...] = (
        (stated.poses,) if stated.poses else ("given", "inverted")
    )
    axes: tuple[CameraAxes, ...] = (stated.axes,) if stated.axes else ("opencv", "opengl")
    scales = (stated.scale,) if stated.scale else (first.scale, *SCALES)
    for direction, way, scale in product(directions, axes, scales):
        low, high = PLAUSIBLE
        if scale == first.scale or low <= depth * usual.scale / scale <= high:
            yield Conventions(direction, way, scale)


def _pairs(count: int) -> list[tuple[int, int]]:
    """Return pairs of neighbors, spread over the recording."""
    starts = np.unique(np.linspace(0, count - 2, min(PAIRS, max(count - 1, 0))).astype(int))
    return [(int(k), int(k) + 1) for k in starts] if count > 1 else []


@dataclass(frozen=True, eq=False)
class _Trial:
    """Pairs of images on which conventions are tried."""

    surfaces: Sequence[Surface]
    poses: Sequence[Float[np.ndarray, "4 4"]]
    pairs: Sequence[tuple[int, int]]
    usual: float
    """Units of depth per meter by which it was divided [1/m]."""
    _known: dict[Conventions, Float[np.ndarray, " pairs"]] = field(default_factory=dict)

    def scores(self, one: Conventions) -> Float[np.ndarray, " pairs"]:
        """Return the agreement of each pair, in [0, 1]; NaN for pairs that share too little."""
        if one not in self._known:
            found = []
            for a, b in self.pairs:
                T = invert(_pose(self.poses[b], one)) @ _pose(self.poses[a], one)
                T[:3, 3] *= one.scale / self.usual  # in the unit in which depth was read
                found.append(agreement(self.surfaces[a], self.surfaces[b], T))
            self._known[one] = np.array(found)
        return self._known[one]

    def is_known(self, one: Conventions) -> bool:
        """Tell whether enough pairs can be compared."""
        scores = self.scores(one)
        return bool(2 * np.isfinite(scores).sum() >= max(len(scores), 1))

    def mean(self, one: Conventions) -> float:
        """Return the mean agreement; 0 if too few pairs can be compared."""
        return float(np.nanmean(self.scores(one))) if self.is_known(one) else 0.0

    def is_better_by_far(self, one: Conventions, other: Conventions) -> bool:
        """Tell whether one agrees better in nearly all pairs that tell the two apart."""
        apart = np.nan_to_num(self.scores(one)) - np.nan_to_num(self.scores(other))
        clear = apart[np.abs(apart) > CLEAR]
        return bool(
            len(clear) >= min(2, len(self.pairs))
            and (clear > 0).mean() >= BETTER_SHARE
            and apart.mean() > CLEAR
        )


def _choose(tried: Sequence[Conventions], trial: _Trial) -> Conventions | None:
    """Return the conventions to use; None if none agree.

    The first are kept if no others are better by far, or if nothing can be compared. Motions that
    do not tell two others apart decide for the one that changes less.
    """
    first = tried[0]
    best = max(tried, key=trial.mean)
    if trial.mean(best) >= AGREED and trial.is_better_by_far(best, first):
        alike = [one for one in tried if not trial.is_better_by_far(best, one)]
        return min(alike, key=lambda one: (_changes(one, first), -trial.mean(one)))
    known = trial.scores(first)[np.isfinite(trial.scores(first))]
    return None if len(known) >= MIN_PAIRS and known.mean() < REFUSED else first


def _refuse_other_unit(best: Conventions, trial: _Trial, where: str) -> None:
    """Raise InputError if the surfaces agree better by far with another unit of depth."""
    other = [replace(best, scale=best.scale * factor) for factor in FACTORS]
    better = max(other, key=trial.mean)
    if trial.mean(better) > trial.mean(best) and trial.is_better_by_far(better, best):
        about = float(f"{better.scale:.2g}")
        raise InputError(
            f"{where}: depth is in none of the usual units: surfaces agree to "
            f"{100 * trial.mean(better):.0f} % with about {about:g} units per meter, and to "
            f"{100 * trial.mean(best):.0f} % with {best.scale:g}; state the unit by --depth-scale"
        )


def _changes(one: Conventions, other: Conventions) -> int:
    return sum((one.poses != other.poses, one.axes != other.axes, one.scale != other.scale))


def _pose(T: Float[np.ndarray, "4 4"], one: Conventions) -> Float[np.ndarray, "4 4"]:
    T = T if one.poses == "given" else invert(T)
    return T @ _OPENGL if one.axes == "opengl" else T.copy()


def _applied(frame: Frame, one: Conventions, usual: float) -> Frame:
    depth = frame.depth
    if depth is not None and one.scale != usual:
        depth = depth * np.float32(usual / one.scale)
    return replace(frame, depth=depth, T_world_camera=_pose(frame.T_world_camera, one))
