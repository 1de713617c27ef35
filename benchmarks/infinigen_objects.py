"""Convert Infinigen's appliances to URDFs for `scan_objects.py`.

    python3.11 -m venv drawn && drawn/bin/pip install infinigen==1.15.5
    for seed in $(seq 0 13); do drawn/bin/python -c "if True:
        from infinigen.core.sim.sim_factory import Path, spawn_simready
        spawn_simready('dishwasher', 'urdf', Path('drawn'), 64, $seed, visual_only=True)"; done
    drawn/bin/python benchmarks/infinigen_draw.py oven 0 14 --out drawn/urdf
    drawn/bin/python benchmarks/infinigen_draw.py beveragefridge 0 12 --out drawn/urdf
    python benchmarks/infinigen_objects.py drawn/urdf --out FOLDER
    python benchmarks/scan_objects.py --models FOLDER --no-answers

Doors, handles, buttons and materials come from an independent generator, so momapos is not tuned to
them. Moving parts other than doors, such as knobs and racks, are fixed. Each appliance gets the
usual height of its kind, and one color per triangle, from its texture. A hash of the name decides
whether it is in the development or the test set, as in `objects.py`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from trimesh.visual import ColorVisuals

from momapos.apps.bench.articulated import USUAL, Usual, set_of
from momapos.core.geometry import pose_planar
from momapos.model.scene import SceneObject
from momapos.model.scene.formats import urdf_text
from momapos.model.urdf import Articulated, Geometry, Joint, Urdf, read_urdf

KINDS = {
    "dishwasher": USUAL["Dishwasher"],
    "oven": Usual(1.2, 0.0),  # with the panel behind its hob
    "beveragefridge": USUAL["MiniFridge"],
}
"""Converted kinds with their usual size and height; most of Infinigen's assets have no unit."""
DOOR = "door"
"""Text in the mesh name of a door."""
LEVELS = 32
"""Number of levels per color channel [-]."""
_TURNED = pose_planar(np.array([0.0, 0.0, -np.pi / 2]))
"""Turns a front toward +x to -y, as in `object_rooms`."""


def write(file: Path, usual: Usual, home: Path) -> Path:
    """Write an asset of Infinigen as a kitchen appliance.

    Args:
        file: Infinigen's URDF.
        usual: Its usual size.
        home: Folder for the URDF and its meshes.

    Returns:
        The URDF file.
    """
    home.mkdir(parents=True, exist_ok=True)
    low, high = SceneObject("drawn", "", np.eye(4), Articulated(_solid(read_urdf(file)))).bounds
    urdf = read_urdf(file, scale=usual.height / (high[2] - low[2]))
    links = {
        name: replace(link, visuals=tuple(_painted(shape, home) for shape in link.visuals))
        for name, link in urdf.links.items()
    }
    joints = tuple(_joint(joint, urdf) for joint in urdf.joints)
    made = _solid(replace(urdf, name=home.name, links=links, joints=joints))
    path = home / "model.urdf"
    path.write_text(urdf_text(made), encoding="utf-8")
    return path


def _joint(joint: Joint, urdf: Urdf) -> Joint:
    """Return a joint: that of a door unchanged, others fixed; children of the root are turned."""
    T = _TURNED @ joint.T_parent_joint if joint.parent == urdf.root else joint.T_parent_joint
    meshes = [shape.mesh for shape in urdf.links[joint.child].visuals]
    names = [mesh.stem for mesh in meshes if isinstance(mesh, Path)]
    turns = joint.kind == "revolute" and any(DOOR in name for name in names)
    return replace(joint, T_parent_joint=T, kind="revolute" if turns else "fixed")


def _solid(urdf: Urdf) -> Urdf:
    """Copy visual to collision geometry, which Infinigen does not write."""
    links = {name: replace(link, collisions=link.visuals) for name, link in urdf.links.items()}
    return replace(urdf, links=links)


def _painted(shape: Geometry, home: Path) -> Geometry:
    """Replace the texture of a mesh by colors in a material file."""
    assert isinstance(shape.mesh, Path)
    mesh = trimesh.load(shape.mesh, force="mesh", process=False)
    visual = mesh.visual if isinstance(mesh.visual, ColorVisuals) else mesh.visual.to_color()
    shades = visual.vertex_colors[mesh.faces, :3].mean(axis=1)
    colors, own = np.unique((shades * LEVELS / 256).astype(int), axis=0, return_inverse=True)
    paints = shape.mesh.with_suffix(".mtl").name
    lines = [f"mtllib {paints}", *(f"v {_words(point)}" for point in mesh.vertices)]
    for k in range(len(colors)):
        lines += [f"usemtl {k}", *(f"f {a} {b} {c}" for a, b, c in mesh.faces[own == k] + 1)]
    kinds = [f"newmtl {k}\nKd {_words(c)}\n" for k, c in enumerate((colors + 0.5) / LEVELS)]
    (home / paints).write_text("".join(kinds), encoding="utf-8")
    (home / shape.mesh.name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return replace(shape, name=shape.mesh.stem, mesh=Path(shape.mesh.name))


def _words(values: np.ndarray) -> str:
    return " ".join(f"{v:.6f}" for v in values)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drawn", type=Path, help="folder of Infinigen's assets")
    parser.add_argument("--out", type=Path, required=True, help="folder for the URDFs")
    args = parser.parse_args()
    rows = []
    for kind, usual in KINDS.items():
        for file in sorted(args.drawn.glob(f"{kind}/*/{kind}.urdf")):
            name = f"Infinigen/{kind}/{file.parent.name}"
            urdf = write(file, usual, args.out / name.replace("/", "_"))
            path = urdf.relative_to(args.out).as_posix()
            rows.append(
                {"name": name, "urdf": path, "above": usual.above, "counter": usual.counter}
            )
    if not rows:
        sys.exit(f"{args.drawn}: no assets of Infinigen; see --help")
    (args.out / "models.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(f"{dict(Counter(set_of(str(row['name'])) for row in rows))} in {args.out}")


if __name__ == "__main__":
    main()
