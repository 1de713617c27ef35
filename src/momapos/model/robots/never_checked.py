"""Pairs of links whose contact is meaningless, because of their joints."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from momapos.model.collision import Spheres, contacts, neighbors
from momapos.model.kinematics import Chain
from momapos.model.urdf import Articulated

from .joint_tree import ArmChain
from .srdf import Srdf

NESTED = "Nested"
"""Reason in our SRDFs for pairs of telescope stages."""


def nested_pairs(
    model: Articulated, chain: ArmChain, spheres: Spheres
) -> dict[tuple[str, str], str]:
    """Return the pairs of a telescope's stages and its carrier, whose hulls overlap by design."""
    slides = {name for follower, mimic in chain.coupled for name in (follower, mimic.joint)}
    joints = [model.joint(name) for name in slides]
    stages = {joint.child for joint in joints} | {joint.parent for joint in joints}
    above = {joint.child: joint.parent for joint in model.urdf.joints if not joint.movable}
    for link in tuple(stages):
        while (link := above.get(link, "")) and link not in stages:
            stages.add(link)
    links = spheres.links
    moving = [(links[i], links[j]) for i, j in spheres.pairs.tolist()]
    base = [(links[g], spheres.base_links[b]) for g, b in np.argwhere(spheres.base_pairs).tolist()]
    return {pair: NESTED for pair in (*moving, *base) if stages.issuperset(pair)}


def rigid_pairs(
    model: Articulated, chain: Chain, spheres: Spheres, srdf: Srdf
) -> dict[tuple[str, str], str]:
    """Return the pairs of links that touch at rest and that no arm joint moves relatively."""
    joined, links = neighbors(model), spheres.links
    i, j = np.triu_indices(len(links), 1)
    rows = np.flatnonzero((spheres.segment[i] == spheres.segment[j]) & (spheres.segment[i] > 0))
    pairs = np.array([
        (a, b)
        for a, b in zip(i[rows].tolist(), j[rows].tolist(), strict=True)
        if not joined(links[a], links[b]) and frozenset((links[a], links[b])) not in srdf.disabled
    ], np.int64).reshape(-1, 2)  # fmt: skip
    alone = replace(
        spheres,
        pairs=pairs,
        exact=np.zeros(len(pairs), bool),
        base_pairs=np.zeros_like(spheres.base_pairs),
    )
    found = contacts(chain, alone, np.clip(np.zeros((1, chain.size)), chain.lower, chain.upper))
    return {pair: "Always" for pair, hit in zip(found.pairs, found.by_hulls[0], strict=True) if hit}


def without(spheres: Spheres, pairs: Collection[tuple[str, str]]) -> Spheres:
    """Return the collision model without checks of some pairs of links."""
    never = {frozenset(pair) for pair in pairs}
    links = spheres.links
    keep = np.array([frozenset((links[i], links[j])) not in never for i, j in spheres.pairs], bool)
    free = np.array(
        [[frozenset((a, b)) in never for b in spheres.base_links] for a in links], bool
    ).reshape(spheres.base_pairs.shape)
    return replace(
        spheres,
        pairs=spheres.pairs[keep],
        exact=spheres.exact[keep],
        base_pairs=spheres.base_pairs & ~free,
    )
