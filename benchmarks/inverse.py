"""Measure the recall and time of inverse kinematics on reachable tool poses.

    pip download --no-deps -d DIR example-robot-data hello-robot-stretch-urdf
    for f in DIR/*.whl; do unzip -qo $f -d DIR; done
    python benchmarks/inverse.py DIR [--count 4000]

Arm states are drawn at random within the joint limits, and inverse kinematics is solved for their
tool poses. Without DIR only the library's robots are measured.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from momapos.model.kinematics import Chain, bounded, build_chain, build_ik, solve_ik
from momapos.model.robots import library_names, load_robot
from momapos.model.robots.amended_urdf import Amendments
from momapos.model.urdf import Articulated
from momapos.model.urdf.reader import Mimic
from rows import commands


@dataclass(frozen=True)
class Arm:
    """An arm of a URDF."""

    urdf: str
    """Its file, relative to the folder."""
    base: str
    tool: str
    joints: tuple[str, ...]
    """Base to tool."""
    follows: tuple[tuple[str, str], ...] = ()
    """Mimic joints, each with the joint that it follows."""


@dataclass(frozen=True)
class Found:
    """Results of inverse kinematics."""

    by: str
    """Name of the solver."""
    share: float
    """Share of tool poses with a solution [-]."""
    solutions: float
    """Mean number of solutions per tool pose [-]."""
    seconds: float
    """Processor time per tool pose [s]."""


def _numbered(pattern: str, count: int, *first: str) -> tuple[str, ...]:
    return (*first, *(pattern.format(i) for i in range(1, count + 1)))


_DATA = "cmeel.prefix/share/example-robot-data/robots"
ARMS = {
    "panda": Arm(
        f"{_DATA}/panda_description/urdf/panda.urdf", "panda_link0", "panda_hand_tcp",
        _numbered("panda_joint{}", 7),
    ),
    "xarm7": Arm(
        f"{_DATA}/xarm_description/urdf/xarm7.urdf", "link_base", "link7", _numbered("joint{}", 7)
    ),
    "ur5": Arm(
        f"{_DATA}/ur_description/urdf/ur5_robot.urdf", "base_link", "ee_link",
        ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint",
         *_numbered("wrist_{}_joint", 3)),
    ),
    "tiago": Arm(
        f"{_DATA}/tiago_description/robots/tiago_no_hand.urdf", "base_footprint", "arm_tool_link",
        _numbered("arm_{}_joint", 7, "torso_lift_joint"),
    ),
    "tiago_dual, left": Arm(
        f"{_DATA}/tiago_description/robots/tiago_dual.urdf", "base_footprint",
        "arm_left_tool_link", _numbered("arm_left_{}_joint", 7, "torso_lift_joint"),
    ),
    "pr2, left": Arm(
        f"{_DATA}/pr2_description/urdf/pr2.urdf", "base_footprint", "l_gripper_tool_frame",
        ("torso_lift_joint", *(f"l_{j}_joint" for j in (
            "shoulder_pan", "shoulder_lift", "upper_arm_roll", "elbow_flex", "forearm_roll",
            "wrist_flex", "wrist_roll"))),
    ),
    "baxter, left": Arm(
        f"{_DATA}/baxter_description/urdf/baxter.urdf", "base", "left_gripper",
        tuple(f"left_{j}" for j in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")),
    ),
    "talos, left": Arm(
        f"{_DATA}/talos_data/robots/talos_reduced.urdf", "base_link", "gripper_left_base_link",
        _numbered("arm_left_{}_joint", 7, "torso_1_joint", "torso_2_joint"),
    ),
    "stretch": Arm(
        "stretch_urdf/SE3/stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf", "base_link",
        "link_grasp_center",
        ("joint_lift", "joint_arm_l3", *(f"joint_wrist_{j}" for j in ("yaw", "pitch", "roll"))),
        tuple((f"joint_arm_l{i}", "joint_arm_l3") for i in range(3)),
    ),
}  # fmt: skip


def main(folder: tyro.conf.Positional[Path | None] = None, count: int = 4_000) -> None:
    """Print a table.

    Args:
        folder: Folder of the unpacked packages.
        count: Tool poses per arm.
    """
    chains = {name: load_robot(name).chain for name in library_names()}
    if folder is not None:
        chains |= {name: chain_of(arm, folder) for name, arm in ARMS.items()}
    print("| arm | joints | degrees of freedom | solved by | found | solutions | per pose |")
    print("|" + "---|" * 7)
    for name, chain in chains.items():
        print(row(name, chain, count), flush=True)


def chain_of(arm: Arm, folder: Path) -> Chain:
    """Cut an arm out of its URDF."""
    follows = {name: Mimic(leader) for name, leader in arm.follows}
    urdf, _ = Amendments(coupled=follows).read(folder / arm.urdf)
    return build_chain(Articulated(urdf), arm.base, arm.tool, arm.joints)[0]


def row(name: str, chain: Chain, count: int) -> str:
    """Return one line of the table."""
    own = found_of(chain, count)
    cells = [
        name,
        str(chain.last),
        str(chain.size),
        own.by,
        f"{100 * own.share:.2f} %",
        f"{own.solutions:.1f}",
        f"{1e6 * own.seconds:.0f} us",
    ]
    return f"| {' | '.join(cells)} |"


def found_of(chain: Chain, count: int) -> Found:
    """Solve planning's inverse kinematics for the tool poses of random arm states."""
    lower, upper = bounded(chain)
    q = np.random.default_rng(7).uniform(lower, upper, (count, chain.size))
    Ts, ik = chain.tool_poses(q), build_ik(chain)
    solve_ik(chain, ik, Ts[:1])
    began = time.process_time()
    _, counts = solve_ik(chain, ik, Ts)
    each = (time.process_time() - began) / count
    return Found(ik.name, float((counts > 0).mean()), float(counts.mean()), each)


if __name__ == "__main__":
    commands(__doc__, main)
