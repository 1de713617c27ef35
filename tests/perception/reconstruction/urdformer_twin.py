"""Reference implementation of URDFormer's network in numpy."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy.special import erf

Weights = Mapping[str, np.ndarray]


def answers(
    w: Weights, image: Float[np.ndarray, "3 224 224"], boxes: Float[np.ndarray, "n 4"]
) -> dict[str, np.ndarray]:
    """Run the network on one image, with boxes as (top, left, height, width)."""
    cells = encode(w, image)
    tokens = stack(w, "fc1", pool(cells, boxes), 3)
    x = norm(w, "norm_layer", linear(w, "fc2", tokens.reshape(len(boxes), -1)), 1e-5)
    x = x + norm(w, "norm_layer", stack(w, "bbox_fc", boxes, 3), 1e-5)
    for k in range(12):
        block = f"blocks.{k}"
        q, k_, v = np.split(
            linear(w, f"{block}.qkv", norm(w, f"{block}.norm1", x, 1e-5)), 3, axis=-1
        )
        turns = np.split(w[f"{block}.attn.in_proj_weight"], 3)
        shifts = np.split(w[f"{block}.attn.in_proj_bias"], 3)
        q, k_, v = (a @ t.T + b for a, t, b in zip((q, k_, v), turns, shifts, strict=True))
        x = x + linear(w, f"{block}.attn.out_proj", attend(q, k_, v, 8))
        hidden = linear(w, f"{block}.mlp.lin1", norm(w, f"{block}.norm2", x, 1e-5))
        x = x + linear(w, f"{block}.mlp.lin2", gelu(hidden))
    x = norm(w, "norm_layer", x, 1e-5)
    nodes = norm(w, "norm_layer1", np.vstack((w["embedding.weight"], x)), 1e-5)
    child = stack(w, "parent", nodes, 2).reshape(len(nodes), 6, 32)
    parent = stack(w, "child", nodes, 2).reshape(len(nodes), 6, 32)
    scores = [child[:, r] @ parent[:, r].T / np.sqrt(32) for r in range(6)]
    halved = cells.reshape(7, 2, 7, 2, -1).max(axis=(1, 3))
    seen = stack(w, "img_fc1", halved, 2).reshape(-1)
    return {
        "start": np.stack([stack(w, f"position_head_{a}", x, 2) for a in "xyz"], axis=1),
        "end": np.stack([stack(w, f"position_end_{a}", x, 2) for a in "xyz"], axis=1),
        "part": stack(w, "mesh_head", x, 2),
        "parent": np.stack(scores, axis=-1)[1:],
        "base": stack(w, "base_mesh_head", stack(w, "img_fc2", seen, 2), 2),
    }


def encode(w: Weights, image: Float[np.ndarray, "3 224 224"]) -> Float[np.ndarray, "14 14 384"]:
    """Encode the image in patches of 16 x 16."""
    patches = image.reshape(3, 14, 16, 14, 16).transpose(1, 3, 0, 2, 4).reshape(196, -1)
    kernel = w["img_backbone.patch_embed.proj.weight"].reshape(384, -1)
    tokens = patches @ kernel.T + w["img_backbone.patch_embed.proj.bias"]
    x = np.vstack((w["img_backbone.cls_token"][0], tokens)) + w["img_backbone.pos_embed"][0]
    for k in range(12):
        block = f"img_backbone.blocks.{k}"
        qkv = linear(w, f"{block}.attn.qkv", norm(w, f"{block}.norm1", x, 1e-6))
        x = x + linear(w, f"{block}.attn.proj", attend(*np.split(qkv, 3, axis=-1), 12))
        hidden = linear(w, f"{block}.mlp.fc1", norm(w, f"{block}.norm2", x, 1e-6))
        x = x + linear(w, f"{block}.mlp.fc2", gelu(hidden))
    return norm(w, "img_backbone.norm", x[1:], 1e-6).reshape(14, 14, 384)


def pool(
    cells: Float[np.ndarray, "rows columns c"], boxes: Float[np.ndarray, "n 4"]
) -> Float[np.ndarray, "n 14 14 c"]:
    """Pool as the weights expect: cells divided by 16 once more, rows taken for columns."""
    out = []
    for box in boxes:
        top, left, height, width = (int(value) for value in np.float32(box) * np.float32(224))
        row_start, row_end = left // 16 / 16, (left + width) // 16 / 16
        column_start, column_end = top // 16 / 16, (top + height) // 16 / 16
        rows = row_start + max(row_end - row_start, 1.0) * (np.arange(28) + 0.5) / 28
        columns = column_start + max(column_end - column_start, 1.0) * (np.arange(28) + 0.5) / 28
        r, c = np.floor(rows).astype(int), np.floor(columns).astype(int)
        fr, fc = (rows - r)[:, None, None], (columns - c)[None, :, None]
        upper = cells[r][:, c] * (1 - fc) + cells[r][:, c + 1] * fc
        lower = cells[r + 1][:, c] * (1 - fc) + cells[r + 1][:, c + 1] * fc
        samples = upper * (1 - fr) + lower * fr
        out.append(samples.reshape(14, 2, 14, 2, -1).mean(axis=(1, 3)))
    return np.stack(out)


def attend(q: np.ndarray, k: np.ndarray, v: np.ndarray, heads: int) -> np.ndarray:
    """Mix the values of all tokens, head by head."""
    out = []
    for a, b, c in zip(*(np.split(part, heads, axis=-1) for part in (q, k, v)), strict=True):
        odds = np.exp(a @ b.T / np.sqrt(a.shape[-1]))
        out.append(odds / odds.sum(axis=-1, keepdims=True) @ c)
    return np.concatenate(out, axis=-1)


def linear(w: Weights, name: str, x: np.ndarray) -> np.ndarray:
    return x @ w[f"{name}.weight"].T + w[f"{name}.bias"]


def norm(w: Weights, name: str, x: np.ndarray, eps: float) -> np.ndarray:
    centered = x - x.mean(axis=-1, keepdims=True)
    scale = np.sqrt((centered**2).mean(axis=-1, keepdims=True) + eps)
    return centered / scale * w[f"{name}.weight"] + w[f"{name}.bias"]


def stack(w: Weights, name: str, x: np.ndarray, count: int) -> np.ndarray:
    """Apply linear layers with leaky ReLUs between them."""
    for index in range(count):
        x = linear(w, f"{name}.{2 * index}", x if index == 0 else leaky(x))
    return x


def leaky(x: np.ndarray) -> np.ndarray:
    return np.where(x > 0, x, 0.01 * x)


def gelu(x: np.ndarray) -> np.ndarray:
    return x * (1 + erf(x / np.sqrt(2))) / 2
