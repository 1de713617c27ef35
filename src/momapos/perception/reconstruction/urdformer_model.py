"""URDFormer's network in plain torch, for the weights that its authors published.

The layers have the names of the authors' network (Chen et al., 2024), so that their `part.pth`
fits; the code is our own. It reproduces three peculiarities, because the weights were trained with
them:

- Regions of interest are scaled twice. A box is already in cells of the 14 x 14 map when the
  pooling divides it by 16 again, so only the first three rows and columns of the map are used.
- Boxes are (top, left, ...) where the pooling expects (left, top, ...), so the map is pooled with
  its axes exchanged.
- Empty slots are not masked: attention sees the padding up to 32 boxes.

Importing this module needs torch.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from torch.nn import functional

from .urdformer_format import BASES, IMAGE, PARTS, STEPS

if TYPE_CHECKING:
    from jaxtyping import Float

PATCH = 16
"""Edge length of a patch [px]; the map has IMAGE / PATCH cells along an edge."""
CELLS = IMAGE // PATCH
WIDTH_MAP, WIDTH = 384, 512
"""Channels of the image's map and of the tokens."""
DEPTH = 12
RELATIONS = 6
RELATION_WIDTH = 32


def _mlp(*widths: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.LeakyReLU(), nn.Linear(before, after)]
    return nn.Sequential(*layers[1:])


def _by_names(**parts: nn.Module) -> nn.ModuleDict:
    return nn.ModuleDict(parts)


class ImageBlock(nn.Module):
    """One transformer block of the image's encoder."""

    def __init__(self, heads: int = 12) -> None:
        super().__init__()
        self.heads = heads
        self.norm1 = nn.LayerNorm(WIDTH_MAP, eps=1e-6)
        self.attn = _by_names(
            qkv=nn.Linear(WIDTH_MAP, 3 * WIDTH_MAP), proj=nn.Linear(WIDTH_MAP, WIDTH_MAP)
        )
        self.norm2 = nn.LayerNorm(WIDTH_MAP, eps=1e-6)
        self.mlp = _by_names(
            fc1=nn.Linear(WIDTH_MAP, 4 * WIDTH_MAP), fc2=nn.Linear(4 * WIDTH_MAP, WIDTH_MAP)
        )

    def forward(self, x: Float[Tensor, "n tokens width"]) -> Float[Tensor, "n tokens width"]:
        n, tokens, width = x.shape
        qkv = self.attn["qkv"](self.norm1(x)).view(n, tokens, 3, self.heads, width // self.heads)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)
        mixed = functional.scaled_dot_product_attention(q, k, v).transpose(1, 2)
        x = x + self.attn["proj"](mixed.reshape(n, tokens, width))
        return x + self.mlp["fc2"](functional.gelu(self.mlp["fc1"](self.norm2(x))))


class ImageEncoder(nn.Module):
    """ViT-S/16: encodes an image as a map of 14 x 14 cells."""

    def __init__(self) -> None:
        super().__init__()
        self.cls_token = nn.Parameter(torch.zeros(1, 1, WIDTH_MAP))
        self.pos_embed = nn.Parameter(torch.zeros(1, CELLS**2 + 1, WIDTH_MAP))
        self.patch_embed = _by_names(proj=nn.Conv2d(3, WIDTH_MAP, PATCH, PATCH))
        self.blocks = nn.ModuleList(ImageBlock() for _ in range(DEPTH))
        self.norm = nn.LayerNorm(WIDTH_MAP, eps=1e-6)

    def forward(self, images: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n width rows columns"]:
        patches = self.patch_embed["proj"](images).flatten(2).transpose(1, 2)
        x = torch.cat((self.cls_token.expand(len(patches), -1, -1), patches), dim=1)
        x = x + self.pos_embed
        for block in self.blocks:
            x = block(x)
        cells = self.norm(x[:, 1:])
        return cells.transpose(1, 2).reshape(-1, WIDTH_MAP, CELLS, CELLS)


class PartBlock(nn.Module):
    """One transformer block over the parts; queries, keys and values are projected twice."""

    def __init__(self, heads: int = 8) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(WIDTH)
        self.qkv = nn.Linear(WIDTH, 3 * WIDTH)
        self.attn = nn.MultiheadAttention(WIDTH, heads, batch_first=True)
        self.norm2 = nn.LayerNorm(WIDTH)
        self.mlp = _by_names(lin1=nn.Linear(WIDTH, 4 * WIDTH), lin2=nn.Linear(4 * WIDTH, WIDTH))

    def forward(self, x: Float[Tensor, "n slots width"]) -> Float[Tensor, "n slots width"]:
        q, k, v = self.qkv(self.norm1(x)).chunk(3, dim=-1)
        x = x + self.attn(q, k, v, need_weights=False)[0]
        return x + self.mlp["lin2"](functional.gelu(self.mlp["lin1"](self.norm2(x))))


class Urdformer(nn.Module):
    """The network for the parts of one object; its state has 393 tensors."""

    def __init__(self) -> None:
        super().__init__()
        self.img_backbone = ImageEncoder()
        # In the checkpoint, but without influence on the output.
        self.pe_layer = _by_names(**{f"fc{axis}": nn.Linear(16, WIDTH) for axis in "xywh"})
        self.fc1 = _mlp(WIDTH_MAP, 512, 256, 64)
        self.fc2 = nn.Linear(CELLS**2 * 64, WIDTH)
        self.img_fc1 = _mlp(WIDTH_MAP, 512, 64)
        self.img_fc2 = _mlp((CELLS // 2) ** 2 * 64, 512, 512)
        self.bbox_fc = _mlp(4, 128, 256, WIDTH)
        for axis in "xyz":
            self.add_module(f"position_head_{axis}", _mlp(WIDTH, 512, STEPS))
            self.add_module(f"position_end_{axis}", _mlp(WIDTH, 512, STEPS))
        self.parent = _mlp(WIDTH, 512, RELATION_WIDTH * RELATIONS)
        self.child = _mlp(WIDTH, 512, RELATION_WIDTH * RELATIONS)
        self.embedding = nn.Embedding(1, WIDTH)
        self.mesh_head = _mlp(WIDTH, 512, len(PARTS))
        self.base_mesh_head = _mlp(512, 512, len(BASES))
        self.norm_layer = nn.LayerNorm(WIDTH)
        self.norm_layer1 = nn.LayerNorm(WIDTH)
        self.blocks = nn.ModuleList(PartBlock() for _ in range(DEPTH))

    def forward(
        self, image: Float[Tensor, "3 h w"], boxes_yxhw: Float[Tensor, "slots 4"]
    ) -> tuple[Tensor, ...]:
        """Predict classes, parents and places of the boxed parts; returns the fields of `Logits`.

        Args:
            image: Square image of 224 pixels, normalized as for ImageNet.
            boxes_yxhw: Top, left, height, width as fractions of the image; unused slots zero.
        """
        cells = self.img_backbone(image[None])[0]
        regions = roi_align(cells, regions_of(boxes_yxhw), CELLS, 1.0 / PATCH, samples=2)
        tokens = self.fc2(self.fc1(regions.permute(0, 2, 3, 1)).flatten(1))
        x = (self.norm_layer(tokens) + self.norm_layer(self.bbox_fc(boxes_yxhw)))[None]
        for block in self.blocks:
            x = block(x)
        x = self.norm_layer(x)[0]
        start, end = (
            torch.stack([self.get_submodule(f"position_{which}_{a}")(x) for a in "xyz"], 1)
            for which in ("head", "end")
        )
        return start, end, self.mesh_head(x), self._parents(x), self._base(cells)

    def _parents(self, x: Float[Tensor, "slots width"]) -> Float[Tensor, "slots parents relations"]:
        """Score every slot as the child of the base and of every other slot.

        The layer that the checkpoint calls `parent` embeds the child, and `child` the parent.
        """
        nodes = self.norm_layer1(torch.cat((self.embedding.weight, x)))
        child = self.parent(nodes).view(len(nodes), RELATIONS, -1)
        parent = self.child(nodes).view(len(nodes), RELATIONS, -1)
        return torch.einsum("crw,prw->cpr", child, parent)[1:] / RELATION_WIDTH**0.5

    def _base(self, cells: Float[Tensor, "width rows columns"]) -> Float[Tensor, " bases"]:
        halved = functional.max_pool2d(cells, 2)
        return self.base_mesh_head(self.img_fc2(self.img_fc1(halved.permute(1, 2, 0)).flatten()))


def regions_of(boxes_yxhw: Float[Tensor, "n 4"]) -> Float[Tensor, "n 4"]:
    """Convert part boxes to the corners that the pooling gets.

    Whole pixels, then whole cells of the map, in the order (top, left, bottom, right). The pooling
    reads them as pixels in the order (left, top, right, bottom): see the module's docstring.
    """
    start, size = (boxes_yxhw * IMAGE).int().split(2, dim=-1)
    return torch.floor(torch.cat((start, start + size), dim=-1) / PATCH)


def roi_align(
    cells: Float[Tensor, "width rows columns"],
    boxes: Float[Tensor, "n 4"],
    bins: int,
    scale: float,
    samples: int,
) -> Float[Tensor, "n width bins bins"]:
    """Pool regions of a map by bilinear samples, like RoIAlign of Mask R-CNN without alignment.

    A region is at least one cell wide and high, and its corner is not shifted by half a cell.
    Samples lie on a grid within axis-parallel bins, so interpolation is a product of one matrix
    for the rows and one for the columns.
    Args:
        cells: The map.
        boxes: (left, top, right, bottom) of each region; times `scale` they are in cells.
        bins: Bins along each edge of a region.
        scale: Cells per unit of the boxes.
        samples: Samples along each edge of a bin; a bin is their mean.
    """
    left, top, right, bottom = (boxes * scale).unbind(-1)
    rows = _sampling(top, bottom, bins, samples, cells.shape[1])
    columns = _sampling(left, right, bins, samples, cells.shape[2])
    return torch.einsum("npr,wrc,nqc->nwpq", rows, cells, columns)


def _sampling(
    start: Float[Tensor, " n"], end: Float[Tensor, " n"], bins: int, samples: int, cells: int
) -> Float[Tensor, "n bins cells"]:
    """Return the weight of every cell along one axis in every bin."""
    steps = (torch.arange(bins * samples, device=start.device) + 0.5) / (bins * samples)
    at = start[:, None] + (end - start).clamp(min=1.0)[:, None] * steps
    inside = (at >= -1.0) & (at <= cells)
    at = at.clamp(0.0, cells - 1.0)
    marks = torch.arange(cells, device=start.device)
    weights = (1.0 - (at[..., None] - marks).abs()).clamp(min=0.0) * inside[..., None]
    return weights.view(len(start), bins, samples, cells).mean(dim=2)
