"""Evaluate how well scores identify the objects that matter: ROC, precision, recall, figure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import rankdata

from momapos.apps.plots import INK, SOFT_INK
from momapos.apps.plots.palette import FAINT

ALPHA = 0.45
"""The paper's threshold [-]."""
ALPHAS = np.linspace(0.0, 1.0, 101)
SHARES = (0.0, 0.01, 0.05)
"""An object matters if modeling it as a box loses more than this share of the poses [-]."""
PAPER = "deepwalk k0=0.5"
SHOWN = {
    PAPER: ("deepwalk", "#2a7ab8"),
    "distance": ("distance", "#b87800"),
    "size": ("size / distance", "#008060"),
    "reach": ("reach: size / distance to the handle's path", "#a5371e"),
    "names": ("names", "#8a4b9c"),
}
"""Scorers in the figure: name and color."""
MIN_SHARE = 0.02
"""Curves omit an S of less than this share of the objects, where chance dominates [-]."""


@dataclass(frozen=True)
class Pairs:
    """All pairs of a task and an object for one scorer, once per seed."""

    score: Float[np.ndarray, " n"]
    matters: Bool[np.ndarray, " n"]
    task: Int[np.ndarray, " n"]
    """Index of the pair's task and seed."""


def pairs(tasks: list[dict[str, Any]], scorer: str, share: float = SHARES[1]) -> Pairs:
    """Stack the scores and the truth of all tasks."""
    runs = [(task, one) for task in tasks for one in task["scores"][scorer]]
    matters = [np.array(task["lost"]) > share for task, _ in runs]
    owner = np.repeat(np.arange(len(runs)), [len(one) for _, one in runs])
    return Pairs(np.concatenate([one for _, one in runs]), np.concatenate(matters), owner)


def roc_area(p: Pairs) -> float:
    """Return how often an object that matters scores above one that does not; ties count 0.5."""
    many, few = p.matters.sum(), (~p.matters).sum()
    if not many or not few:
        return float("nan")
    return float((rankdata(p.score)[p.matters].sum() - many * (many + 1) / 2) / (many * few))


def roc_within(p: Pairs) -> float:
    """Return the mean of the same measure within each task: the quality of the order."""
    one = [Pairs(p.score[k], p.matters[k], p.task[k]) for t in set(p.task) for k in [p.task == t]]
    return float(np.nanmean([roc_area(part) for part in one]))


def curve(p: Pairs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return precision, recall and the share in S at every score, the highest first."""
    order = np.argsort(-p.score, kind="stable")
    hits = np.cumsum(p.matters[order])
    last = np.append(np.diff(p.score[order]) != 0, True)
    taken = np.arange(1, len(hits) + 1)
    return (hits / taken)[last], (hits / hits[-1])[last], (taken / len(hits))[last]


def average_precision(p: Pairs) -> float:
    """Return the area under the stepwise precision-recall curve."""
    precision, recall, _ = curve(p)
    return float((np.diff(recall, prepend=0.0) * precision).sum())


def at(p: Pairs, alpha: float) -> dict[str, float]:
    """Return precision, recall, F1 and the share of objects in S at a threshold."""
    chosen = p.score >= alpha
    hits = float((chosen & p.matters).sum())
    precision = hits / chosen.sum() if chosen.any() else 1.0
    recall = hits / p.matters.sum()
    f1 = 2 * hits / (chosen.sum() + p.matters.sum())
    return {"precision": precision, "recall": recall, "f1": f1, "kept": float(chosen.mean())}


def measures(tasks: list[dict[str, Any]], scorer: str, share: float) -> dict[str, Any]:
    """Return all measures of one scorer."""
    p = pairs(tasks, scorer, share)
    count = sum(len(task["objects"]) for task in tasks)
    everywhere = [at(p, alpha) for alpha in ALPHAS]
    best = int(np.argmax([row["f1"] for row in everywhere]))
    # The highest alpha with a recall of 90 %: the size of S if few misses are allowed.
    safe = int(np.flatnonzero([row["recall"] >= 0.9 for row in everywhere]).max())
    return {
        "pairs": count,
        "matter": float(p.matters.mean()),
        "roc": roc_area(p),
        "roc_within": roc_within(p),
        "ap": average_precision(p),
        "at_alpha": at(p, ALPHA),
        "best": {"alpha": float(ALPHAS[best])} | everywhere[best],
        "safe": {"alpha": float(ALPHAS[safe])} | everywhere[safe],
    }


def summary(tasks: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the measures of all scorers, over all rooms and by source, for each share."""
    rows = []
    for share in SHARES:
        for source in ("all", "shared", "built-in"):
            some = [t for t in tasks if source in ("all", t["source"]) and t["objects"]]
            if not some:
                continue
            head = {"share": share, "source": source, "tasks": len(some)}
            head["rooms"] = len({t["room"] for t in some})
            rows += [
                head | {"scorer": name} | measures(some, name, share) for name in some[0]["scores"]
            ]
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """Format the measures as Markdown: by source for the default share, else over all rooms."""
    lines: list[str] = []
    group: tuple[str, ...] = ()
    for r in rows:
        if r["share"] != SHARES[1] and r["source"] != "all":
            continue
        if group != (group := (r["share"], r["source"])):
            lines += [
                f"\n{r['source']}: {r['rooms']} rooms, {r['tasks']} tasks, {r['pairs']} pairs; "
                f"{100 * r['matter']:.1f} % of the objects matter (> {100 * r['share']:g} %)\n",
                "| scorer | ROC | in a task | AP | at 0.45: P, R, S | best F1: P, R, S | "
                "R 90 %: P, S |",
                "|---|---|---|---|---|---|---|",
            ]
        a, b, c = r["at_alpha"], r["best"], r["safe"]
        lines.append(
            f"| {r['scorer']} | {r['roc']:.3f} | {r['roc_within']:.3f} | {r['ap']:.3f} | "
            f"{a['precision']:.2f}, {a['recall']:.2f}, {100 * a['kept']:.0f} % | "
            f"{b['f1']:.2f} at {b['alpha']:.2f}: "
            f"{b['precision']:.2f}, {b['recall']:.2f}, {100 * b['kept']:.0f} % | "
            f"at {c['alpha']:.2f}: {c['precision']:.2f}, {100 * c['kept']:.0f} % |"
        )
    return "\n".join(lines)


def draw(tasks: list[dict[str, Any]], path: Path) -> None:
    """Draw precision over recall, and both over alpha, by scorer."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"font.size": 9, "text.color": INK, "axes.edgecolor": SOFT_INK})
    figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.6), layout="constrained")
    rate = 0.0
    for scorer, (name, color) in SHOWN.items():
        p = pairs(tasks, scorer)
        rows = [at(p, alpha) for alpha in ALPHAS]
        alphas = (ALPHAS, *([row[k] for row in rows] for k in ("precision", "recall", "kept")))
        precision, recall, kept = curve(p)
        lines = [(recall, precision, kept), (*alphas[:2], alphas[3]), (alphas[0], *alphas[2:])]
        for axis, (x, y, share) in zip(axes, lines, strict=True):
            fair = np.asarray(share) >= MIN_SHARE
            label = name if axis is axes[0] else None
            axis.plot(np.asarray(x)[fair], np.asarray(y)[fair], color=color, lw=1.8, label=label)
        rate = float(p.matters.mean())
    _dress(axes, rate)
    figure.legend(loc="outside lower center", ncols=len(SHOWN), frameon=False)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _dress(axes: np.ndarray, rate: float) -> None:
    """Add titles, grids, and reference lines of chance and of the paper's alpha."""
    titles = (
        ("recall", "precision", "Precision over recall"),
        ("alpha", "precision", "Precision over alpha"),
        ("alpha", "recall", "Recall over alpha"),
    )
    for axis, (x, y, title) in zip(axes, titles, strict=True):
        axis.set(xlabel=x, ylabel=y, xlim=(0, 1), ylim=(0, 1.02))
        axis.set_title(title, loc="left", fontsize=10)
        axis.grid(color=FAINT, lw=0.6)
        axis.spines[["top", "right"]].set_visible(False)
    dashes: dict[str, Any] = {"color": SOFT_INK, "lw": 0.8, "ls": (0, (3, 2))}
    for axis, left in zip(axes[:2], (0.68, 0.02), strict=True):
        axis.axhline(rate, **dashes)
        axis.text(left, rate - 0.025, "all objects in S", color=SOFT_INK, fontsize=8)
    for axis in axes[1:]:
        axis.axvline(ALPHA, **dashes)
        axis.text(ALPHA + 0.01, 0.01, "0.45", color=SOFT_INK, fontsize=8)
