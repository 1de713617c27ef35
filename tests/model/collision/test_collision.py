"""Collision kernels agree with numpy on the same spheres, and with coal on the exact shapes."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation
from tests.model.collision.exact_hulls import HullPairs, random_boxes, random_states, rotations

from momapos.core.geometry.transforms import invert, pose, pose_planar
from momapos.model.collision.arm_collision import FINGER, FLOOR, FREE, PALM, SELF, check_states
from momapos.model.collision.collision_world import CELL, CollisionWorld, build_world, check
from momapos.model.collision.sphere_cover import BODY
from momapos.model.collision.spheres import MARGIN, Spheres, box_spheres, carry
from momapos.model.kinematics.chain import Chain, chain_arrays
from momapos.model.robots.robot import Robot
from momapos.model.urdf.hulls import Boxes, MovingBoxes
from momapos.model.urdf.reader import Geometry

NONE = Boxes(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))


def moved_by_joint(boxes: Boxes, values: int, rng: np.random.Generator) -> MovingBoxes:
    """Return the boxes at several values of a joint."""
    shift = rng.uniform(-0.3, 0.3, (values, 1, 3))
    turn = rotations(values, rng)[:, None]
    half = np.tile(boxes.half, (values, 1, 1))
    return MovingBoxes(boxes.center + shift, turn @ boxes.rotation, half)


def world_of(
    robot: Robot, rng: np.random.Generator, *, static: int, moving: int, clearance: float
) -> CollisionWorld:
    boxes = random_boxes(static, rng, (-1.5, -1.5, 0.1), (1.5, 1.5, 2.0))
    parts = random_boxes(moving, rng, (-1.0, -1.0, 0.3), (1.0, 1.0, 1.5))
    labels = [f"box {i}" for i in range(static + moving)]
    return build_world(
        boxes, moved_by_joint(parts, 3, rng), rng.random(moving) < 0.5, labels, robot.spheres,
        clearance=clearance,
    )  # fmt: skip


def segment_poses(
    chain: Chain, q: Float[np.ndarray, "m n"], bases: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m segments 4 4"]:
    Ts = [pose_planar(bases)]
    for j in range(chain.size):
        T = np.tile(pose(chain.d[j]), (len(q), 1, 1))
        if chain.prismatic[j]:
            T[:, :3, 3] += q[:, j : j + 1] * chain.h[j]
        else:
            T[:, :3, :3] = Rotation.from_rotvec(q[:, j : j + 1] * chain.h[j]).as_matrix()
        Ts.append(Ts[-1] @ T)
    return np.stack(Ts, 1)


def gaps(
    points: Float[np.ndarray, "*n 3"], center: np.ndarray, rotation: np.ndarray, half: np.ndarray
) -> Float[np.ndarray, "*n boxes"]:
    """Return the distance of points from boxes, zero inside."""
    local = np.einsum("...bi,bij->...bj", points[..., None, :] - center, rotation)
    return np.linalg.norm(np.maximum(np.abs(local) - half, 0), axis=-1)


class Twin:
    """Reference of `world.check` in numpy: all spheres, all boxes, no grid."""

    def __init__(self, world: CollisionWorld, chain: Chain, spheres: Spheres) -> None:
        self.world, self.chain, self.spheres = world, chain, spheres
        self.group = np.repeat(np.arange(len(spheres.segment)), np.diff(spheres.start))
        self.hulls = HullPairs(spheres)

    def codes(
        self, q: np.ndarray, bases: np.ndarray, value: np.ndarray, holding: np.ndarray
    ) -> Int[np.ndarray, " m"]:
        w, s = self.world, self.spheres
        Ts = segment_poses(self.chain, q, bases)
        of_sphere = s.segment[self.group]
        Ts_sphere = Ts[:, of_sphere]
        points = np.einsum("msij,sj->msi", Ts_sphere[..., :3, :3], s.center)
        points += Ts_sphere[..., :3, 3]
        out = np.full(len(q), FREE)
        for i, p in enumerate(points):
            if (p[:, 2] < s.radius).any():
                out[i] = FLOOR
                continue
            v = value[i]
            near = gaps(p, w.moving.center[v], w.moving.rotation[v], w.moving.half[v])
            near = near < s.radius[:, None] + w.clearance
            if holding[i]:
                role = s.gripper[self.group][:, None]
                near &= ~((role == FINGER) | ((role == PALM) & w.grasped))
            static = gaps(p, w.static.center, w.static.rotation, w.static.half)
            static = static < s.radius[:, None] + w.clearance
            if near.any():
                # In order of links, then of boxes.
                links = [near[self.group == g].any(0) for g in range(len(s.segment))]
                first = next(hit for hit in links if hit.any())
                out[i] = len(w.static) + int(first.argmax())
            elif static.any():
                out[i] = int(static[static.any(1)][0].argmax())
            elif self.touches_itself(p, Ts[i]):
                out[i] = SELF
        return out

    def touches_itself(
        self, p: Float[np.ndarray, "s 3"], Ts: Float[np.ndarray, "segments 4 4"]
    ) -> bool:
        """Return whether spheres meet (if not too coarse for the pair) or hulls overlap."""
        s = self.spheres
        near = np.linalg.norm(p[:, None] - p[None], axis=-1) < s.radius[:, None] + s.radius
        for (a, b), exact in zip(s.pairs, s.exact, strict=True):
            if not exact and near[np.ix_(self.group == a, self.group == b)].any():
                return True
        back = invert(Ts[0])
        in_base = p @ back[:3, :3].T + back[:3, 3]
        hit = gaps(in_base, s.base.center, s.base.rotation, s.base.half) < s.radius[:, None]
        return bool((hit & (s.base_pairs & ~s.base_exact)[self.group]).any()) or self.hulls.meet(Ts)


def situations(
    robot: Robot, count: int, rng: np.random.Generator, spread: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Bool[np.ndarray, " m"]]:
    bases = rng.uniform((-spread, -spread, -np.pi), (spread, spread, np.pi), (count, 3))
    q = random_states(robot.chain, count, rng)
    return q, bases, rng.integers(0, 3, count), rng.random(count) < 0.5


@pytest.mark.parametrize(
    ("static", "moving", "clearance", "spread"),
    [(12, 3, 0.0, 1.5), (12, 3, 0.03, 3.0), (0, 3, 0.01, 1.0), (8, 0, 0.01, 2.0), (0, 0, 0.0, 1.0)],
)
def test_kernels_agree_with_brute_force(
    robot: Robot, static: int, moving: int, clearance: float, spread: float
) -> None:
    """States are inside, across and far outside the grid; static or moving boxes may be missing."""
    rng = np.random.default_rng(static + 10 * moving)
    world = world_of(robot, rng, static=static, moving=moving, clearance=clearance)
    case = situations(robot, 150, rng, spread)
    expected = Twin(world, robot.chain, robot.spheres).codes(*case)
    got = check(world, robot.chain, robot.spheres, *case)
    np.testing.assert_array_equal(got, expected)
    assert len(np.unique(expected)) > (3 if static + moving else 1)


def test_spheres_in_the_last_cells_of_the_grid_are_checked(segway: Robot) -> None:
    """Bases are around one box, at the distance where the arm just touches it or not."""
    rng = np.random.default_rng(1)
    one = Boxes(np.array([[0.0, 0.0, 1.2]]), rotations(1, rng), np.array([[0.1, 0.2, 0.3]]))
    world = build_world(
        one, moved_by_joint(NONE, 3, rng), np.zeros(0, bool), ["box"], segway.spheres,
        clearance=0.02,
    )  # fmt: skip
    angle, far = rng.uniform(-np.pi, np.pi, 1000), rng.uniform(0.2, 1.5, 1000)
    q, bases, value, holding = situations(segway, 1000, rng, 1.0)
    bases[:, 0], bases[:, 1] = far * np.cos(angle), far * np.sin(angle)
    case = (q, bases, value, holding)
    expected = Twin(world, segway.chain, segway.spheres).codes(*case)
    assert 0.02 < (expected == 0).mean() < 0.9
    np.testing.assert_array_equal(check(world, segway.chain, segway.spheres, *case), expected)


def test_a_larger_or_shifted_grid_changes_no_result(fetch: Robot) -> None:
    """Boxes far away enlarge and shift the grid."""
    rng = np.random.default_rng(2)
    boxes = random_boxes(6, rng, (-1.0, -1.0, 0.2), (1.0, 1.0, 1.5))
    far = Boxes(np.array([[9.3, -7.77, 4.1 * CELL]]), np.eye(3)[None], np.full((1, 3), 0.05))
    both = Boxes(
        *(
            np.concatenate([getattr(boxes, k), getattr(far, k)])
            for k in ("center", "rotation", "half")
        )
    )
    case = situations(fetch, 500, rng, 1.0)
    codes = [
        check(
            build_world(
                some, moved_by_joint(NONE, 3, rng), np.zeros(0, bool), ["box"] * len(some),
                fetch.spheres, clearance=0.01,
            ),
            fetch.chain, fetch.spheres, *case,
        )
        for some in (boxes, both)
    ]  # fmt: skip
    np.testing.assert_array_equal(codes[0], codes[1])


def test_both_kernels_agree(robot: Robot) -> None:
    """`check_states` takes one base pose, `check` many."""
    rng = np.random.default_rng(3)
    world = world_of(robot, rng, static=8, moving=0, clearance=0.01)
    q, _, value, holding = situations(robot, 400, rng, 1.0)
    base = np.array([0.2, -0.1, 0.7])
    many = check(world, robot.chain, robot.spheres, q, np.tile(base, (400, 1)), value, holding)
    boxes = (world.static.center, world.static.rotation, world.static.half, np.zeros(8, bool))
    one = check_states(q, base, chain_arrays(robot.chain), robot.spheres.arrays, boxes, False, 0.01)
    np.testing.assert_array_equal(np.minimum(one, 0), np.minimum(many, 0))


def test_a_carried_object_is_checked_like_the_hand(segway: Robot) -> None:
    """A robot with an object hits what the robot hits alone, and what the object hits."""
    rng = np.random.default_rng(4)
    box = Boxes(np.array([[0.0, 0.0, 0.12]]), np.eye(3)[None], np.array([[0.05, 0.1, 0.15]]))
    center, radius = box_spheres(box)
    in_segment = segway.chain.tool_offset + center @ segway.chain.tool_rotation.T
    with_payload = carry(segway.spheres, segway.chain.size, in_segment, radius)
    world = build_world(
        random_boxes(8, rng, (-1.0, -1.0, 0.2), (1.0, 1.0, 1.8)), moved_by_joint(NONE, 3, rng),
        np.zeros(0, bool), [""] * 8, with_payload, clearance=0.0,
    )  # fmt: skip
    case = situations(segway, 500, rng, 0.5)
    with_it = check(world, segway.chain, with_payload, *case)
    np.testing.assert_array_equal(with_it, Twin(world, segway.chain, with_payload).codes(*case))
    alone = check(world, segway.chain, segway.spheres, *case)
    assert (with_it[alone != FREE] != FREE).all()
    Ts = pose_planar(case[1]) @ segway.chain.tool_poses(case[0])
    boxes = world.static.center, world.static.rotation, world.static.half
    inside = gaps(Ts[:, :3, 3] + Ts[:, :3, 2] * 0.12, *boxes).min(1) == 0
    assert inside.any()
    assert (with_it[inside] != FREE).all()


class Exact:
    """Links and boxes in coal."""

    def __init__(self) -> None:
        self.coal = coal

    def body(self, shape: Geometry) -> object:
        c = self.coal
        if shape.kind == "box":
            return c.Box(*map(float, shape.size))
        if shape.kind == "cylinder":
            return c.Cylinder(float(shape.size[0]), float(shape.size[1]))
        return c.Sphere(float(shape.size[0]))

    def box(self, half: np.ndarray) -> object:
        return self.coal.Box(*map(float, 2 * half))

    def place(self, T: Float[np.ndarray, "4 4"]) -> object:
        return self.coal.Transform3s(np.ascontiguousarray(T[:3, :3]), T[:3, 3])

    def distance(self, a: object, T_a: object, b: object, T_b: object) -> float:
        """Return the signed distance, negative for overlap [m]."""
        result = self.coal.DistanceResult()
        self.coal.distance(a, T_a, b, T_b, self.coal.DistanceRequest(), result)
        return result.min_distance


def exact_gaps(robot: Robot, boxes: Boxes, q: np.ndarray, bases: np.ndarray) -> np.ndarray:
    """Return the signed distance between moving links and boxes for each configuration."""
    exact, chain = Exact(), robot.chain
    Ts = segment_poses(chain, q, bases)
    placed = [
        (exact.box(h), exact.place(pose(c, R)), c, float(np.linalg.norm(h)))
        for c, R, h in zip(boxes.center, boxes.rotation, boxes.half, strict=True)
    ]
    bodies = [
        (exact.body(shape), robot.segments.of_link[link],
         robot.segments.T_segment_link[link] @ shape.T_link_geometry,
         float(np.linalg.norm(shape.size)))
        for link in robot.spheres.links
        for shape in robot.model.urdf.links[link].collisions
    ]  # fmt: skip
    out = np.full(len(q), np.inf)
    for i in range(len(q)):
        for body, segment, T_local, size in bodies:
            T = Ts[i, segment] @ T_local
            at = exact.place(T)
            for box, box_at, c, reach in placed:
                if np.linalg.norm(T[:3, 3] - c) - size - reach < min(out[i], 0.1):
                    out[i] = min(out[i], exact.distance(body, at, box, box_at))
    return out


def test_spheres_agree_with_exact_shapes_up_to_their_margins(robot: Robot) -> None:
    """Compare with coal on the exact shapes.

    What is called free is at most `MARGIN` deep in a box; what is called blocked is no farther
    from one than spheres stick out of a torso. Overlap as coal counts it, the shortest way out,
    can be a little more than how deep any point is inside.
    """
    rng = np.random.default_rng(5)
    world = world_of(robot, rng, static=8, moving=0, clearance=0.0)
    q, bases, value, holding = situations(robot, 250, rng, 1.2)
    codes = check(world, robot.chain, robot.spheres, q, bases, value, holding)
    distance = exact_gaps(robot, world.static, q, bases)
    clear = (codes == FREE) | (codes == SELF)
    assert 0.1 < clear.mean() < 0.95
    assert distance[clear].min() > -(MARGIN + 2e-3)
    assert distance[codes >= 0].max() < BODY + 1e-3


def test_self_collision_agrees_with_coal(robot: Robot) -> None:
    exact, rng, s = Exact(), np.random.default_rng(6), robot.spheres
    q = random_states(robot.chain, 80, rng)
    still = (np.zeros((80, 3)), np.zeros(80, int), np.zeros(80, bool))
    world = world_of(robot, rng, static=0, moving=0, clearance=0.0)
    codes = check(world, robot.chain, s, q, *still)
    Ts = segment_poses(robot.chain, q, still[0])
    parts = {
        link: [(exact.body(shape), robot.segments.T_segment_link[link] @ shape.T_link_geometry)
               for shape in robot.model.urdf.links[link].collisions]
        for link in s.links
    }  # fmt: skip
    blocks = [
        (exact.box(h), exact.place(pose(c, R)))
        for c, R, h in zip(s.base.center, s.base.rotation, s.base.half, strict=True)
    ]
    distance = np.full(len(q), np.inf)
    for i in range(len(q)):
        placed = {
            link: [(body, exact.place(Ts[i, robot.segments.of_link[link]] @ T)) for body, T in some]
            for link, some in parts.items()
        }
        pairs = [
            (a, b) for k, m in s.pairs for a in placed[s.links[k]] for b in placed[s.links[m]]
        ] + [
            (a, blocks[b]) for g, b in np.argwhere(s.base_pairs) for a in placed[s.links[g]]
        ]  # fmt: skip
        distance[i] = min(exact.distance(*a, *b) for a, b in pairs)
    upright = codes != FLOOR
    assert distance[upright & (codes == FREE)].min() > -(2 * MARGIN + 2e-3)
    assert distance[codes == SELF].max() < 2 * BODY


def test_codes_have_descriptions(fetch: Robot) -> None:
    world = world_of(fetch, np.random.default_rng(7), static=2, moving=1, clearance=0.0)
    words = [world.reason(code) for code in (FREE, SELF, FLOOR, 0, 2)]
    assert words == ["free", "the robot itself", "the floor", "box 0", "box 2"]
