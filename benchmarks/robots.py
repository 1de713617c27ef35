"""Check that `robot check` suffices to use manufacturers' robot models.

    python benchmarks/robots.py SITE [--get] [--set development|test] [--only NAME ...] [--table] \\
        [--place 2] [--out FOLDER]

SITE holds the packages with the manufacturers' files; `--get` installs them there (1.2 GB). These
files stay unchanged. A mobile manipulator must get a robot file; an arm without a base must get a
reason and then, with `--on-box`, a robot file; other models must get a reason. `--place` sets the
number of openings that each robot with a file plans in each of five kitchens (`robot_openings.py`),
counted in a second table; `--table` selects the robots of that table in docs/results/robots.md.
With `--out` the results are stored in a folder and reused. A hash of the robot's name puts it into
one of two sets: `development` may be examined, `test` is only counted.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from placement import machine

SETS = ("development", "test")
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
OPENINGS = Path(__file__).with_name("robot_openings.py")
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


def run(words: list[str], limit: int = LIMIT) -> Outcome:
    """Run Python in a separate process."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    with tempfile.TemporaryFile("w+") as out:
        child = subprocess.Popen(
            [sys.executable, *words],
            stdout=out,
            stderr=subprocess.STDOUT,
            preexec_fn=partial(_limit, limit),
        )
        most, status = 0.0, None
        while status is None:
            try:
                status = child.wait(0.2)
            except subprocess.TimeoutExpired:
                most = max(most, _resident(child.pid))
        out.seek(0)
        lines = [line.rstrip() for line in out if line.strip()]
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Outcome(status, used, time.monotonic() - began, most, lines[-1] if lines else "")


def _limit(seconds: int) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))


def _resident(pid: int) -> float:
    """Return the peak memory of a running process [GB]; 0 if unknown."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return max((int(x.split()[1]) / 1e6 for x in lines if x.startswith("VmHWM")), default=0.0)


def checked(model: Model, site: Path, folder: Path) -> list[tuple[str, Outcome]]:
    """Check a robot, with further commands depending on its kind; return names and results."""
    urdf, out = site / model.folder / model.urdf, folder / f"{model.name}.toml"
    more = [word.format(folder=site / model.folder) for word in model.words]
    words = ["-c", COMMAND, "robot", "check", str(urdf), "--out", str(out), *more]
    done = [("check", run(words))]
    if model.kind == "arm" and done[0][1].status == 2:
        done.append(("on a box", run([*words, "--on-box", BOX])))
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
            words = [str(OPENINGS), file, "--most", str(place)]
            done.append(("openings", run(words, LIMIT_OPENINGS)))
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps([(what, asdict(it)) for what, it in done]))
    return done


def understood(model: Model, done: list[tuple[str, Outcome]]) -> bool:
    """Return whether the commands gave the required result for this kind of robot."""
    statuses = [outcome.status for what, outcome in done if what != "openings"]
    return statuses == {"mobile": [0], "arm": [2, 0], "other": [2]}[model.kind]


def openings_row(model: Model, checks: float, did: Outcome) -> str:
    """Format the results of `robot_openings.py` as a row; `checks` is the time of checking [s]."""
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


def main() -> None:
    """Print a row for each robot, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("site", type=Path)
    parser.add_argument(
        "--get", action="store_true", help="install the packages if SITE is missing"
    )
    parser.add_argument("--set", choices=SETS)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--table", action="store_true", help="only the robots of the table")
    parser.add_argument("--place", type=int, default=0, help="number of openings per kitchen")
    parser.add_argument("--out", type=Path, help="folder of stored results")
    args = parser.parse_args()
    if args.get and not args.site.exists():
        install = [sys.executable, "-m", "pip", "install", "--no-deps", "--target", str(args.site)]
        subprocess.run([*install, *PACKAGES], check=True)
    only = {*args.only, *(TABLE if args.table else ())}
    models = [
        model
        for model in MODELS
        if args.set in (None, model.subset) and (not only or model.name in only)
    ]
    print(machine())
    print("| robot | set | what | status | processor [s] | wall [s] | memory [GB] | last line |")
    print("|---|---|---|---|---|---|---|---|")
    right, opened = 0, []
    for model in models:
        done = measured(model, args.site, args.place, args.out)
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


if __name__ == "__main__":
    main()
