"""momapos rank: score which objects matter for a task."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from momapos.apps.plots import check_figure_path
from momapos.core import check_outputs, say
from momapos.model.scene import find_scene, refuse_unknown_object

from .configuration import NO_SETTINGS, AlphaOption, ConfigArgs, ScorerOption, load_config
from .console import busy
from .loading import load_scene_with_joints
from .options import (
    Flag,
    JointsArg,
    OptionalFile,
    SceneArg,
    Target,
    check_seed,
)

if TYPE_CHECKING:
    from momapos.model.scene import Scene
    from momapos.planning.importance import Importance, ImportanceConfig

SETTINGS = ("importance",)
"""Fields and tables of a configuration that the command uses."""
_WORDS = {
    "": "", "near": "near it", "on": "on it", "in": "in it", "inside": "inside it",
    "carries": "carries it", "contains": "contains it",
}  # fmt: skip


def rank_objects(
    scene: SceneArg,
    target: Target,
    /,
    *,
    joint: JointsArg = (),
    scorer: ScorerOption = None,
    alpha: AlphaOption = None,
    seed: int = 0,
    plot: OptionalFile = None,
    json: Flag = False,
    settings: ConfigArgs = NO_SETTINGS,
) -> int:
    """Score each object of a scene by how much it matters for a task with one of them.

    Args:
        scene: A scene file or a built-in kitchen.
        target: The object of the task, and its joint if it has several.
        joint: Set a joint of the scene, such as fridge/door_hinge=60deg.
        scorer: reach: large for its distance to the path of the hand; deepwalk: as in the paper;
            distance: near the target; size: large for its distance to the target; names: by words.
        alpha: Objects with at least this score are in S, in [0, 1].
        seed: The same seed gives the same scores.
        plot: Draw the scene graph over the floor plan (PNG, SVG or PDF).
        json: Print one JSON object, and nothing else.
        settings: Further settings.
    """
    import json as encoder

    # Mistakes are reported before anything heavy is imported.
    check_seed(seed)
    config = load_config(settings, SETTINGS, scorer=scorer, alpha=alpha).importance
    check_outputs([plot])
    check_figure_path(plot)
    name, _, moved = target.partition("/")
    refuse_unknown_object(find_scene(scene), name)
    from momapos.planning.importance import rank

    from .compile import compile_once, rank_kernels

    loaded = load_scene_with_joints(scene, joint)
    compile_once(rank_kernels(config))
    with busy(f"{loaded.name}: scoring {len(loaded.objects)} objects"):
        result = rank(loaded, name, config, joint=moved or None, seed=seed)
    if plot is not None:
        from momapos.apps.plots import draw_importance

        with busy(f"drawing {plot.name}"):
            draw_importance(loaded, result, plot)
    if json:
        say(encoder.dumps(importance_to_dict(loaded, result, config), allow_nan=False))
    else:
        say(table(loaded, result))
    return 0


def table(scene: Scene, result: Importance) -> str:
    """Tabulate all objects, most important first."""
    chosen = result.selected()
    width = max(len("object"), *map(len, result.names))
    lines = [
        f"{scene.name}: importance for {result.target} by {result.scorer}: "
        f"{len(chosen)} of {len(result.names)} in S (alpha {result.alpha:g})",
        "",
        f"  score  S  {'object':<{width}}  relation",
    ]
    for k, name in enumerate(result.names):
        mark = "*" if k < len(chosen) else " "
        lines.append(
            f"  {result.scores[k]:5.3f}  {mark}  {name:<{width}}  {relation_words(result, k)}"
        )
    return "\n".join(lines)


def relation_words(result: Importance, k: int) -> str:
    """Describe how the k-th object is related to the target."""
    if result.names[k] == result.target:
        return "the target"
    direct, steps = _WORDS[result.relations[k]], result.steps[k]
    return direct or (f"{steps} relations away" if steps > 0 else "not related")


def importance_to_dict(
    scene: Scene, result: Importance, config: ImportanceConfig
) -> dict[str, Any]:
    """Return the scores as plain values; distances in [m]."""
    from momapos.planning.importance import KINDS

    graph, chosen = result.graph, set(result.selected())
    objects = [
        {
            "name": name, "score": float(result.scores[k]), "selected": name in chosen,
            "relation": result.relations[k] or None,
            "steps": result.steps[k] if result.steps[k] >= 0 else None,
        }
        for k, name in enumerate(result.names)
    ]  # fmt: skip
    edges = [
        {
            "child": graph.names[child], "parent": graph.names[parent], "kind": KINDS[kind],
            "dist_xy": float(length),
        }
        for child, parent, kind, length in zip(
            graph.child, graph.parent, graph.kind, graph.dist_xy, strict=True
        )
    ]  # fmt: skip
    return {
        "scene": str(scene.path or scene.name), "target": result.target, "seed": result.seed,
        "config": asdict(config), "objects": objects, "edges": edges,
    }  # fmt: skip
