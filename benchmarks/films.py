"""How long a film of a run takes to draw, against how long the run and the film last.

    python benchmarks/films.py [--out docs/images]

The demo's plan is carried out in physics, and its run is written as a filmstrip (`film.png`), as a
GIF and as an MP4, both 1280 x 720. With `--out` the strip and the GIF, made smaller for a page
(`demo.gif`), are kept there: they are the pictures of the README and of docs/execution.md.
"""

from __future__ import annotations

import argparse
import io
import tempfile
import time
from pathlib import Path

from PIL import Image, ImageSequence

from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.grasps.tasks import make_task
from momapos.planning.plan import plan_base_placement
from momapos.planning.reachability.map_store import load_reach
from momapos.simulation.film import write_film
from momapos.simulation.film_files import GIF, MP4, STRIP
from momapos.simulation.run_trace import RunTrace
from momapos.workflows.run import run_plan

PAGE = (640, 360)
"""Size of the README's GIF [px]."""
STRIP_WIDTH = 1800
"""Of the strip in the docs [px]."""
COLORS, EVERY = 64, 2
"""Of pictures that are kept; of a film every second one is."""


def carried_out() -> RunTrace:
    """The demo in physics, as `momapos run` does it."""
    scene, robot = load_scene("kitchen_small"), load_robot("segway_ur5e")
    reach, trace = load_reach(robot), RunTrace()
    plan = plan_base_placement(scene, robot, make_task(scene, "open", "fridge", "door_hinge"))
    done = run_plan(plan.plan, scene, robot, reach, trace=trace.drive, watch=trace)
    if not done.success:
        raise RuntimeError(f"the demo failed: {done.reason}")
    return trace


def lasts(film: bytes, ending: str) -> tuple[int, float]:
    """How many pictures a film has, and how long it plays [s]."""
    if ending == MP4:
        import av

        with av.open(io.BytesIO(film)) as file:
            stream = file.streams.video[0]
            return stream.frames, float(stream.duration * stream.time_base)
    with Image.open(io.BytesIO(film)) as pictures:
        times = [one.info.get("duration", 0) / 1000 for one in ImageSequence.Iterator(pictures)]
    return len(times), sum(times)


def smaller(film: bytes) -> bytes:
    """A GIF for a page."""
    content = io.BytesIO()
    with Image.open(io.BytesIO(film)) as pictures:
        wait = EVERY * pictures.info["duration"]
        first, *others = (
            one.convert("RGB").resize(PAGE, Image.Resampling.LANCZOS)
            .quantize(COLORS, dither=Image.Dither.NONE)
            for k, one in enumerate(ImageSequence.Iterator(pictures)) if k % EVERY == 0
        )  # fmt: skip
    first.save(
        content, "GIF", save_all=True, append_images=others, loop=0, duration=wait, optimize=True
    )
    return content.getvalue()


def run(out: Path | None) -> None:
    """Film the demo, and tell."""
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    trace = carried_out()
    whole = sum(act.duration for act in trace.acts)
    print(f"the run: {whole:.1f} s", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for ending in (STRIP, GIF, MP4):
            path = Path(folder) / f"film{ending}"
            began, own = time.perf_counter(), time.process_time()
            write_film(trace, path, ending="done")
            took, own = time.perf_counter() - began, time.process_time() - own
            film = path.read_bytes()
            played = (
                ""
                if ending == STRIP
                else "{} pictures, plays {:.1f} s, ".format(*lasts(film, ending))
            )
            print(f"{ending[1:]}: {played}drawn in {took:.1f} s ({own:.1f} s of processor), "
                  f"{len(film) / 1e6:.1f} MB", flush=True)  # fmt: skip
            if out is not None and ending == GIF:
                (out / "demo.gif").write_bytes(smaller(film))
            if out is not None and ending == STRIP:
                with Image.open(path) as strip:
                    strip.thumbnail((STRIP_WIDTH, STRIP_WIDTH), Image.Resampling.LANCZOS)
                    strip.quantize(COLORS).save(out / "film.png", optimize=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    run(parser.parse_args().out)
