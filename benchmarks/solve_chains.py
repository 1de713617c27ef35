"""Open the doors and drawers of built-in kitchens from scans, by our chain and by the paper's.

    python benchmarks/solve_chains.py [--kitchens kitchen_small ...] [--chains ours views paper]
        [--robot segway_ur5e] [--frames 60] [--folder bench_out/beliefs]

Each kitchen is rendered as a walk with an RGB-D camera. Every opening that can be planned in the
kitchen itself is answered by `momapos solve SCAN open OBJECT/JOINT --world KITCHEN`, and the plan
is executed in the true kitchen. The chains differ by these options:

    ours     none: all images vote for the front, our placement
    views    --set scan.views=first: section III-B of the paper, our placement
    paper    --method paper: sections III-A to III-D of the paper

"Found" counts parts of which the scene has one of the same kind with its handle within 15 cm. Each
part that is not found counts as not opened. "Below one half" counts plans with the status solved
for a joint whose probability in the scene is smaller; there must be none.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
from dataclasses import dataclass, replace
from pathlib import Path

from beliefs import HALF, scan_of
from momapos.apps.cli.main import main as momapos
from momapos.core import MomaposError, default_cache_dir
from momapos.core.geometry import invert
from momapos.model.robots import load_robot
from momapos.model.scene import Scene, load_scene
from momapos.perception import ScanConfig, default_tools
from momapos.perception.recordings import read_scan
from momapos.perception.views import ViewMethod
from momapos.planning import plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.reachability import load_reach_map
from momapos.workflows import scan_to_scene
from scan import match

CHAINS: dict[str, tuple[ViewMethod, tuple[str, ...]]] = {
    "ours": ("voting", ()),
    "views": ("first", ("--set", "scan.views=first")),
    "paper": ("first", ("--method", "paper")),
}
"""Choice of views, and options of `momapos solve`."""
Part = tuple[str, str]
"""Object and joint."""


@dataclass(frozen=True)
class Opening:
    """The answer for one part of a kitchen."""

    part: Part
    found: str = ""
    """The part in the scan; "" if there is none."""
    status: str = "not found"
    opened: bool = False
    probability: float = 1.0
    """Probability of the part's most probable joint [-]."""
    reason: str = ""


def solvable(kitchen: Scene, robot_name: str) -> list[Part]:
    """Return the parts that can be opened in a kitchen whose joints are known."""
    robot = load_robot(robot_name)
    reach, parts = load_reach_map(robot, default_cache_dir(), None), []
    for part in openable(kitchen):
        with contextlib.suppress(MomaposError):
            answer = plan_base_placement(kitchen, robot, make_task(kitchen, "open", *part), reach)
            parts += [part] if answer.plan.status == "solved" else []
    return parts


def found_in(kitchen: Scene, scan: Path, out: Path, views: ViewMethod) -> dict[Part, Part]:
    """Return the parts of a kitchen that a chain finds in its scan."""
    made = scan_to_scene(read_scan(scan), out, default_tools(), config=ScanConfig(views=views))
    return match(kitchen, load_scene(out), invert(made.T_scene_scan))


def solve(
    scan: Path, kitchen: str, found: Part, robot: str, out: Path, words: tuple[str, ...]
) -> Opening:
    """Run the command for one part of the scan."""
    name = "/".join(found)
    command = ["solve", str(scan), "open", name, "--robot", robot, "--world", kitchen, *words]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()) as errors:
        momapos([*command, "--out", str(out), "--no-pictures", "--json"])
    if not printed.getvalue():
        return Opening(found, name, "refused", reason=errors.getvalue().strip())
    record = json.loads(printed.getvalue())
    beliefs = load_scene(out / "scene.json").object(found[0]).hypotheses
    first = beliefs[found[1]][0].probability if found[1] in beliefs else 1.0
    done = record["done"] is True
    return Opening(found, name, record["status"], done, first, record["reason"])


def summary(openings: list[Opening]) -> str:
    """Return one line of results."""
    solved = [one for one in openings if one.status == "solved"]
    return (
        f"{sum(one.found != '' for one in openings)} of {len(openings)} found, "
        f"{len(solved)} solved, {sum(one.status == 'assumed' for one in openings)} assumed, "
        f"{sum(one.opened for one in openings)} opened; "
        f"solved below one half: {sum(one.probability < HALF for one in solved)}"
    )


def main() -> None:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kitchens", nargs="+", default=("kitchen_small", "kitchen_island"))
    parser.add_argument("--chains", nargs="+", default=tuple(CHAINS), choices=tuple(CHAINS))
    parser.add_argument("--robot", default="segway_ur5e")
    parser.add_argument("--frames", type=int, default=60, help="number of frames of new scans")
    parser.add_argument("--folder", type=Path, default=Path("bench_out/beliefs"))
    args = parser.parse_args()
    results: dict[str, list[Opening]] = {chain: [] for chain in args.chains}
    for name in args.kitchens:
        kitchen, scan = load_scene(name), scan_of(name, args.folder, args.frames)
        parts = solvable(kitchen, args.robot)
        for chain in args.chains:
            views, words = CHAINS[chain]
            home = args.folder / name / chain
            found, openings = found_in(kitchen, scan, home / "whole" / "scene.json", views), []
            for part in parts:
                one = Opening(part)
                if part in found:
                    answer = solve(scan, name, found[part], args.robot, home / "solved", words)
                    one = replace(answer, part=part)
                openings.append(one)
                done = "opened" if one.opened else one.reason
                print(f"  {chain} {'/'.join(part)}: {one.found} {one.status} {done}", flush=True)
            print(f"{name}, {chain}: {summary(openings)}", flush=True)
            results[chain] += openings
    for chain, openings in results.items():
        print(f"all, {chain}: {summary(openings)}")


if __name__ == "__main__":
    main()
