"""The motion of a base, and its estimate of it."""

from __future__ import annotations

import numpy as np

from momapos.core.geometry.transforms import wrap_angle
from momapos.planning.navigation.driving import Localizer, NoiseConfig, integrate


def test_integration_equals_many_small_steps() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        pose, velocity = rng.uniform(-3, 3, 3), rng.uniform(-1, 1, 3)
        x, y, yaw = pose
        dt = 1e-4
        for _ in range(10_000):
            c, s = np.cos(yaw + velocity[2] * dt / 2), np.sin(yaw + velocity[2] * dt / 2)
            x += dt * (c * velocity[0] - s * velocity[1])
            y += dt * (s * velocity[0] + c * velocity[1])
            yaw += dt * velocity[2]
        end = integrate(pose, velocity, 1.0)
        np.testing.assert_allclose(end[:2], [x, y], atol=1e-6)
        assert abs(wrap_angle(end[2] - yaw)) < 1e-9


def test_fixes_fused_with_odometry_are_better_than_fixes_alone() -> None:
    noise, velocity, dt = NoiseConfig(), np.array([0.5, 0.0, 0.3]), 0.06
    errors = {}
    for fused in (True, False):
        rng = np.random.default_rng(0)
        pose = np.zeros(3)
        localizer = Localizer(pose, NoiseConfig(fused=fused), rng)
        squared = []
        for _ in range(1000):
            pose = integrate(pose, velocity, dt)
            localizer.step(pose, velocity, dt)
            error = localizer.pose - pose
            squared.append([error[0], error[1], float(wrap_angle(error[2]))])
        errors[fused] = np.sqrt((np.array(squared[50:]) ** 2).mean(0))
    np.testing.assert_allclose(
        errors[False], [noise.position, noise.position, noise.heading], rtol=0.1
    )
    assert (errors[True] < 0.5 * errors[False]).all()
