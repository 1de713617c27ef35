"""Send a web page random and hostile messages: it must survive, and look the same to others.

    python benchmarks/page_messages.py [--messages 10000] [--seed 0]

The server runs like `momapos view`. Some browsers send messages that are right, mutated (other
types, numbers of 20 digits, unlisted choices, names of other properties), unknown, or no messages
at all. After each round another page still plans, a newly opened page shows the same as it, and
each control holds a value that its user could choose. Exit status 1 if not, if the server prints
more than reports of one line, or if memory grows after the first third.
"""

from __future__ import annotations

import argparse
import asyncio
import random
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from hostile import hostile_frame
from pages import GROWTH, LONG, QUIET, Tab, memory, while_served

ROUNDS = 10
ANSWER = "fully checked"
"""Words of the card of an answer."""


def impossible(controls: dict[str, dict[str, Any]]) -> list[str]:
    """Return the controls whose value their user could not choose."""
    wrong = []
    for one in controls.values():
        value, label = one.get("value"), one.get("label")
        if "options" in one and value not in one["options"]:
            wrong.append(f"{label}: {value!r} is not offered")
        if isinstance(value, int | float) and "min" in one:
            low, high = one["min"], one["max"]
            if not (low is None or low <= value) or not (high is None or value <= high):
                wrong.append(f"{label}: {value!r} is out of range")
    return wrong


async def attack(tab: Tab, rng: random.Random, count: int) -> int:
    """Send hostile frames; reconnect where the server closes the line."""
    ids = [*tab.seen.controls, "no such id"]
    names = [*sorted(tab.seen.nodes), "/robot", "/nothing"]
    for k in range(count):
        frame = hostile_frame(rng, ids, names)
        assert tab._line is not None
        try:
            await tab._line.send(frame)
        except OSError:
            await tab.open()
        if k % 50 == 0:
            await asyncio.sleep(0.02)
    return count


async def until(true: Callable[[], bool]) -> bool:
    """Wait for a condition."""
    ends = time.monotonic() + LONG
    while not true() and time.monotonic() < ends:
        await asyncio.sleep(0.1)
    return true()


async def run(address: str, pid: int, messages: int, seed: int) -> list[str]:
    """Run the test; return the errors."""
    good, *bad = (Tab(address, k) for k in range(5))
    for tab in (good, *bad):
        await tab.open()
        await until(lambda tab=tab: bool(tab.seen.nodes and tab.seen.controls))  # type: ignore[misc]
    await asyncio.sleep(QUIET)
    rng, wrong, held, began = random.Random(seed), [], [], time.monotonic()
    for number in range(ROUNDS):
        share = messages // ROUNDS // len(bad)
        for tab in bad:
            await tab.close()
            await tab.open()
        await until(lambda: all(tab.seen.controls for tab in bad))
        await asyncio.gather(*(attack(tab, random.Random(rng.random()), share) for tab in bad))
        await asyncio.sleep(1.0)
        for tab in bad:
            await tab.close()
        await good.press("Stop")
        for label, value in (("Scene", "kitchen_small"), ("Robot", "segway_ur5e"), ("Seed", 1)):
            await good.set(label, value)
        await good.set("Task", "open")
        await asyncio.sleep(QUIET)
        await good.press("Start at the scene's start pose")
        await good.set("Seed", 0)
        await asyncio.sleep(QUIET)
        await good.press("Place")
        if not await until(
            lambda: not good.seen.busy and any(ANSWER in text for text in good.seen.words)
        ):
            wrong.append(f"round {number}: the page does not plan: {good.seen.words}")
        await until(lambda: time.monotonic() - good.seen.last > QUIET)
        fresh = Tab(address, -1)
        await fresh.open()
        await asyncio.sleep(2 * QUIET)
        wrong += impossible(fresh.seen.controls)
        for key, expected in fresh.seen.state.items():
            if good.seen.state[key] != expected:
                wrong.append(f"round {number}: another page shows other {key}")
        await fresh.close()
        held.append(memory(pid))
        print(f"{time.monotonic() - began:5.0f} s: {(number + 1) * share * len(bad)} messages, "
              f"{held[-1]:.0f} MB, {len(wrong)} wrong", flush=True)  # fmt: skip
    await good.close()
    third = len(held) // 3
    if max(held[-third:]) > GROWTH * float(np.max(held[third : 2 * third])):
        wrong.append(f"memory grows: {held}")
    return wrong


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    failed, lines = while_served(lambda address, pid: run(address, pid, args.messages, args.seed))
    # The page reports a question that it cannot answer in one line, here too.
    other = [line for line in lines if not line.startswith("momapos: ")]
    if other:
        failed.append("\n".join(["the server printed:", *other]))
    print(f"lines of reports in the terminal: {len(lines) - len(other)}")
    print(
        "\n".join(failed)
        if failed
        else "the page plans, is the same for all, and prints no traceback"
    )
    sys.exit(bool(failed))
