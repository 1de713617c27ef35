"""Evaluate robot models: as their makers publish them, in kitchens, and their self-collisions.

    python benchmarks/robots.py check SITE [--get] [--set development|test] [--only NAME ...]
        [--table] [--place 2] [--out FOLDER]
    python benchmarks/robots.py makers SITE [--only NAME ...]
    python benchmarks/robots.py openings FILE [--scenes Kitchen.json ...] [--most 2] [--run 2]
    python benchmarks/robots.py self-collision [ROBOT ...]

A hash of a robot's name puts it into one of two sets: `development` may be examined, `test` is only
counted.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from inverse import found_of
from momapos.apps.bench.articulated import SETS
from momapos.core import USER_CACHE, MomaposError
from momapos.model.collision import contacts, decided_by_hulls
from momapos.model.records import PlacementPlan, PoseStatus, ReachScorer
from momapos.model.robots import Robot, library_names, load_arms, load_robot
from momapos.model.robots.load_limits import sample_states, touches
from momapos.planning import plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.grasps.hand_boxes import empty_handed
from momapos.planning.placement import PlaceConfig
from momapos.planning.reachability import ReachMap, encode, evaluate, load_reach
from momapos.workflows import run_plan
from objects import Subset
from placement import CONFIG, SCENES, machine, scene_of
from rows import child, commands

SEEN = ("allegro_hand", "baxter", "frankie", "panda", "pr2", "tiago_no_hand", "ur10")
"""Robots that the hash puts into the test set but that were examined, or whose results led to a
change; they count as development set."""
TABLE = (
    "pr2", "fetch_maniskill", "tiago_no_hand", "tiago_pro", "ur10", "panda", "frankie",
    "mobile_panda_dual", "stretch4", "stretch_re2v0", "stretch_re1v0", "mobile_panda_single",
    "kinova", "iiwa14", "xarm7", "xarm7_ability", "vega", "vega_1u",
)  # fmt: skip
"""Robots of the table of openings in docs/results/robots.md."""
PACKAGES = (
    "example-robot-data", "hello-robot-stretch-urdf", "hello-robot-stretch4-urdf", "dexmate-urdf",
    "armar", "mani-skill", "rtb-data", "airo-models",
)  # fmt: skip
COMMAND = "from momapos.apps.cli.main import entry; entry()"
LIMIT, LIMIT_OPENINGS = 180, 900
"""Limits of processor time for a command, and for all openings of a robot [s]."""
BOX = "0.6x0.5x0.7"


@dataclass(frozen=True)
class Model:
    """A robot of a package."""

    name: str
    folder: str
    """Path relative to the folder with all packages."""
    urdf: str
    """The checked file, relative to the folder."""
    kind: str = "mobile"
    """mobile: a mobile manipulator; arm: an arm without a base; other: neither."""
    words: tuple[str, ...] = ()
    """Further arguments of the command; {folder} stands for the folder."""

    @property
    def subset(self) -> str:
        """Return its set: development or test."""
        if self.name in SEEN:
            return SETS[0]
        return SETS[hashlib.sha256(self.name.encode()).digest()[0] % 2]


@dataclass(frozen=True)
class Outcome:
    """The result of a command."""

    status: int
    seconds: float
    """Processor time [s]."""
    wall: float
    """Wall time [s]."""
    memory: float
    """Peak memory [GB]."""
    last: str
    """Its last line of output."""


EXAMPLE = "cmeel.prefix/share/example-robot-data/robots"
STRETCH, DESCRIPTION, DEXMATE = "stretch_urdf", "stretch_description", "dexmate_urdf/robots"
ALLEGRO, ANYMAL = "allegro_hand_description", "anymal_b_simple_description"
MANI, RTB = "mani_skill/assets/robots", "rtbdata/xacro"
MODELS = (
    # Hello Robot
    Model("stretch_re1v0", f"{STRETCH}/RE1V0", f"{DESCRIPTION}_RE1V0_tool_stretch_dex_wrist.urdf"),
    Model("stretch_re2v0", f"{STRETCH}/RE2V0", f"{DESCRIPTION}_RE2V0_tool_stretch_dex_wrist.urdf"),
    Model("stretch_se3", f"{STRETCH}/SE3", f"{DESCRIPTION}_SE3_eoa_wrist_dw3_tool_sg3.urdf"),
    Model("stretch4", "stretch4_urdf", "SE4.xacro", words=(
        "--xacro-arg", "batch=francis", "--xacro-arg", "pkg_path={folder}",
        "--xacro-arg", "tool=eoa_wrist_dw4_tool_sg4",
    )),
    # PAL, Willow Garage, Fetch
    Model("tiago", EXAMPLE, "tiago_description/robots/tiago.urdf"),
    Model("tiago_no_hand", EXAMPLE, "tiago_description/robots/tiago_no_hand.urdf"),
    Model("tiago_dual", EXAMPLE, "tiago_description/robots/tiago_dual.urdf"),
    Model("tiago_pro", EXAMPLE, "tiago_pro_description/robots/tiago_pro.urdf"),
    Model("pr2", EXAMPLE, "pr2_description/urdf/pr2.urdf"),
    Model("fetch_maniskill", MANI, "fetch/fetch.urdf"),
    # a Panda on a base
    Model("mobile_panda_single", MANI, "panda/mobile_panda_single_arm.urdf"),
    Model("mobile_panda_dual", MANI, "panda/mobile_panda_dual_arm.urdf"),
    Model("frankie", RTB, "qut_frankie_description/robots/frankie_arm_hand.urdf.xacro"),
    Model("frankie_omni", RTB, "qut_frankie_description/robots/frankieOmni_arm_hand.urdf.xacro"),
    # humanoids on wheels, and one on a pedestal
    Model("vega", DEXMATE, "humanoid/vega_1/vega.urdf"),
    Model("vega_1u", DEXMATE, "humanoid/vega_1u/vega_1u.urdf"),
    Model("vega_1p", DEXMATE, "humanoid/vega_1p/vega_1p_f5d6.urdf"),
    Model("armar6", "armar/description", "urdf/armar6.urdf"),
    Model("centauro", EXAMPLE, "centauro_description/urdf/centauro.urdf"),
    Model("baxter", EXAMPLE, "baxter_description/urdf/baxter.urdf"),
    # arms without a base
    Model("panda", EXAMPLE, "panda_description/urdf/panda.urdf", "arm"),
    Model("ur5", EXAMPLE, "ur_description/urdf/ur5_robot.urdf", "arm"),
    Model("ur10", EXAMPLE, "ur_description/urdf/ur10_robot.urdf", "arm"),
    Model("kinova", EXAMPLE, "kinova_description/robots/kinova.urdf", "arm"),
    Model("z1", EXAMPLE, "z1_description/urdf/z1.urdf", "arm"),
    Model("xarm7", MANI, "xarm7/xarm7.urdf", "arm"),
    Model("xarm7_ability", MANI, "xarm7/xarm7_ability_right_hand.urdf", "arm"),
    Model("xarm6", "rtbdata/armer_xarm/data/xacro", "robots/xarm6/xarm6.xacro", "arm"),
    Model("so101", EXAMPLE, "so_arm_description/urdf/so101.urdf", "arm"),
    Model("iiwa14", RTB, "kuka_description/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf", "arm"),
    Model("vx300s", RTB, "trossen_descriptions/urdf/vx300s.urdf.xacro", "arm"),
    Model("puma560", RTB, "unimation_puma560_description/urdf/puma560_robot.urdf.xacro", "arm"),
    Model("talos_arm", EXAMPLE, "talos_data/robots/talos_left_arm.urdf", "arm"),
    Model("ur5e_airo", "airo_models/arms/ur5e", "ur5e.urdf", "arm"),
    # neither
    Model("allegro_hand", EXAMPLE, f"{ALLEGRO}/urdf/allegro_right_hand.urdf", "other"),
    Model("inspire_hand", MANI, "inspire_hand/RH56DFX-2LR/urdf/inspire_hand_right.urdf", "other"),
    Model("f5d6_hand", DEXMATE, "hands/f5d6_hand/f5d6_right.urdf", "other"),
    Model("anymal", EXAMPLE, f"{ANYMAL}/robots/anymal.urdf", "other"),
    Model("hyq", EXAMPLE, "hyq_description/robots/hyq_no_sensors.urdf", "other"),
    Model("go2", EXAMPLE, "go2_description/urdf/go2.urdf", "other"),
    Model("a1", EXAMPLE, "a1_description/urdf/a1.urdf", "other"),
    Model("iris", EXAMPLE, "iris_description/robots/iris.urdf", "other"),
    Model("ridgeback", RTB, "clearpath_ridgeback_description/urdf/ridgeback.urdf.xacro", "other"),
    Model("talos", EXAMPLE, "talos_data/robots/talos_full_v2.urdf", "other"),
    Model("g1", EXAMPLE, "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", "other"),
    Model("anymal_kinova", EXAMPLE, f"{ANYMAL}/robots/anymal-kinova.urdf", "other"),
    Model("b1_z1", EXAMPLE, "b1_description/urdf/b1-z1.urdf", "other"),
)  # fmt: skip


@dataclass(frozen=True)
class Maker(Model):
    """A file of a maker's repository, with what the maker says about the robot."""

    drive: str = ""
    """Drive, for mobile manipulators."""
    joints: tuple[int, ...] = ()
    """Joints of each arm, with a lift."""
    opening: tuple[float, float] | None = None
    """Bounds of the opening of the first hand [m]; None for tools that do not close."""
    says: str = ""
    """Expression that the output must match: a reason, or a fault of the file."""
    environment: tuple[str, ...] = ()
    """Environment variables, as NAME=VALUE."""


def _package(name: str, folder: str) -> tuple[str, str]:
    return ("--package", f"{name}={{site}}/{folder}")


def _args(*words: str) -> tuple[str, ...]:
    return tuple(part for word in words for part in ("--xacro-arg", word))


LOCOBOT = "interbotix_ros_rovers/interbotix_ros_xslocobots/interbotix_xslocobot_descriptions"
UR = _package("ur_description", "universal_robot/ur_description")
MOVO = ("BODY", "KINOVA_ARM", "TWO_KINOVA_ARMS", "KINOVA_ARM_6DOF", "RIGHT_KG2_GRIPPER",
        "LEFT_KG2_GRIPPER")  # fmt: skip
NEO = _package("neo_simulation", "neo_simulation")
XARM = ("xarm_ros2/xarm_description", "urdf/xarm_device.urdf.xacro", "arm")
ROBOTNIK = (*UR, *_package("robotnik_sensors", "robotnik_sensors"))
MAKERS = (
    Maker("RB-Y1 A", "rby1-sdk/models/rby1a", "urdf/model_v1.0.urdf", "other", says="visual-hulls"),
    Maker("RB-Y1 M", "rby1-sdk/models/rby1m", "urdf/model_v1.0.urdf", "other", says="visual-hulls"),
    Maker("Fetch", "fetch_ros/fetch_description", "robots/fetch.urdf", drive="differential",
          joints=(8,), opening=(0.09, 0.11)),
    Maker("Freight", "fetch_ros/fetch_description", "robots/freight.urdf", "other", says="arm"),
    Maker("youBot", "youbot_description", "robots/youbot.urdf.xacro", drive="omni", joints=(5,),
          opening=(0.02, 0.07)),
    Maker("youBot, two arms", "youbot_description", "robots/youbot_dual_arm.urdf.xacro",
          drive="omni", joints=(5, 5), opening=(0.02, 0.07)),
    Maker("LoCoBot wx250s", LOCOBOT, "urdf/locobot.urdf.xacro", words=_args(
        "robot_name=locobot", "robot_model=locobot_wx250s", "arm_model=mobile_wx250s",
        "base_model=kobuki"), drive="differential", joints=(6,), opening=(0.045, 0.08)),
    Maker("LoCoBot wx200", LOCOBOT, "urdf/locobot.urdf.xacro", words=_args(
        "robot_name=locobot", "robot_model=locobot_wx200", "arm_model=mobile_wx200",
        "base_model=kobuki"), drive="differential", joints=(5,), opening=(0.045, 0.08)),
    Maker("RB-Kairos UR5", "rbkairos_common/rbkairos_description", "robots/rbkairos_ur5.urdf.xacro",
          words=(*ROBOTNIK, *_package("summit_xl_description",
                                      "summit_xl_common/summit_xl_description")),
          drive="omni", joints=(6,)),
    Maker("RB-Vogui UR5", "rbvogui_common/rbvogui_description",
          "robots/rbvogui_std_ur5.urdf.xacro", words=ROBOTNIK, drive="omni", joints=(6,)),
    Maker("TurtleBot3 with OpenMANIPULATOR-X",
          "turtlebot3_manipulation/turtlebot3_manipulation_description",
          "urdf/turtlebot3_manipulation.urdf.xacro", drive="differential", joints=(4,),
          opening=(0.03, 0.09)),
    Maker("PR2", "pr2_common/pr2_description", "robots/pr2.urdf.xacro", drive="omni",
          joints=(8, 8), opening=(0.07, 0.1)),
    Maker("HSR", "hsr_description", "robots/hsrb4s.urdf", "other",
          words=_package("hsr_meshes", "hsr_meshes"), says=r"torso\.std"),
    Maker("FR3", "franka_description", "robots/fr3/fr3.urdf.xacro", "arm", joints=(7,),
          opening=(0.075, 0.085)),
    Maker("FR3 Duo", "franka_description", "robots/fr3_duo/fr3_duo.urdf.xacro", joints=(7, 7),
          opening=(0.075, 0.085), says="there are no wheels"),
    Maker("xArm7 with gripper", *XARM, words=_args("add_gripper=true", "dof=7"), joints=(7,),
          opening=(0.075, 0.095)),
    Maker("xArm6 with vacuum gripper", *XARM, words=_args("add_vacuum_gripper=true", "dof=6"),
          joints=(6,), says="suction"),
    Maker("Lite6", *XARM, words=_args("add_gripper=true", "dof=6", "robot_type=lite"), joints=(6,),
          says="holds nothing|nothing to hold"),
    Maker("OpenArm, two arms", "openarm_description", "urdf/robot/v10.urdf.xacro", "arm",
          words=_args("bimanual=true"), joints=(7, 7)),
    Maker("SO-100", "SO-ARM100/Simulation/SO100", "so100.urdf", "arm", joints=(5,),
          says="visual-hulls"),
    Maker("OpenMANIPULATOR-X", "open_manipulator/open_manipulator_description",
          "urdf/open_manipulator_x/open_manipulator_x.urdf.xacro", "arm", joints=(4,),
          words=_package("open_manipulator_bringup", "open_manipulator/open_manipulator_bringup"),
          opening=(0.03, 0.09)),
    Maker("UR5e", "Universal_Robots_ROS2_Description", "urdf/ur.urdf.xacro", "arm", joints=(6,),
          words=(*_package("ur_description", "Universal_Robots_ROS2_Description"),
                 *_args("name=ur5e", "ur_type=ur5e")), says="holds nothing|nothing to hold"),
    Maker("MPO-700", "neo_mpo_700/robot_model", "mpo_700/mpo_700.urdf.xacro", "other",
          words=_package("neo_mpo_700-2", "neo_mpo_700"), says="arm"),
    Maker("LIMO", "limo_ros/limo_description", "urdf/limo_four_diff.xacro", "other",
          words=_args("robot_namespace=limo"), says="arm"),
    Maker("A200", "clearpath_common/clearpath_platform_description", "urdf/a200/a200.urdf.xacro",
          "other", says="robot|link"),
    Maker("MOVO", "kinova-movo/movo_common/movo_description", "urdf/movo.urdf.xacro",
          drive="omni", joints=(7, 7), environment=tuple(f"MOVO_HAS_{part}=true" for part in MOVO)),
    Maker("MM-400", "neo_simulation/robots", "mm_400/mm_400.urdf.xacro", words=NEO,
          drive="differential", joints=(7,)),
    Maker("MMO-500", "neo_simulation/robots", "mmo_500/mmo_500.urdf.xacro", words=NEO,
          drive="omni", joints=(6,)),
    Maker("MMO-700", "neo_simulation/robots", "mmo_700/mmo_700.urdf.xacro", words=NEO,
          drive="omni", joints=(6,)),
    Maker("Gen3 lite", "ros2_kortex/kortex_description", "robots/gen3_lite.urdf", "arm",
          joints=(6,), opening=(0.05, 0.11), says="right_finger_tip_joint"),
    Maker("Piper", "agilex_open_class/piper/piper_description", "urdf/piper_description.urdf",
          "arm", joints=(6,), says="joint[78]"),
)  # fmt: skip
"""Files that nobody had tuned to. The numbers are of the makers' data sheets, the openings with the
distance by which tips bow."""


def makers(site: Path, only: tuple[str, ...] = ()) -> None:
    """Check files of makers' repositories, unmodified, against what the makers say.

    Args:
        site: Folder with the repositories by name, as `git clone` makes them.
        only: Only these robots.
    """
    print("| robot | status | drive | joints | opening [m] | self-test | right |")
    print("|---|---|---|---|---|---|---|")
    chosen = [maker for maker in MAKERS if not only or maker.name in only]
    right = 0
    for maker in chosen:
        with tempfile.TemporaryDirectory(prefix="makers-") as folder:
            statuses, text, facts = _read(maker, site, Path(folder) / "robot.toml")
        arms = list(facts.get("arms", {}).values()) or [facts] * bool(facts)
        drive, opening = facts.get("drive", ""), facts.get("opening", np.nan)
        joints = tuple(len(arm["joints"]) for arm in arms)
        wrong = [
            what
            for what, fits in (
                ("status", statuses == {"mobile": [0], "arm": [2, 0], "other": [2]}[maker.kind]),
                ("drive", not maker.drive or drive == maker.drive),
                ("joints", not maker.joints or joints == maker.joints),
                ("opening", maker.opening is None
                 or maker.opening[0] <= opening <= maker.opening[1]),
                ("words", re.search(maker.says, text) is not None),
            )
            if not fits
        ]  # fmt: skip
        right += not wrong
        tests = "; ".join(
            f"{test['arm']} {test['name']}: {test['words']}".strip()
            for test in facts.get("self_test", [])
            if test["passed"] is not True
        )
        last = "passed" if facts else text.splitlines()[-1][:160]
        print(
            f"| {maker.name} | {statuses} | {drive} | {joints} | {opening:.3f} | "
            f"{tests or last} | {'yes' if not wrong else 'no: ' + ', '.join(wrong)} |",
            flush=True,
        )
    print(f"\n{right} of {len(chosen)} right")


def _read(maker: Maker, site: Path, out: Path) -> tuple[list[int], str, dict[str, Any]]:
    """Check a file, then an arm on a box; return the statuses, all output, and the facts."""
    words = [word.format(site=site, folder=site / maker.folder) for word in maker.words]
    file = str(site / maker.folder / maker.urdf)
    environment = {**os.environ, **dict(pair.split("=") for pair in maker.environment)}
    statuses, text, facts = [], "", dict[str, Any]()
    for more in ([], ["--on-box", BOX]) if maker.kind == "arm" else ([],):
        ran = subprocess.run(
            [sys.executable, "-c", COMMAND, "robot", "check", file, "--out", str(out), "--json",
             *words, *more],
            capture_output=True, text=True, env=environment, timeout=LIMIT_OPENINGS, check=False,
        )  # fmt: skip
        statuses.append(ran.returncode)
        text += ran.stdout + ran.stderr
        facts = json.loads(ran.stdout) if ran.returncode == 0 else {}
    return statuses, text, facts


def process(words: list[str], limit: int = LIMIT) -> Outcome:
    """Run Python in a separate process."""
    with tempfile.TemporaryFile("w+") as out:
        status, wall, spent, memory = child(
            [sys.executable, *words], stdout=out, stderr=subprocess.STDOUT,
            preexec_fn=partial(resource.setrlimit, resource.RLIMIT_CPU, (limit, limit)),
        )  # fmt: skip
        out.seek(0)
        lines = [line.rstrip() for line in out if line.strip()]
    return Outcome(status, spent, wall, memory, lines[-1] if lines else "")


def checked(model: Model, site: Path, folder: Path) -> list[tuple[str, Outcome]]:
    """Check a robot, with further commands depending on its kind; return names and results."""
    urdf, out = site / model.folder / model.urdf, folder / f"{model.name}.toml"
    more = [word.format(folder=site / model.folder) for word in model.words]
    words = ["-c", COMMAND, "robot", "check", str(urdf), "--out", str(out), *more]
    done = [("check", process(words))]
    if model.kind == "arm" and done[0][1].status == 2:
        done.append(("on a box", process([*words, "--on-box", BOX])))
    return done


def measured(model: Model, site: Path, place: int, out: Path | None) -> list[tuple[str, Outcome]]:
    """Check a robot and plan openings, or read stored results."""
    kept = None if out is None else out / f"{model.name}.json"
    if kept is not None and kept.is_file():
        return [(what, Outcome(**it)) for what, it in json.loads(kept.read_text())]
    with tempfile.TemporaryDirectory(prefix="robots-") as folder:
        done = checked(model, site, Path(folder))
        if place and understood(model, done) and done[-1][1].status == 0:
            file = str(Path(folder) / f"{model.name}.toml")
            words = [__file__, "openings", file, "--most", str(place)]
            done.append(("openings", process(words, LIMIT_OPENINGS)))
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps([(what, asdict(it)) for what, it in done]))
    return done


def understood(model: Model, done: list[tuple[str, Outcome]]) -> bool:
    """Return whether the commands gave the required result for this kind of robot."""
    statuses = [outcome.status for what, outcome in done if what != "openings"]
    return statuses == {"mobile": [0], "arm": [2, 0], "other": [2]}[model.kind]


def openings_row(model: Model, checks: float, did: Outcome) -> str:
    """Format the results of `openings` as a row; `checks` is the time of checking [s]."""
    if did.status != 0:
        return f"| {model.name} | {model.subset} | ended with status {did.status} |"
    found = json.loads(did.last)
    answers, runs = found["answers"], found["runs"]
    count = {name: sum(a["status"] == name for a in answers) for name in ("solved", "timeout")}
    seconds = [a["seconds"] for a in answers if "seconds" in a]
    share = [
        f"{100 * found[key]:.1f} %" if key in found else "-"
        for key in ("misses", "false_positives")
    ]
    grid = count["solved"] + sum(a.get("grid") == "solved" for a in answers)
    open_ = sum(a.get("grid") == "timeout" for a in answers)
    cells = [
        model.name, model.subset, found["joints"], "yes" if found["holds"] else "no",
        f"{100 * found['found']:.2f} %",
        f"{checks + found['first']:.0f}", f"{found['built']:.0f} ({found['built_wall']:.0f})",
        f"{found['megabytes']:.1f}" if "megabytes" in found else "-", *share,
        f"{count['solved']} of {len(answers)}", f"{grid}{f' to {grid + open_}' if open_ else ''}",
        len(answers) - sum(count.values()),
        count["timeout"], f"{np.median(seconds):.1f}" if seconds else "-",
        f"{sum(runs)} of {len(runs)}",
    ]  # fmt: skip
    return f"| {' | '.join(map(str, cells))} |"


def check(
    site: Path, get: bool = False, subset: Subset = None, only: tuple[str, ...] = (),
    table: bool = False, place: int = 0, out: Path | None = None,
) -> None:  # fmt: skip
    """Check that `robot check` suffices to use manufacturers' robot models.

    These files stay unchanged. A mobile manipulator must get a robot file; an arm without a base
    must get a reason and then, with `--on-box`, a robot file; other models must get a reason.

    Args:
        site: Packages with the manufacturers' files.
        get: Install the packages if SITE is missing (1.2 GB).
        subset: Only the robots of one set.
        only: Only these robots.
        table: Only the robots of the table of openings in docs/results/robots.md.
        place: Number of openings that each robot with a file plans in each of five kitchens.
        out: Folder of results, which are reused.
    """
    if get and not site.exists():
        install = [sys.executable, "-m", "pip", "install", "--no-deps", "--target", str(site)]
        subprocess.run([*install, *PACKAGES], check=True)
    wanted = {*only, *(TABLE if table else ())}
    models = [
        model
        for model in MODELS
        if subset in (None, model.subset) and (not wanted or model.name in wanted)
    ]
    print(machine())
    print("| robot | set | what | status | processor [s] | wall [s] | memory [GB] | last line |")
    print("|---|---|---|---|---|---|---|---|")
    right, opened = 0, []
    for model in models:
        done = measured(model, site, place, out)
        right += understood(model, done)
        for what, it in done:
            # Messages of the test set must not be examined.
            last = it.last[:100] if model.subset == SETS[0] else ""
            print(
                f"| {model.name} | {model.subset} | {what} | {it.status} | {it.seconds:.1f} | "
                f"{it.wall:.1f} | {it.memory:.2f} | {last} |",
                flush=True,
            )
        if done[-1][0] == "openings":
            checks = sum(it.seconds for _, it in done[:-1])
            opened.append(openings_row(model, checks, done[-1][1]))
    print(f"\n{right} of {len(models)} as they must be")
    if opened:
        print(
            "\n| robot | set | degrees of freedom | has fingers | found | first answer [s] "
            "| map [s] (wall) | map [MB] | misses | false positives | solved | by the grid | no "
            "| out of time | median [s] | executed |"
        )
        print("|" + "---|" * 16, *opened, sep="\n")


POSES, DRAWN = 12_000, 4_000
"""Number of tool poses near reach that evaluate a map, and of tool poses of random arm states that
evaluate inverse kinematics [-]."""


def openings(
    file: Path, scenes: tuple[str, ...] = SCENES, most: int = 2, run: int = 2,
    timeout: float = 30.0, grid: float = 30.0, arm: str | None = None,
) -> None:  # fmt: skip
    """Evaluate a robot file in the simulator's kitchens: map, answers, and execution in physics.

    Prints one JSON object, including the recall of planning's inverse kinematics on tool poses of
    random arm states. Some openings of each kitchen, spread over it, are planned. Unsolved ones are
    searched by a grid of 5 cm and 10 degrees with more time.

    Args:
        file: Robot file.
        scenes: Kitchens.
        most: Number of openings per scene.
        run: Number of executed answers.
        timeout: Time limit per opening [s].
        grid: Time limit of the grid [s].
        arm: Arm of a robot with several; the first by default.
    """
    start, wall = time.process_time(), time.monotonic()
    robot = load_robot(file, arm=arm)
    began, began_wall = time.process_time(), time.monotonic()
    reach = load_reach(robot)
    built, built_wall = time.process_time() - began, time.monotonic() - began_wall
    found: dict[str, Any] = {"robot": robot.name, "joints": robot.chain.size}
    found |= {"built": built, "built_wall": built_wall, "holds": not empty_handed(robot)}
    rows, solved = [], []
    for name in scenes:
        doors = openable(scene_of(name, USER_CACHE))
        for part in doors[:: max(1, len(doors) // most)][:most]:
            row, plan = answered(robot, reach, name, part, timeout)
            first = {"first": time.process_time() - start, "wall": time.monotonic() - wall}
            found = first | found
            if row["status"] in ("infeasible", "timeout"):
                row["grid"] = by_grid(robot, reach, name, part, grid)
            rows.append(row)
            print(row, file=sys.stderr, flush=True)
            if plan is not None and plan.status == "solved":
                solved.append((name, plan))
    found |= of_map(reach, robot) | {"found": found_of(robot.chain, DRAWN).share}
    found["answers"] = rows
    found["runs"] = [
        run_plan(plan, scene_of(name), robot, reach).success for name, plan in solved[:run]
    ]
    print(json.dumps(found))


def of_map(reach: ReachScorer, robot: Robot) -> dict[str, float]:
    """Return misses and false positives of the map near reach [-], and its size [MB].

    Empty without a map. The reference is inverse kinematics with redundant joints locked at 33
    values, since the 9 values of planning miss solutions.
    """
    if not isinstance(reach, ReachMap):
        return {}
    near = evaluate(reach, robot, np.random.default_rng(0), POSES, robot.finer.ik, near=True)
    size = len(encode(reach)) / 1e6
    return {"misses": near.misses, "false_positives": near.false_positives, "megabytes": size}


def answered(
    robot: Robot, reach: ReachScorer, scene: str, part: tuple[str, str], timeout: float
) -> tuple[dict[str, Any], PlacementPlan | None]:
    """Plan one opening; return the row with the processor time, and the plan."""
    row: dict[str, Any] = {"task": f"{Path(scene).stem} {'/'.join(part)}"}
    room = scene_of(scene, USER_CACHE)
    began = time.process_time()
    try:
        task = make_task(room, "open", *part)
        config = replace(CONFIG, timeout=timeout)
        plan = plan_base_placement(room, robot, task, reach, config=config).plan
    except MomaposError as error:
        return row | {"status": "refused", "why": str(error)[:100]}, None
    row |= {"status": plan.status, "seconds": time.process_time() - began, "to": plan.feasible_to}
    return row | {"why": "" if plan.status == "solved" else why_not(plan)[:100]}, plan


def why_not(plan: PlacementPlan) -> str:
    """Return what the base pose that came nearest lacks, or else the most frequent reason."""
    if plan.candidates.nearest is not None:
        return plan.candidates.nearest.reason
    return max(plan.candidates.rejections.items(), key=lambda one: one[1], default=("", 0))[0]


def by_grid(
    robot: Robot, reach: ReachScorer, scene: str, part: tuple[str, str], timeout: float
) -> str:
    """Return the status of an opening from the whole grid of base poses."""
    room = scene_of(scene, USER_CACHE)
    config = replace(CONFIG, timeout=timeout, place=PlaceConfig(method="exhaustive"))
    task = make_task(room, "open", *part)
    answer = plan_base_placement(room, robot, task, reach, config=config)
    passed = (PoseStatus.FEASIBLE, PoseStatus.PATH_FOUND)
    found = any(one.status in passed for one in answer.search.counts())
    return "solved" if found else str(answer.plan.status)


REPEATS = 5


def row(robot: Robot) -> str:
    """Return one line of the table."""
    chain, spheres = robot.chain, robot.spheres
    q = sample_states(chain, np.random.default_rng(5))
    found = contacts(chain, spheres, q)
    decided = touches(chain, spheres, q).mean()
    begin = time.process_time()
    for _ in range(REPEATS):
        touches(chain, spheres, q)
    each = (time.process_time() - begin) / REPEATS / len(q)
    shares = (found.by_hulls.any(1).mean(), found.by_spheres.any(1).mean(), decided)
    name = " ".join(filter(None, (robot.name, robot.arm)))
    percent = " | ".join(f"{100 * share:.1f}" for share in shares)
    return f"| {name} | {percent} | {len(decided_by_hulls(spheres))} | {1e6 * each:.1f} |"


def self_collision(robots: tyro.conf.Positional[tuple[str, ...]] = ()) -> None:
    """Count self-collisions of random arm states by hulls, by spheres, and as planning decides.

    Processor time of one thread.

    Args:
        robots: Robots of the library; all by default.
    """
    print(
        "| states blocked [%] | by hulls | by spheres only | as in planning | pairs left to hulls |"
    )
    for name in robots or library_names():
        for robot in load_arms(name):
            print(row(robot))


if __name__ == "__main__":
    commands(__doc__, check, makers, openings, self_collision)
