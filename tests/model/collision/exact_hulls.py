"""Reference implementations: shapes as formulas, hulls as in the exact check."""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float

from momapos.core.geometry.transforms import invert
from momapos.model.collision.spheres import Spheres
from momapos.model.kinematics.chain import Chain
from momapos.model.robots.robot import Robot
from momapos.model.urdf.hulls import Boxes
from momapos.model.urdf.reader import Geometry
from momapos.verification.convex import Body, overlap


def signed_distance(shape: Geometry, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the distance to a primitive in the link frame, negative inside [m]."""
    T = shape.T_link_geometry
    x = (points - T[:3, 3]) @ T[:3, :3]
    if shape.kind == "sphere":
        return np.linalg.norm(x, axis=1) - shape.size[0]
    if shape.kind == "box":
        d = np.abs(x) - np.array(shape.size) / 2
    else:
        radius, length = shape.size
        across = np.hypot(x[:, 0], x[:, 1]) - radius
        d = np.stack([across, np.abs(x[:, 2]) - length / 2], -1)
    return np.linalg.norm(np.maximum(d, 0), axis=1) + np.minimum(d.max(1), 0)


def surface_points(
    shape: Geometry, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Return random points on a primitive, including edges and corners."""
    if shape.kind == "sphere":
        x = directions(count, rng) * shape.size[0]
    elif shape.kind == "box":
        x = rng.uniform(-1, 1, (count, 3))
        # One, two or three coordinates at their limits: faces, edges and corners.
        ends = rng.random((count, 3)).argsort(1) <= rng.integers(0, 3, (count, 1))
        x = np.where(ends, np.sign(x), x) * np.array(shape.size) / 2
    else:
        radius, length = shape.size
        angle, kind = rng.uniform(-np.pi, np.pi, count), rng.integers(0, 3, count)
        r = np.where(kind == 0, radius * np.sqrt(rng.random(count)), radius)
        z = np.where(kind == 1, rng.uniform(-1, 1, count), rng.choice([-1, 1], count)) * length / 2
        x = np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)
    T = shape.T_link_geometry
    return x @ T[:3, :3].T + T[:3, 3]


def directions(count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Return random unit vectors."""
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def rotations(count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3 3"]:
    """Return random rotation matrices."""
    from scipy.spatial.transform import Rotation

    return Rotation.random(count, rng=rng).as_matrix()


def random_boxes(
    count: int, rng: np.random.Generator, low: tuple[float, ...], high: tuple[float, ...]
) -> Boxes:
    """Return boxes of 2 to 60 cm with centers in a range."""
    half = rng.uniform(0.01, 0.3, (count, 3))
    return Boxes(rng.uniform(low, high, (count, 3)), rotations(count, rng), half)


def random_states(chain: Chain, count: int, rng: np.random.Generator) -> Float[np.ndarray, "m n"]:
    """Return configurations within limits, and within one turn for continuous joints."""
    lower = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    upper = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    return rng.uniform(lower, upper, (count, chain.size))


def link_spheres(robot: Robot, link: str) -> tuple[np.ndarray, np.ndarray]:
    """Return centers in the link's frame and radii of its spheres."""
    spheres, group = robot.spheres, robot.spheres.links.index(link)
    of_link = slice(*spheres.start[group : group + 2])
    T = robot.segments.T_segment_link[link]
    return (spheres.center[of_link] - T[:3, 3]) @ T[:3, :3], spheres.radius[of_link]


class HullPairs:
    """Pairs of hulls whose overlap is self-collision."""

    def __init__(self, spheres: Spheres) -> None:
        hulls, self.spheres = spheres.hulls, spheres
        of = [range(*ends) for ends in itertools.pairwise(hulls.of_group)]
        arm = [(a, b) for i, j in spheres.pairs for a in of[i] for b in of[j]]
        against = np.argwhere(spheres.base_pairs)
        base = [(a, int(hulls.of_base[b])) for g, b in against for a in of[g]]
        self.pairs = np.array([*arm, *dict.fromkeys(base)], int).reshape(-1, 2)
        bodies = [hulls.vertices[slice(*ends)] for ends in itertools.pairwise(hulls.first)]
        self.center = np.array([body.mean(0) for body in bodies]).reshape(-1, 3)
        self.radius = np.array(
            [np.linalg.norm(b - c, axis=1).max() for b, c in zip(bodies, self.center, strict=True)]
        )

    def meet(self, Ts: Float[np.ndarray, "segments 4 4"]) -> bool:
        """Return whether any pair overlaps; pairs with disjoint bounding spheres are skipped."""
        T = Ts[self.spheres.hulls.segment]
        center = np.einsum("hij,hj->hi", T[:, :3, :3], self.center) + T[:, :3, 3]
        a, b = self.pairs.T
        apart = np.linalg.norm(center[a] - center[b], axis=1) > self.radius[a] + self.radius[b]
        near = self.pairs[~apart].tolist()
        return any(hulls_meet(self.spheres, Ts, (i, j)) for i, j in near)


def hulls_meet(
    spheres: Spheres, Ts: Float[np.ndarray, "segments 4 4"], pair: tuple[int, int]
) -> bool:
    """Return whether two hulls overlap at given segment poses, by the exact check."""
    hulls = spheres.hulls
    bodies = [
        (Body(hulls.vertices[hulls.first[h] : hulls.first[h + 1]], 0.0, 0.0), hulls.segment[h])
        for h in pair
    ]
    (a, m), (b, n) = bodies
    return overlap(a, b, np.ascontiguousarray(invert(Ts[n]) @ Ts[m])) > 0.0
