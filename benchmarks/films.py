"""Measure how long rendering a film of a run takes.

    python benchmarks/films.py [--out docs/images]

The demo's plan is executed in physics, and its run is written as a filmstrip (`film.png`), a GIF
and an MP4, both 1280 x 720. With `--out` the strip, the MP4 (`demo.mp4`) and a smaller GIF
(`demo.gif`) are stored there; the README, the docs and the gallery show them.
"""

from __future__ import annotations

import io
import tempfile
import time
from pathlib import Path

from PIL import Image, ImageSequence

from momapos.model.scene import load_scene
from momapos.planning import plan_base_placement
from momapos.planning.grasps import make_task
from momapos.simulation import GIF, MP4, RunTrace, write_film
from momapos.simulation.film import STRIP
from momapos.workflows import run_plan
from placement import arm
from rows import commands

PAGE = (720, 405)
"""Size of the README's GIF [px]."""
TITLE = "segway_ur5e: open fridge/door_hinge to 90 deg"
STRIP_WIDTH = 1800
"""Width of the strip in the docs [px]."""
COLORS = 64
"""Colors of stored frames [-]."""


def lasts(film: bytes, ending: str) -> tuple[int, float]:
    """Return the number of frames of a film, and its duration [s]."""
    if ending == MP4:
        import av

        with av.open(io.BytesIO(film)) as file:
            stream = file.streams.video[0]
            return stream.frames, float(stream.duration * stream.time_base)
    with Image.open(io.BytesIO(film)) as frames:
        times = [one.info.get("duration", 0) / 1000 for one in ImageSequence.Iterator(frames)]
    return len(times), sum(times)


def smaller(film: bytes) -> bytes:
    """Return a smaller GIF for a page."""
    content = io.BytesIO()
    with Image.open(io.BytesIO(film)) as frames:
        wait = frames.info["duration"]
        first, *others = (
            one.convert("RGB").resize(PAGE, Image.Resampling.LANCZOS)
            .quantize(COLORS, dither=Image.Dither.NONE)
            for one in ImageSequence.Iterator(frames)
        )  # fmt: skip
    first.save(
        content, "GIF", save_all=True, append_images=others, loop=0, duration=wait, optimize=True
    )
    return content.getvalue()


def main(out: Path | None = None) -> None:
    """Run the demo in physics, like `momapos run`; render it and print the times.

    Args:
        out: Folder of the stored images.
    """
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    scene, (robot, reach), trace = load_scene("kitchen_small"), arm("segway_ur5e"), RunTrace()
    plan = plan_base_placement(scene, robot, make_task(scene, "open", "fridge", "door_hinge")).plan
    done = run_plan(plan, scene, robot, reach, trace=trace.drive, watch=trace)
    if not done.success:
        raise RuntimeError(f"the demo failed: {done.reason}")
    whole = sum(act.duration for act in trace.acts)
    print(f"the run: {whole:.1f} s", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for ending in (STRIP, GIF, MP4):
            path = Path(folder) / f"film{ending}"
            began, own = time.perf_counter(), time.process_time()
            write_film(trace, path, ending="done", title=TITLE)
            took, own = time.perf_counter() - began, time.process_time() - own
            film = path.read_bytes()
            count, lasting = (0, 0.0) if ending == STRIP else lasts(film, ending)
            played = f"{count} frames, duration {lasting:.1f} s, " if count else ""
            print(f"{ending[1:]}: {played}drawn in {took:.1f} s ({own:.1f} s of processor), "
                  f"{len(film) / 1e6:.1f} MB", flush=True)  # fmt: skip
            if out is not None and ending == GIF:
                (out / "demo.gif").write_bytes(smaller(film))
            if out is not None and ending == MP4:
                (out / "demo.mp4").write_bytes(film)
            if out is not None and ending == STRIP:
                with Image.open(path) as strip:
                    strip.thumbnail((STRIP_WIDTH, STRIP_WIDTH), Image.Resampling.LANCZOS)
                    strip.quantize(COLORS).save(out / "film.png", optimize=True)


if __name__ == "__main__":
    commands(__doc__, main)
