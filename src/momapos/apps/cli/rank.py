"""momapos rank: which objects matter for a task with one of them."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import OmitArgPrefixes, Positional

from momapos.apps.plots import check_picture
from momapos.core import check_outputs
from momapos.model.scene import find_scene, refuse_unknown_object
from momapos.planning.importance import ImportanceConfig

from .console import busy
from .loading import load_room
from .options import JointsArg, OptionalPath, Target, check_seed, unread

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tyro.constructors import ConstructorRegistry

    from momapos.model.scene import Scene
    from momapos.planning.importance import Importance

Shared = Annotated[ImportanceConfig, OmitArgPrefixes]
_PLAIN = {"--joint", "--seed", "--plot", "--json"}
_WORDS = {
    "": "", "near": "near it", "on": "on it", "in": "in it", "inside": "inside it",
    "carries": "carries it", "contains": "contains it",
}  # fmt: skip


def tyro_rules(words: Sequence[str]) -> ConstructorRegistry | None:
    """How tyro reads the words of the command below, see `unread`."""
    return unread(ImportanceConfig, _PLAIN, words)


def rank_objects(
    scene: Positional[str],
    target: Positional[Target],
    /,
    *,
    joint: JointsArg = (),
    seed: int = 0,
    plot: OptionalPath = None,
    json: bool = False,
    config: Shared = ImportanceConfig(),  # noqa: B008 (frozen)
) -> int:
    """Score every object of a room by how much it matters for a task with one of them.

    Args:
        scene: A scene file or the name of a built-in kitchen.
        target: The object that the task is about, and the joint where it has several.
        joint: A joint that stands elsewhere than in the file, as fridge/door_hinge=60deg;
            repeatable.
        seed: Same seed, same scores.
        plot: Draw the scene graph over the room (PNG, SVG or PDF).
        json: Print one JSON object and nothing else.
        config: How to score.
    """
    import json as encoder

    # What is mistyped is told before anything heavy is imported.
    check_seed(seed)
    check_outputs([plot])
    check_picture(plot)
    name, _, moved = target.partition("/")
    refuse_unknown_object(find_scene(scene), name)
    from momapos.core import user_cache
    from momapos.planning.grasps import hand_path
    from momapos.planning.importance import rank

    from .compile import RANK, WALKS, compile_once

    loaded = load_room(scene, joint, user_cache())
    path = hand_path(loaded, name, moved or None)
    compile_once(RANK + WALKS if config.scorer == "deepwalk" else RANK)
    with busy(f"{loaded.name}: scoring {len(loaded.objects)} objects"):
        result = rank(loaded, name, config, path=path, seed=seed)
    if plot is not None:
        from momapos.apps.plots import draw_importance

        with busy(f"drawing {plot.name}"):
            draw_importance(loaded, result, plot)
    if json:
        print(encoder.dumps(importance_to_dict(loaded, result, config), allow_nan=False))
    else:
        print(table(loaded, result))
    return 0


def table(scene: Scene, result: Importance) -> str:
    """All objects in a few columns, most important first."""
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
    """What the k-th object is to the target, in words."""
    if result.names[k] == result.target:
        return "the target"
    direct, steps = _WORDS[result.relations[k]], result.steps[k]
    return direct or (f"{steps} relations away" if steps > 0 else "not related")


def importance_to_dict(
    scene: Scene, result: Importance, config: ImportanceConfig
) -> dict[str, Any]:
    """The answer as plain values; distances in [m]."""
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
