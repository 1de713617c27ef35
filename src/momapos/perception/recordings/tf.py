"""Compute the pose of a frame at given times from recorded transforms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

TOLERANCE = 0.1
"""A transform is extrapolated by this much before its first and after its last sample [s]."""
MAX_DEPTH = 100


@dataclass
class TransformTree:
    """Transforms by child frame."""

    parents: dict[str, Counter[str]] = field(default_factory=dict)
    samples: dict[tuple[str, str], list[tuple[int, tuple[float, ...]]]] = field(
        default_factory=dict
    )
    """Of each (parent, child): time [ns], and x, y, z [m], qx, qy, qz, qw."""
    static: set[tuple[str, str]] = field(default_factory=set)

    def add(
        self, stamp: int, parent: str, child: str, values: tuple[float, ...], fixed: bool
    ) -> None:
        """Add one transform, unless it is not finite or has no rotation."""
        if not np.isfinite(values).all() or not 0.5 < np.linalg.norm(values[3:]) < 2:
            return
        edge = (parent.lstrip("/"), child.lstrip("/"))
        self.parents.setdefault(edge[1], Counter())[edge[0]] += 1
        self.samples.setdefault(edge, []).append((stamp, values))
        if fixed:
            self.static.add(edge)

    def frames(self) -> list[str]:
        """Return the names of all frames."""
        return sorted({name for edge in self.samples for name in edge})

    def chain(self, frame: str, fixed_frame: str | None) -> list[tuple[str, str]]:
        """Return the transforms from a frame upward.

        Args:
            frame: Start.
            fixed_frame: End; the root if None.

        Returns:
            Pairs of (parent, child), the frame's own first; empty without a parent.

        Raises:
            ValueError: There is no path, or the frames form a cycle.
        """
        edges: list[tuple[str, str]] = []
        here = frame.lstrip("/")
        end = None if fixed_frame is None else fixed_frame.lstrip("/")
        while here != end and here in self.parents:
            # Two sources may give a frame different parents; the more frequent one is the odometry.
            parent = self.parents[here].most_common(1)[0][0]
            edges.append((parent, here))
            here = parent
            if len(edges) > MAX_DEPTH:
                raise ValueError(f"the frames above {frame!r} form a cycle")
        if end is not None and here != end:
            raise ValueError(f"no path from {end!r} to {frame!r}; {here!r} has no parent")
        return edges

    def poses(
        self, edges: Iterable[tuple[str, str]], stamps: Int[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 4 4"], Bool[np.ndarray, " n"]]:
        """Compose a chain at given times.

        Args:
            edges: From `chain`.
            stamps: Times [ns].

        Returns:
            Transforms from the frame to the end of the chain, and at which times all of them are
            known.
        """
        Ts = np.tile(np.eye(4), (len(stamps), 1, 1))
        known = np.ones(len(stamps), bool)
        for edge in edges:
            Ts_parent_child, there = self._at(edge, stamps)
            Ts = Ts_parent_child @ Ts
            known &= there
        return Ts, known

    def _at(
        self, edge: tuple[str, str], stamps: Int[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 4 4"], Bool[np.ndarray, " n"]]:
        samples = self.samples[edge]
        times, first = np.unique([stamp for stamp, _ in samples], return_index=True)
        values = np.array([samples[i][1] for i in first])
        Ts = np.tile(np.eye(4), (len(stamps), 1, 1))
        if edge in self.static or len(times) == 1:
            Ts[:, :3, 3] = values[-1, :3]
            Ts[:, :3, :3] = Rotation.from_quat(values[-1, 3:]).as_matrix()
            near = np.abs(stamps - times[-1]) <= TOLERANCE * 1e9
            return Ts, near | (edge in self.static)
        # Nanoseconds since 1970 do not fit into a float; those since the first sample do.
        seconds, wanted = (times - times[0]) * 1e-9, (stamps - times[0]) * 1e-9
        known = (wanted >= -TOLERANCE) & (wanted <= seconds[-1] + TOLERANCE)
        wanted = np.clip(wanted, 0.0, seconds[-1])
        Ts[:, :3, 3] = np.stack([np.interp(wanted, seconds, axis) for axis in values[:, :3].T], 1)
        Ts[:, :3, :3] = Slerp(seconds, Rotation.from_quat(values[:, 3:]))(wanted).as_matrix()
        return Ts, known
