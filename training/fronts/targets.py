"""Training targets and losses of the networks."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from momapos.perception.reconstruction.decode import KINDS


def bumps(
    boxes: Float[np.ndarray, "n 4"], side: int, spread: float
) -> Float[np.ndarray, "n side side"]:
    """Return a bell for each box that is 1 at the cell nearest to its center."""
    cells = np.arange(side)
    center = (boxes[:, :2] + boxes[:, 2:]) / 2 * side - 0.5
    nearest = np.clip(np.round(center), 0, side - 1)
    width = np.maximum((boxes[:, 2:] - boxes[:, :2]) * side * spread, 0.7)
    x = np.exp(-0.5 * ((cells - nearest[:, :1]) / width[:, :1]) ** 2)
    y = np.exp(-0.5 * ((cells - nearest[:, 1:]) / width[:, 1:]) ** 2)
    return (y[:, :, None] * x[:, None, :]).astype(np.float32)


def distances(boxes: Float[np.ndarray, "n 4"], side: int) -> Float[np.ndarray, "n 4 side side"]:
    """Return the distance of each cell to the left, top, right and bottom edge of each box."""
    at = (np.arange(side) + 0.5) / side
    out = np.empty((len(boxes), 4, side, side), np.float32)
    out[:, 0] = at[None, None, :] - boxes[:, 0, None, None]
    out[:, 1] = at[None, :, None] - boxes[:, 1, None, None]
    out[:, 2] = boxes[:, 2, None, None] - at[None, None, :]
    out[:, 3] = boxes[:, 3, None, None] - at[None, :, None]
    return out


def face_targets(
    boxes: Float[np.ndarray, "p 4"], kinds: Int[np.ndarray, " p"], side: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return heat by kind, distances to the edges, and the weight of these distances."""
    heat = np.zeros((len(KINDS), side, side), np.float32)
    reach = np.full((4, side, side), 0.1, np.float32)
    weight = np.zeros((side, side), np.float32)
    real = kinds >= 0
    if not real.any():
        return heat, reach, weight
    boxes, kinds = boxes[real], kinds[real]
    bells = bumps(boxes, side, 0.13)
    for kind in np.unique(kinds):
        heat[kind] = bells[kinds == kind].max(axis=0)
    owner = bells.argmax(axis=0)
    best = bells.max(axis=0)
    away = distances(boxes, side)
    reach = np.take_along_axis(away, owner[None, None], axis=0)[0]
    weight = np.where((best > 0.4) & (reach.min(axis=0) > 0.002), best, 0)
    return heat, np.maximum(reach, 0.002), weight.astype(np.float32)


def heat_loss(logits: Tensor, heat: Tensor, count: Tensor) -> Tensor:
    """Return the focal loss of center maps, reduced near centers (CornerNet, section 3.2)."""
    positive = heat > 0.999
    sure = torch.sigmoid(logits)
    hit = F.logsigmoid(logits) * (1 - sure) ** 2
    miss = F.logsigmoid(-logits) * sure**2 * (1 - heat) ** 4
    return -torch.where(positive, hit, miss).sum() / count.clamp(min=1)


def reach_loss(logs: Tensor, reach: Tensor, weight: Tensor) -> Tensor:
    """Return 1 - IoU plus the error of the logarithms."""
    predicted = logs.clamp(-7, 1).exp()
    low, high = torch.minimum(predicted, reach), torch.maximum(predicted, reach)
    common = (low[:, 0] + low[:, 2]) * (low[:, 1] + low[:, 3])
    union = (
        (predicted[:, 0] + predicted[:, 2]) * (predicted[:, 1] + predicted[:, 3])
        + (reach[:, 0] + reach[:, 2]) * (reach[:, 1] + reach[:, 3])
        - common
    )
    area = 1 - common / union.clamp(min=1e-6)
    ratio = (high / low.clamp(min=1e-4)).log().mean(dim=1).clamp(max=3)
    total = weight.sum().clamp(min=1)
    return ((area + 0.3 * ratio) * weight).sum() / total


def edge_loss(logits: Tensor, edges: Tensor, real: Tensor) -> Tensor:
    """Return the cross entropy with a narrow bell around each edge."""
    side = logits.shape[-1]
    at = (torch.arange(side) + 0.5) / side
    bell = torch.exp(-0.5 * ((at - edges[..., None]) * side / 0.6) ** 2) + 1e-8
    bell = bell / bell.sum(dim=-1, keepdim=True)
    error = -(bell * F.log_softmax(logits, dim=-1)).sum(dim=-1).mean(dim=1)
    return (error * real).sum() / real.sum().clamp(min=1)
