"""The two networks: one for a whole face, one for a crop of one part."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn

from momapos.perception.reconstruction.decode import KINDS

PLANES = 7


def conv(inner: int, outer: int, stride: int = 1, size: int = 3) -> nn.Sequential:
    """Return a convolution with normalization and ReLU."""
    return nn.Sequential(
        nn.Conv2d(inner, outer, size, stride, size // 2, bias=False),
        nn.BatchNorm2d(outer),
        nn.ReLU(inplace=True),
    )


class Block(nn.Module):
    """A residual block of two convolutions."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = conv(width, width)
        self.second = nn.Sequential(
            nn.Conv2d(width, width, 3, 1, 1, bias=False), nn.BatchNorm2d(width)
        )

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(self.first(x)))


class Pyramid(nn.Module):
    """Features at 1/4 resolution with context of the whole image, and the top level."""

    def __init__(self, widths: tuple[int, ...], out: int) -> None:
        super().__init__()
        self.stem = conv(PLANES, widths[0], 2)
        self.down = nn.ModuleList(
            nn.Sequential(conv(a, b, 2), Block(b)) for a, b in itertools.pairwise(widths)
        )
        self.across = nn.ModuleList(nn.Conv2d(w, out, 1) for w in widths[1:])
        self.smooth = nn.ModuleList(conv(out, out) for _ in widths[2:])

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        x = self.stem(x)
        levels = []
        for down in self.down:
            x = down(x)
            levels.append(x)
        y = self.across[-1](levels[-1])
        for i in range(len(levels) - 2, -1, -1):
            y = nn.functional.interpolate(y, scale_factor=2.0, mode="nearest")
            y = self.smooth[i](y + self.across[i](levels[i]))
        return y, x


class FaceNetwork(nn.Module):
    """Predict centers of parts, distances to their edges, and whether the face is a front."""

    def __init__(self) -> None:
        super().__init__()
        self.pyramid = Pyramid((16, 32, 64, 112, 144), 48)
        self.head = conv(48, 48)
        self.heat = nn.Conv2d(48, len(KINDS), 1)
        self.reach = nn.Conv2d(48, 4, 1)
        self.front = nn.Sequential(nn.Linear(144, 64), nn.ReLU(), nn.Linear(64, 1))
        nn.init.constant_(self.heat.bias, -4.0)
        nn.init.constant_(self.reach.bias, -1.5)

    def forward(self, face: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return logits of the heat, logarithms of edge distances, and the logit of the front."""
        y, top = self.pyramid(face)
        y = self.head(y)
        pooled = top.mean(dim=(2, 3))
        return self.heat(y), self.reach(y), self.front(pooled)[:, 0]


class PartNetwork(nn.Module):
    """Predict the kind, edges and handle of the part in a crop."""

    def __init__(self) -> None:
        super().__init__()
        self.pyramid = Pyramid((16, 32, 64, 96, 128), 40)
        self.squeeze = conv(128, 48, size=1)
        self.kind = nn.Sequential(
            nn.Linear(48 * 16 + 1, 128), nn.ReLU(), nn.Linear(128, len(KINDS) + 2)
        )
        self.head = conv(40, 40)
        self.handle = nn.Conv2d(40, 5, 1)
        self.columns = nn.Sequential(
            nn.Conv1d(80, 48, 5, padding=2), nn.ReLU(), nn.Conv1d(48, 2, 5, padding=2)
        )
        self.rows = nn.Sequential(
            nn.Conv1d(80, 48, 5, padding=2), nn.ReLU(), nn.Conv1d(48, 2, 5, padding=2)
        )
        nn.init.constant_(self.handle.bias, -2.0)

    def forward(self, crop: Tensor, aspect: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Process crops.

        Returns:
            Logits of the kinds, of no part, and of a handle; logits of each edge's position along
            its axis (n, 4, m); logits of the handle's center (n, m, m); logarithms of the
            distances to the handle's edges (n, 4, m, m).
        """
        y, top = self.pyramid(crop)
        pooled = torch.cat((self.squeeze(top).flatten(1), aspect), dim=1)
        logits = self.kind(pooled)
        y = self.head(y)
        x = torch.cat((y.mean(dim=2), y.amax(dim=2)), dim=1)
        z = torch.cat((y.mean(dim=3), y.amax(dim=3)), dim=1)
        left_right, top_bottom = self.columns(x), self.rows(z)
        edges = torch.stack(
            (left_right[:, 0], top_bottom[:, 0], left_right[:, 1], top_bottom[:, 1]), dim=1
        )
        handle = self.handle(y)
        return logits, edges, handle[:, 0], handle[:, 1:]
