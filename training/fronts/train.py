"""Draw faces, train both networks, write them to the package; see README.md."""

from __future__ import annotations

import argparse
import copy
import multiprocessing as mp
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from momapos.perception.reconstruction import decode

from . import export, generator, networks, pool, targets

WEIGHTS = (
    Path(__file__).parents[2] / "src" / "momapos" / "perception" / "reconstruction" / "weights"
)
MIRROR = np.array(decode.MIRRORED_KINDS)
"""Kind of each mirrored part."""
MIXES = {"ordinary": generator.ORDINARY, "hard": generator.HARD, "last": generator.LAST}
FACES = (16000, 10000, 6000)
"""Number of drawn faces of each mix [-]."""
FACE_STEPS, PART_STEPS = 12000, 11000
"""Training steps of both networks [-]."""
LIFT_STEPS, KIND_STEPS = 1000, 1600
"""Further training steps for lifted doors and the front score (first network), and for kinds
(second network) [-]."""
WITHOUT_LINES = 0.5
"""Share of images without dark lines: drawn seams are visible more often than real ones [-]."""
NARROW = torch.backends.mkldnn.is_available() and torch.cpu._is_avx512_bf16_supported()
"""Whether this processor multiplies 16-bit floats, which halves the time."""


@dataclass(frozen=True)
class Schedule:
    """Training schedule of one network."""

    steps: int
    batch: int
    rate: float = 2e-3
    decay: float = 0.02
    keep: float = 0.997
    """Decay of the running average of the weights, which is shipped [-]."""


def augmented(rng: np.random.Generator, codes: np.ndarray) -> Tensor:
    """Augment the images of a step: other colors, no relief in some, fainter or no lines."""
    stack = pool.unpacked(codes)
    n = len(stack)
    gain = rng.uniform(0.8, 1.2, (n, 1, 1, 1)) * rng.normal(1, 0.04, (n, 3, 1, 1))
    lift = rng.normal(0, 0.15, (n, 1, 1, 1)) + rng.normal(0, 0.03, (n, 3, 1, 1))
    stack[:, :3] = stack[:, :3] * gain + lift
    for i in np.nonzero(rng.random(n) < 0.15)[0]:
        stack[i, :3] = stack[i, rng.permutation(3)]
    for i in np.nonzero(rng.random(n) < 0.1)[0]:
        stack[i, :3] = stack[i, :3].mean(axis=0)
    without = rng.random(n) < 0.45
    stack[without, 3:5] = 0
    stack[:, 3] += rng.normal(0, 0.05, (n, 1, 1)) * stack[:, 4]
    stack[:, 5:] *= rng.uniform(0.4, 1.2, (n, 1, 1, 1))
    stack[rng.random(n) < WITHOUT_LINES, 5:] = 0
    return torch.from_numpy(stack)


def flipped(boxes: np.ndarray) -> np.ndarray:
    """Return mirrored boxes."""
    return np.stack((1 - boxes[..., 2], boxes[..., 1], 1 - boxes[..., 0], boxes[..., 3]), axis=-1)


def outputs_of(net: nn.Module, images: Tensor, *more: Tensor) -> list[Tensor]:
    """Return a network's outputs for images."""
    with torch.autocast("cpu", torch.bfloat16, enabled=NARROW):
        outputs = net(images.contiguous(memory_format=torch.channels_last), *more)
    return [each.float() for each in outputs]


def face_step(
    net: nn.Module, data: pool.Pool, rng: np.random.Generator, chosen: np.ndarray
) -> dict[str, Tensor]:
    """Return the losses of the first network on some faces."""
    codes, boxes, kinds = data.faces[chosen], data.boxes[chosen], data.kinds[chosen].astype(int)
    mirror = rng.random(len(chosen)) < 0.5
    codes = np.where(mirror[:, None, None, None], codes[..., ::-1], codes)
    boxes = np.where(mirror[:, None, None], flipped(boxes), boxes)
    kinds = np.where(mirror[:, None] & (kinds >= 0), MIRROR[kinds], kinds)
    side = decode.FACE_PIXELS // 4
    made = [targets.face_targets(b, k, side) for b, k in zip(boxes, kinds, strict=True)]
    heat, reach, weight = (torch.from_numpy(np.stack(m)) for m in zip(*made, strict=True))
    count = torch.tensor(float((kinds >= 0).sum()))
    predicted_heat, predicted_reach, front = outputs_of(net, augmented(rng, codes))
    real = torch.from_numpy((kinds[:, 0] >= 0).astype(np.float32))
    return {
        "heat": targets.heat_loss(predicted_heat, heat, count),
        "reach": targets.reach_loss(predicted_reach, reach, weight),
        "front": 0.3 * nn.functional.binary_cross_entropy_with_logits(front, real),
    }


def part_step(
    net: nn.Module, data: pool.Pool, rng: np.random.Generator, chosen: np.ndarray
) -> dict[str, Tensor]:
    """Return the losses of the second network on some crops."""
    codes, kinds = data.crops[chosen], data.crop_kinds[chosen].astype(int)
    edges, handles = data.edges[chosen], data.handles[chosen]
    mirror = rng.random(len(chosen)) < 0.5
    codes = np.where(mirror[:, None, None, None], codes[..., ::-1], codes)
    edges = np.where(mirror[:, None], flipped(edges), edges)
    handles = np.where(mirror[:, None], flipped(handles), handles)
    kinds = np.where(mirror, MIRROR[kinds], kinds)
    aspects = data.aspects[chosen] + rng.normal(0, 0.15, len(chosen)).astype(np.float32)
    crops = augmented(rng, codes)
    logits, predicted_edges, heat_logits, logs = outputs_of(
        net, crops, torch.from_numpy(aspects)[:, None]
    )
    real = torch.from_numpy((kinds < pool.NO_PART).astype(np.float32))
    held = np.isfinite(handles[:, 0])
    side = heat_logits.shape[-1]
    heat = np.zeros((len(chosen), side, side), np.float32)
    reach = np.full((len(chosen), 4, side, side), 0.1, np.float32)
    if held.any():
        heat[held] = targets.bumps(handles[held], side, 0.15)
        reach[held] = targets.distances(handles[held], side)
    weight = np.where((heat > 0.6) & (reach.min(axis=1) > 0.001), heat, 0)
    reach = np.maximum(reach, 0.002)
    grip = nn.functional.binary_cross_entropy_with_logits(
        logits[:, -1], torch.from_numpy(held.astype(np.float32)), reduction="none"
    )
    count = torch.tensor(float(held.sum()))
    return {
        "kind": nn.functional.cross_entropy(
            logits[:, :-1], torch.from_numpy(kinds), label_smoothing=0.02
        ),
        "edges": 0.5 * targets.edge_loss(predicted_edges, torch.from_numpy(edges), real),
        "held": 0.5 * (grip * real).sum() / real.sum().clamp(min=1),
        "heat": 0.3 * targets.heat_loss(heat_logits, torch.from_numpy(heat), count),
        "reach": 0.5 * targets.reach_loss(logs, torch.from_numpy(reach), torch.from_numpy(weight)),
    }


Step = Callable[[nn.Module, pool.Pool, np.random.Generator, np.ndarray], dict[str, Tensor]]


class Deck:
    """Draws numbers in random order, each once before any repeats."""

    def __init__(self, cards: np.ndarray, rng: np.random.Generator) -> None:
        self.cards, self.rng = cards, rng
        self.left = np.empty(0, dtype=int)

    def take(self, count: int) -> np.ndarray:
        """Return the next numbers, sorted."""
        if len(self.left) < count:
            self.left = np.concatenate((self.left, self.rng.permutation(self.cards)))
        taken, self.left = self.left[:count], self.left[count:]
        return np.sort(taken)


def fit(
    net: nn.Module,
    step: Step,
    data: list[tuple[pool.Pool, np.ndarray]],
    plan: Schedule,
    seed: int,
    out: Path,
) -> None:
    """Train a network; write the average of its weights regularly and at the end.

    Args:
        net: The network; it is modified.
        step: Returns its losses on some samples.
        data: Pools that take turns, each with the indices of its samples.
        plan: The schedule.
        seed: Seed of order and augmentation.
        out: Output file.
    """
    rng = np.random.default_rng(seed)
    net = net.to(memory_format=torch.channels_last).train()
    averaged = copy.deepcopy(net).eval()
    optimizer = torch.optim.AdamW(net.parameters(), lr=plan.rate, weight_decay=plan.decay)
    pace = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, plan.rate, total_steps=plan.steps, pct_start=0.15
    )
    decks = [Deck(usable, rng) for _, usable in data]
    totals: dict[str, float] = {}
    start = time.perf_counter()
    for i in range(1, plan.steps + 1):
        turn = i % len(data)
        losses = step(net, data[turn][0], rng, decks[turn].take(plan.batch))
        optimizer.zero_grad(set_to_none=True)
        torch.stack(list(losses.values())).sum().backward()
        nn.utils.clip_grad_norm_(net.parameters(), 5.0)
        optimizer.step()
        pace.step()
        _follow(averaged, net, min(plan.keep, (1 + i) / (10 + i)))
        for key, value in losses.items():
            totals[key] = totals.get(key, 0.0) + float(value.detach())
        if i % 50 == 0:
            means = ", ".join(f"{key} {value / 50:.3f}" for key, value in totals.items())
            spent = time.perf_counter() - start
            print(f"{out.stem} {i}/{plan.steps} {spent:.0f} s: {means}", flush=True)
            totals = {}
        if i % 200 == 0:
            export.write(averaged, out)
    export.write(averaged, out)


@torch.no_grad()
def _follow(averaged: nn.Module, net: nn.Module, keep: float) -> None:
    for old, new in zip(averaged.state_dict().values(), net.state_dict().values(), strict=True):
        if old.dtype.is_floating_point:
            old.lerp_(new, 1 - keep)
        else:
            old.copy_(new)


def train_face(pools: list[Path], out: Path, plan: Schedule, seed: int) -> None:
    """Train the first network on all faces."""
    _make_reproducible(seed)
    fit(networks.FaceNetwork(), face_step, _faces(pools), plan, seed, out)


def train_part(pools: list[Path], out: Path, plan: Schedule, seed: int) -> None:
    """Train the second network on all crops."""
    _make_reproducible(seed)
    fit(networks.PartNetwork(), part_step, _crops(pools), plan, seed, out)


def train_lifts(pools: list[Path], path: Path, plan: Schedule, seed: int) -> None:
    """Train only the first network's weights for the heat of lifted doors and the front score."""
    _make_reproducible(seed)
    net = networks.FaceNetwork()
    export.read(path, net).requires_grad_(False)
    net.heat.requires_grad_(True)
    net.front.requires_grad_(True)
    lifted = torch.zeros(len(decode.KINDS))
    lifted[decode.KINDS.index("door_up")] = 1.0
    net.heat.weight.register_hook(lambda gradient: gradient * lifted[:, None, None, None])
    net.heat.bias.register_hook(lambda gradient: gradient * lifted)
    fit(net, face_step, _faces(pools), replace(plan, decay=0.0), seed, path)


def train_kinds(pools: list[Path], path: Path, plan: Schedule, seed: int) -> None:
    """Train only the second network's last layers, which classify kinds."""
    _make_reproducible(seed)
    net = networks.PartNetwork()
    export.read(path, net).requires_grad_(False)
    net.kind.requires_grad_(True)
    fit(net, part_step, _crops(pools), plan, seed, path)


def _faces(pools: list[Path]) -> list[tuple[pool.Pool, np.ndarray]]:
    """Read pools, each with the indices of its faces."""
    return [(each, np.arange(len(each.faces))) for each in map(pool.Pool.read, pools)]


def _crops(pools: list[Path]) -> list[tuple[pool.Pool, np.ndarray]]:
    """Read pools, each with the indices of its crops."""
    return [(each, np.nonzero(each.crop_kinds[:] >= 0)[0]) for each in map(pool.Pool.read, pools)]


def _make_reproducible(seed: int) -> None:
    """Set one thread and the seed, so that a run is reproducible."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)


Train = Callable[[list[Path], Path, Schedule, int], None]


def side_by_side(
    tasks: Sequence[tuple[Train, Path, Schedule]], pools: list[Path], seed: int
) -> None:
    """Train in separate processes; a failure ends this process, too."""
    context = mp.get_context("spawn")
    jobs = [
        context.Process(target=train, args=(pools, path, plan, seed))
        for train, path, plan in tasks
        if plan.steps
    ]
    for job in jobs:
        job.start()
    for job in jobs:
        job.join()
        if job.exitcode:
            raise SystemExit(job.exitcode)


def main() -> None:
    """Draw, train and write both networks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pools", type=Path, default=Path("build/fronts"), help="scratch folder")
    parser.add_argument("--out", type=Path, default=WEIGHTS, help="folder of the networks")
    parser.add_argument("--faces", type=int, nargs=3, default=FACES, help="number of faces to draw")
    parser.add_argument("--face-steps", type=int, default=FACE_STEPS)
    parser.add_argument("--part-steps", type=int, default=PART_STEPS)
    parser.add_argument("--lift-steps", type=int, default=LIFT_STEPS)
    parser.add_argument("--kind-steps", type=int, default=KIND_STEPS)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    for i, (name, count) in enumerate(zip(MIXES, given.faces, strict=True)):
        if not (given.pools / name / "handles.npy").exists():
            pool.fill(given.pools / name, MIXES[name], given.seed + i, count, workers=2)
    given.out.mkdir(parents=True, exist_ok=True)
    face, part = given.out / "front_face.onnx", given.out / "front_part.onnx"
    first = [
        (train_face, face, Schedule(given.face_steps, 24)),
        (train_part, part, Schedule(given.part_steps, 48)),
    ]
    more = [
        (train_lifts, face, Schedule(given.lift_steps, 24, rate=3e-3)),
        (train_kinds, part, Schedule(given.kind_steps, 48, rate=1e-3)),
    ]
    side_by_side(first, [given.pools / "ordinary", given.pools / "hard"], given.seed)
    side_by_side(more, [given.pools / "last"], given.seed)


if __name__ == "__main__":
    main()
