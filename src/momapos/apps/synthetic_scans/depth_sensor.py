"""Add the errors of a depth camera to perfect images: noise, holes, blur, drifting poses.

The model is an active stereo camera such as the RealSense D435. Its depth comes from the disparity
of two images: the error grows with the square of the distance, and surfaces hidden from the second
camera have no depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from momapos.model.records import Frame

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, UInt8


@dataclass(frozen=True)
class DepthSensor:
    """Errors of a depth camera, as standard deviations unless stated otherwise."""

    baseline: float = 0.05
    """Distance between the two cameras [m]; the second is on the right."""
    subpixel: float = 0.08
    """Disparity error [px of an image 640 wide]."""
    steps: int = 32
    """Disparity steps per pixel [-]."""
    correlation: float = 1.2
    """Blur that correlates the noise of neighboring pixels [px]; 0 for none."""
    near: float = 0.3
    far: float = 6.0
    """Range of measured depth [m]."""
    grazing: float = 75.0
    """Maximum angle between the ray and the surface normal with a depth [deg]."""
    color: float = 2.5
    """Noise of a color channel [of 255]."""
    blur: float = 0.45
    """Blur of colors [px]."""
    exposure: float = 0.06
    """Log brightness of an image [-]."""
    balance: float = 0.012
    """Log gain of each color channel [-]."""
    position: float = 0.003
    """Position error of the camera [m]."""
    angle: float = 0.1
    """Orientation error of the camera [deg]."""
    drift: float = 0.9
    """Correlation of the pose errors of consecutive images, in [0, 1) [-]."""


def sense(frame: Frame, rng: np.random.Generator, sensor: DepthSensor | None = None) -> Frame:
    """Add sensor errors to the color and depth of a frame.

    Args:
        frame: A perfect image, as from `render_frame`.
        rng: Source of the noise.
        sensor: Errors of the camera.

    Returns:
        The noisy frame with the same pose.
    """
    sensor = sensor or DepthSensor()
    color = _sense_color(frame.color, rng, sensor)
    if frame.depth is None:
        return replace(frame, color=color)
    return replace(frame, color=color, depth=_sense_depth(frame, frame.depth, rng, sensor))


def _sense_depth(
    frame: Frame, depth: Float32[np.ndarray, "h w"], rng: np.random.Generator, sensor: DepthSensor
) -> Float32[np.ndarray, "h w"]:
    seen = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=seen)
    scale = frame.intrinsics[0, 0] * sensor.baseline  # [px m]: disparity times depth
    disparity = scale * inverse
    seen &= ~_occluded(disparity) & (
        _incidence(inverse, frame) > np.cos(np.radians(sensor.grazing))
    )
    noise = rng.standard_normal(depth.shape)
    if sensor.correlation > 0:
        noise = gaussian_filter(noise, sensor.correlation)
        noise /= noise.std()
    pixels = depth.shape[1] / 640
    disparity += sensor.subpixel * pixels * noise
    disparity = np.round(disparity * sensor.steps / pixels) * pixels / sensor.steps
    measured = np.divide(scale, disparity, out=np.zeros_like(disparity), where=disparity > 0)
    seen &= (measured >= sensor.near) & (measured <= sensor.far)
    return np.where(seen, measured, 0.0).astype(np.float32)


def _occluded(disparity: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return the pixels hidden from the second camera, left of nearer surfaces."""
    column = np.arange(disparity.shape[1]) - disparity
    beyond = np.minimum.accumulate(column[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(disparity.shape, bool)
    hidden[:, :-1] = beyond[:, 1:] <= column[:, :-1]
    return hidden


def _incidence(inverse: Float[np.ndarray, "h w"], frame: Frame) -> Float[np.ndarray, "h w"]:
    """Return the cosine of the angle between ray and surface normal, exact on planes.

    On a plane, 1 / depth is linear in the image. Of the slopes to both sides, the smaller one is
    used: at an edge, it lies on the surface itself.
    """
    K = frame.intrinsics
    height, width = inverse.shape
    x = (np.arange(width) - K[0, 2]) / K[0, 0]
    y = ((np.arange(height) - K[1, 2]) / K[1, 1])[:, None]
    a, b = K[0, 0] * _slope(inverse, 1), K[1, 1] * _slope(inverse, 0)
    normal = np.sqrt(a**2 + b**2 + (inverse - a * x - b * y) ** 2)
    ray = np.sqrt(x**2 + y**2 + 1)
    return np.divide(inverse, normal * ray, out=np.zeros_like(inverse), where=normal > 0)


def _slope(values: Float[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "h w"]:
    step = np.diff(values, axis=axis)
    ends = ((1, 0), (0, 0)) if axis == 0 else ((0, 0), (1, 0))
    before = np.pad(step, ends, mode="edge")
    after = np.pad(step, tuple(end[::-1] for end in ends), mode="edge")
    return np.where(np.abs(before) < np.abs(after), before, after)


def _sense_color(
    color: UInt8[np.ndarray, "h w 3"], rng: np.random.Generator, sensor: DepthSensor
) -> UInt8[np.ndarray, "h w 3"]:
    gain = np.exp(rng.normal(0.0, sensor.exposure))
    balance = np.exp(rng.normal(0.0, sensor.balance, 3))
    image = color.astype(np.float32)
    if sensor.blur > 0:
        image = gaussian_filter(image, (sensor.blur, sensor.blur, 0))
    image = image * (gain * balance).astype(np.float32)
    image += sensor.color * rng.standard_normal(color.shape, np.float32)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def drifting(
    Ts_world_camera: Sequence[Float[np.ndarray, "4 4"]] | Float[np.ndarray, "n 4 4"],
    rng: np.random.Generator,
    sensor: DepthSensor | None = None,
) -> Float[np.ndarray, "n 4 4"]:
    """Return estimated camera poses, with errors that change slowly from image to image.

    Args:
        Ts_world_camera: True poses, in the order of the images.
        rng: Source of the errors.
        sensor: Size and correlation of the errors.
    """
    sensor = sensor or DepthSensor()
    true = np.asarray(Ts_world_camera, float)
    error = rng.standard_normal((len(true), 6))
    fresh = np.sqrt(1 - sensor.drift**2)
    for before, now in pairwise(error):
        now *= fresh
        now += sensor.drift * before
    found = true.copy()
    found[:, :3, 3] += sensor.position * error[:, :3]
    turn = Rotation.from_rotvec(np.radians(sensor.angle) * error[:, 3:]).as_matrix()
    found[:, :3, :3] = true[:, :3, :3] @ turn
    return found
