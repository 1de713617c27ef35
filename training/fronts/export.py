"""Write the networks as ONNX, with large weights stored as 16-bit floats."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper
from torch import Tensor, nn

from momapos.perception.reconstruction import decode

from . import networks


class _Face(nn.Module):
    """The first network, with probabilities and fractions of the face as outputs."""

    def __init__(self, net: nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, face: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        heat, logs, front = self.net(face)
        return torch.sigmoid(heat), torch.exp(logs.clamp(-7, 1)), torch.sigmoid(front)


class _Part(nn.Module):
    """The second network, with probabilities and fractions of the crop as outputs."""

    def __init__(self, net: nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, crop: Tensor, aspect: Tensor) -> tuple[Tensor, ...]:
        logits, edges, heat, logs = self.net(crop, aspect)
        cells = torch.arange(edges.shape[-1], dtype=torch.float32)
        near = (cells - edges.argmax(dim=-1, keepdim=True)).abs() <= 2
        share = torch.softmax(edges, dim=-1) * near
        place = ((cells + 0.5) * share).sum(dim=-1) / share.sum(dim=-1) / edges.shape[-1]
        sure = torch.softmax(logits[:, :-1], dim=-1)
        held = torch.sigmoid(logits[:, -1])
        return sure, place, held, torch.sigmoid(heat), torch.exp(logs.clamp(-7, 1))


def write(net: nn.Module, path: Path) -> None:
    """Write either network; the second takes any number of crops."""
    if isinstance(net, networks.FaceNetwork):
        _write(_Face(net), _example(net), ["face"], ["heat", "reach", "front"], path, {})
        return
    out = ["sure", "edges", "held", "heat", "reach"]
    many = {name: {0: "n"} for name in ["crop", "aspect", *out]}
    _write(_Part(net), _example(net), ["crop", "aspect"], out, path, many)


def read(path: Path, net: nn.Module) -> nn.Module:
    """Read a network that `write` made, to train it further.

    Its normalizations are merged into its convolutions.

    Args:
        path: The file.
        net: A new network of the same form; it is modified.
    """
    model = onnx.load(path)
    values = {w.name.removesuffix("_half"): w for w in model.graph.initializer}
    named = [n for n in values if n.startswith("net.")]
    state = {n.removeprefix("net."): _tensor(values[n]) for n in named}
    for node in model.graph.node:
        if node.op_type == "Conv":
            name = _module(node.name)
            weight, bias = (_tensor(values[n]) for n in node.input[1:])
            net.get_submodule(name).bias = nn.Parameter(torch.empty_like(bias))
            state |= {f"{name}.weight": weight, f"{name}.bias": bias}
    for parent in list(net.modules()):
        for name, child in parent.named_children():
            if isinstance(child, nn.BatchNorm2d):
                setattr(parent, name, nn.Identity())
    net.load_state_dict(state)
    return net


def _module(scope: str) -> str:
    """Return the module of a node.

    Node /net/pyramid/down.0/down.0.1/first/first.0/Conv belongs to pyramid.down.0.1.first.0.
    """
    names = scope.split("/")[2:-1]
    return ".".join(a for a, b in pairwise([*names, ""]) if not b.startswith(f"{a}."))


def _tensor(weight: onnx.TensorProto) -> Tensor:
    return torch.from_numpy(numpy_helper.to_array(weight).astype(np.float32))


def _write(
    net: nn.Module,
    given: tuple[Tensor, ...],
    inputs: list[str],
    outputs: list[str],
    path: Path,
    many: dict[str, dict[int, str]],
) -> None:
    net.eval()
    torch.onnx.export(
        net,
        given,
        str(path),
        input_names=inputs,
        output_names=outputs,
        dynamic_axes=many,
        opset_version=17,
        dynamo=False,
    )
    model = onnx.load(path)
    _halve(model)
    onnx.checker.check_model(model)
    onnx.save(model, path)


def _example(net: nn.Module) -> tuple[Tensor, ...]:
    """Return an example input of a network."""
    if isinstance(net, networks.FaceNetwork):
        return (torch.zeros(1, networks.PLANES, decode.FACE_PIXELS, decode.FACE_PIXELS),)
    side = decode.PART_PIXELS
    return torch.zeros(2, networks.PLANES, side, side), torch.zeros(2, 1)


def _halve(model: onnx.ModelProto) -> None:
    """Store large weights as float16 and cast them to float32 when the model is loaded."""
    casts = []
    for weight in model.graph.initializer:
        values = numpy_helper.to_array(weight)
        if values.dtype != np.float32 or values.size < 512:
            continue
        name = weight.name
        weight.CopyFrom(numpy_helper.from_array(values.astype(np.float16), f"{name}_half"))
        casts.append(helper.make_node("Cast", [f"{name}_half"], [name], to=onnx.TensorProto.FLOAT))
    for cast in reversed(casts):
        model.graph.node.insert(0, cast)
