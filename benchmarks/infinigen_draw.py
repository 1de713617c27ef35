"""Export appliances that Infinigen generates closed, as URDFs with the joint of their door.

    drawn/bin/python benchmarks/infinigen_draw.py oven 0 14 --out drawn/urdf

Runs in the environment with Infinigen, see `infinigen_objects.py`, without momapos. Infinigen
exports one closed mesh without a joint, so each appliance is generated closed and open: the pieces
that move are the door, and their motion gives the joint. Edges stay sharp and hobs are electric,
since bevels and the cuts for burners differ between the two.
"""

from __future__ import annotations

import argparse
import sys
import xml.etree.ElementTree as ET
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

KINDS = {"oven": "oven.OvenFactory", "beveragefridge": "beverage_fridge.BeverageFridgeFactory"}
"""Module and factory of each appliance in Infinigen."""
OPEN = 1.0
"""Opening of the door in the second mesh [rad]."""
WIDE = 1.57
"""Upper limit of a door [rad]."""
MOVED = 1e-5
"""Minimum displacement of a moved vertex [units of Infinigen]."""


def draw(kind: str, seed: int, folder: Path) -> None:
    """Write one appliance, its meshes and its joint."""
    import bpy  # noqa: F401, the following imports need its bmesh
    from infinigen.assets.utils.decorate import read_co, remove_vertices
    from infinigen.core.util import blender
    from infinigen.tools.export import export_sim_ready

    folder.mkdir(parents=True, exist_ok=True)
    blender.clear_scene()
    module, name = KINDS[kind].split(".")
    factory = getattr(import_module(f"infinigen.assets.objects.appliances.{module}"), name)(seed)
    if "UseGas" in factory.params:
        factory.params["UseGas"] = False
    setattr(sys.modules[type(factory).__module__], "add_bevel", _sharp)  # noqa: B010, not typed
    opened = _asset(factory, seed, OPEN)
    body = _asset(factory, seed, 0.0)
    after, closed = read_co(opened), read_co(body)
    blender.delete(opened)
    if len(after) != len(closed):
        raise ValueError(f"{kind} {seed}: {len(closed)} points closed, {len(after)} open")
    own = _pieces(body)
    moves = np.isin(own, own[np.linalg.norm(after - closed, axis=1) > MOVED])
    pivot, axis = _turn(closed[moves], after[moves])
    door = blender.deep_clone_obj(body, keep_materials=True)
    remove_vertices(body, moves)
    remove_vertices(door, ~moves)
    for name, part in (("body_0", body), ("door_0", door)):
        export_sim_ready(
            part, folder / "assets", 64, name=name, visual_only=True, separate_asset_dirs=False
        )
    _urdf(kind, pivot, axis).write(folder / f"{kind}.urdf", encoding="utf-8")


def _sharp(solid: Any, edges: list[int], offset: float = 0.0) -> Any:
    """Replace Infinigen's bevel."""
    del edges, offset
    return solid


def _asset(factory: Any, seed: int, angle: float) -> Any:
    """Generate the asset with its door at an angle."""
    from infinigen.core.util.math import FixedSeed

    inputs = getattr(factory, "geometry_node_params", factory.params)
    inputs["DoorRotation"] = angle
    with FixedSeed(seed):
        return factory.create_asset()


def _pieces(solid: Any) -> np.ndarray:
    """Return the connected piece of each vertex; a door's vertices on its axis do not move."""
    from infinigen.assets.utils.decorate import read_edges

    edges, n = read_edges(solid), len(solid.data.vertices)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1])


def _turn(closed: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a point on the axis and its direction, of the rotation between two point sets."""
    center, other = closed.mean(axis=0), after.mean(axis=0)
    turn, _ = Rotation.align_vectors(after - other, closed - center)
    R, vector = turn.as_matrix(), turn.as_rotvec()
    t = other - R @ center
    pivot = np.linalg.lstsq(np.eye(3) - R, t, rcond=1e-6)[0]
    error = np.abs(closed @ R.T + t - after).max()
    if error > MOVED * 100:
        raise ValueError(f"the moving vertices do not turn as one rigid part, error {error:g}")
    return pivot, vector / np.linalg.norm(vector)


def _urdf(kind: str, pivot: np.ndarray, axis: np.ndarray) -> ET.ElementTree:
    """Build the URDF of a body and a door below a root without a mesh, as Infinigen writes it."""
    root = ET.Element("robot", name=kind)
    ET.SubElement(root, "link", name="world")
    for link, at in (("body", np.zeros(3)), ("door", -pivot)):
        visual = ET.SubElement(ET.SubElement(root, "link", name=link), "visual")
        ET.SubElement(visual, "origin", xyz=_words(at), rpy="0 0 0")
        geometry = ET.SubElement(visual, "geometry")
        ET.SubElement(geometry, "mesh", filename=f"assets/{link}_0.obj")
    _joint(root, ("world", "body"), "fixed", np.zeros(3))
    door = _joint(root, ("body", "door"), "revolute", pivot)
    ET.SubElement(door, "axis", xyz=_words(axis))
    ET.SubElement(door, "limit", lower="0", upper=str(WIDE), effort="50", velocity="1")
    return ET.ElementTree(root)


def _joint(root: ET.Element, links: tuple[str, str], kind: str, at: np.ndarray) -> ET.Element:
    """Add a joint from one link to another, at a point of the first."""
    joint = ET.SubElement(root, "joint", name=f"of_{links[1]}", type=kind)
    ET.SubElement(joint, "parent", link=links[0])
    ET.SubElement(joint, "child", link=links[1])
    ET.SubElement(joint, "origin", xyz=_words(at), rpy="0 0 0")
    return joint


def _words(values: np.ndarray) -> str:
    return " ".join(f"{v:.6f}" for v in values)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("end", type=int, help="the seed after the last")
    parser.add_argument("--out", type=Path, required=True, help="folder for the URDFs")
    args = parser.parse_args()
    for seed in range(args.first, args.end):
        draw(args.kind, seed, args.out / args.kind / str(seed))


if __name__ == "__main__":
    main()
