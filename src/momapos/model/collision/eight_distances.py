"""Distances of eight points at once from points, boxes and cylinders, in single precision."""

from __future__ import annotations

from momapos.core.compiled import kernel, larger, less, magnitude, root, spread


@kernel
def within(a, b, distance):
    """Return in which lanes two points are nearer than a distance."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return less(x * x + y * y + z * z, spread(distance * distance))


@kernel
def near_box(c, r, center, rotation, half, b):
    """Return in which lanes a sphere overlaps box b, see `box_gap`."""
    x = c[0] - spread(center[b, 0])
    y = c[1] - spread(center[b, 1])
    z = c[2] - spread(center[b, 2])
    zero = spread(0.0)
    square = zero
    for k in range(3):
        local = (
            x * spread(rotation[b, 0, k])
            + y * spread(rotation[b, 1, k])
            + z * spread(rotation[b, 2, k])
        )
        excess = larger(magnitude(local) - spread(half[b, k]), zero)
        square = square + excess * excess
    return less(square, spread(r * r))


@kernel
def _near_cylinder(c, r, center, rotation, half, b):
    """Return in which lanes a sphere overlaps the cylinder in box b, see `cylinder_gap`."""
    x = c[0] - spread(center[b, 0])
    y = c[1] - spread(center[b, 1])
    z = c[2] - spread(center[b, 2])
    zero = spread(0.0)
    along = (
        x * spread(rotation[b, 0, 2])
        + y * spread(rotation[b, 1, 2])
        + z * spread(rotation[b, 2, 2])
    )
    across = root(larger(x * x + y * y + z * z - along * along, zero))
    side = larger(across - spread(half[b, 0]), zero)
    end = larger(magnitude(along) - spread(half[b, 2]), zero)
    return less(side * side + end * end, spread(r * r))


@kernel
def near_shape(c, r, shapes, b, cylinder):
    """Return in which lanes a sphere overlaps box b, or the cylinder in it."""
    center, rotation, half = shapes
    if cylinder:
        return _near_cylinder(c, r, center, rotation, half, b)
    return near_box(c, r, center, rotation, half, b)
