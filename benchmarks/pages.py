"""Test many concurrent web pages: memory, exceptions, and whether all show the same.

    python benchmarks/pages.py [--pages 20] [--minutes 10]

The server runs like `momapos view`. A page is a connection that acts like a browser: it stores the
messages it receives, and acts about every two seconds: it drags the base, plans, changes the task,
toggles layers, plays, adds and removes answers, reloads. From time to time all wait until nothing
changes; then every page, and a newly opened one, must show the same, and the answer must match the
task. Exit status 1 if anything is wrong.
"""

from __future__ import annotations

import argparse
import asyncio
import random
import re
import subprocess
import sys
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

import msgspec
import viser
import zstandard
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Origin, Subprotocol

from hostile import CAMERA

SPOKEN = Subprotocol(f"viser-v{viser.__version__}")
PAUSE = (1.0, 3.0)
"""Range of pauses between two actions of a page [s]."""
ROUND = 20.0
"""Time of acting before all pages are compared [s]."""
QUIET = 1.5
"""Time without messages after which nothing changes [s]."""
LONG = 120.0
"""Maximum time of work; longer work counts as hanging [s]."""
GROWTH = 1.25
"""Maximum ratio of the memory in the last third of the time to that in the middle third [-]."""
ROBOTS = ("segway_ur5e", "fetch")
TARGETS = ("fridge/door_hinge", "oven/door_hinge", "cabinet_right/drawer_top_slide",
           "microwave/door_hinge", "wall_cabinet/door_left_hinge")  # fmt: skip
LABELS = ("Importance, scene graph", "Arm reachability", "Free area", "Potential", "Candidates",
          "Waypoints and grasps", "Start and base path", "Base-pose tolerance",
          "Collision spheres")  # fmt: skip
KINDS = {"drag": 6, "layer": 4, "place": 3, "target": 3, "play": 3, "keep": 1, "forget": 1,
         "stop": 1, "reload": 1, "robot": 1}  # fmt: skip
"""Actions of pages, and their weights."""


@dataclass
class PageState:
    """Messages received by a page: the properties of every control and node."""

    controls: dict[str, dict[str, Any]] = field(default_factory=dict)
    nodes: set[str] = field(default_factory=set)
    received: int = 0
    """Received bytes [B]."""
    drawn: int = 0
    """Number of received nodes, including repeated ones."""
    last: float = 0.0
    """Time of the last message."""

    def take(self, frame: bytes) -> None:
        """Process a frame from the server."""
        self.received += len(frame)
        self.last = time.monotonic()
        size = int.from_bytes(frame[8:16], "little")
        content = zstandard.ZstdDecompressor().decompress(frame[16 : 16 + size])
        for message in msgspec.msgpack.decode(content, strict=False)["messages"]:
            kind = message["type"]
            if kind == "GuiUpdateMessage":
                self.controls.setdefault(message["uuid"], {}).update(message["updates"])
            elif kind == "GuiRemoveMessage":
                self.controls.pop(message["uuid"], None)
            elif kind.startswith("Gui") and "uuid" in message and "props" in message:
                own = {**message["props"]}
                own.update({k: message[k] for k in ("value",) if k in message})
                self.controls.setdefault(message["uuid"], {}).update(own)
            elif kind == "RemoveSceneNodeMessage":
                gone = message["name"]
                self.nodes = {n for n in self.nodes if n != gone and not n.startswith(gone + "/")}
            elif "name" in message and "props" in message:
                self.nodes.add(message["name"])
                self.drawn += 1

    def named(self, label: str) -> str:
        """Return the id of the control with a label."""
        return next(u for u, one in self.controls.items() if one.get("label") == label)

    def value(self, label: str) -> Any:
        """Return the value of a control."""
        return self.controls[self.named(label)].get("value")

    @property
    def busy(self) -> bool:
        """Return whether work is running."""
        return not self.controls[self.named("Stop")]["disabled"]

    @property
    def words(self) -> list[str]:
        """Return all texts, without answer times."""
        keys = ("_markdown", "content")
        texts = [one[key] for one in self.controls.values() for key in keys if key in one]
        return [re.sub(r"answered in \d+ ms", "", text) for text in texts]

    @property
    def state(self) -> dict[str, Any]:
        """Return everything that must be equal on all pages."""
        values = {one.get("label"): one.get("value") for one in self.controls.values()
                  if one.get("value") is not None and one.get("label")}  # fmt: skip
        return {"values": values, "words": sorted(self.words), "nodes": sorted(self.nodes)}


@dataclass
class Tab:
    """One page."""

    address: str
    number: int
    seen: PageState = field(default_factory=PageState)
    acts: int = 0
    _line: ClientConnection | None = None
    _hears: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Connect like a browser that opens or reloads the page."""
        self.seen = PageState(last=time.monotonic())
        self._line = await connect(
            self.address.replace("http", "ws"), origin=Origin(self.address), max_size=None,
            subprotocols=[SPOKEN],
        )  # fmt: skip
        await self.send(CAMERA)
        self._hears = asyncio.create_task(self._hear(self._line))

    async def close(self) -> None:
        """Disconnect."""
        if self._line is not None:
            await self._line.close()
        if self._hears is not None:
            await self._hears

    async def _hear(self, line: ClientConnection) -> None:
        try:
            async for frame in line:
                assert isinstance(frame, bytes)
                self.seen.take(frame)
        except ConnectionClosed:
            return

    async def send(self, message: dict[str, Any]) -> None:
        """Send a message to the server."""
        assert self._line is not None
        await self._line.send(msgspec.msgpack.encode(message))

    async def set(self, label: str, value: Any) -> None:
        """Set a control; the server sends it to all other pages only."""
        uuid = self.seen.named(label)
        self.seen.controls[uuid]["value"] = value
        await self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    async def press(self, label: str) -> None:
        """Press a button."""
        uuid = self.seen.named(label)
        await self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": True}})

    async def drag(self, rng: random.Random) -> None:
        """Drag the base along a short path."""
        x, y = rng.uniform(0.4, 3.0), rng.uniform(-2.5, -1.0)
        for step in range(8):
            await self.send({
                "type": "TransformControlsUpdateMessage", "name": "/robot", "owner": "",
                "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (x + 0.02 * step, y, 0.0),
            })  # fmt: skip
            await asyncio.sleep(0.04)

    async def act(self, rng: random.Random) -> None:
        """Perform a random action of a user."""
        self.acts += 1
        kind = rng.choices(list(KINDS), list(KINDS.values()))[0]
        buttons = {"place": "Place", "keep": "Add this answer", "stop": "Stop",
                   "forget": "Remove all answers"}  # fmt: skip
        if kind == "drag":
            await self.drag(rng)
        elif kind == "target":
            await self.set("Object", rng.choice(TARGETS))
        elif kind == "robot":
            await self.set("Robot", rng.choice(ROBOTS))
        elif kind == "layer":
            label = rng.choice(LABELS)
            await self.set(label, not self.seen.value(label))
        elif kind == "play":
            labels = {one.get("label") for one in self.seen.controls.values()}
            await self.press("Play" if "Play" in labels else "Pause")
        elif kind == "reload":
            await self.close()
            await self.open()
            while not self.seen.controls:
                await asyncio.sleep(0.05)
            await asyncio.sleep(0.5)
        else:
            await self.press(buttons[kind])


async def acting(tab: Tab, rng: random.Random, until: float) -> None:
    """Let a page act until a time."""
    while time.monotonic() < until:
        await asyncio.sleep(rng.uniform(*PAUSE))
        await tab.act(rng)


async def compared(tabs: list[Tab]) -> tuple[list[str], int]:
    """Wait until nothing changes; return the errors, and the bytes of opening a page [B]."""
    await tabs[0].press("Stop")
    await asyncio.sleep(0.5)
    wanted = random.Random(tabs[0].acts).choice(TARGETS)
    await tabs[0].set("Object", wanted)
    await asyncio.sleep(1.0)
    await tabs[-1].press("Place")
    ends = time.monotonic() + LONG
    while time.monotonic() < ends:
        await asyncio.sleep(0.2)
        still = time.monotonic() - max(tab.seen.last for tab in tabs) > QUIET
        if still and not any(tab.seen.busy for tab in tabs):
            break
    else:
        return [f"work goes on for more than {LONG:.0f} s"], 0
    fresh = Tab(tabs[0].address, -1)
    await fresh.open()
    await asyncio.sleep(QUIET)
    wrong = []
    expected = fresh.seen.state
    for tab in tabs:
        seen = tab.seen.state
        for key in expected:
            if seen[key] != expected[key]:
                what = different(seen, expected, key)
                wrong.append(f"page {tab.number} shows other {key}: {what}")
    answered = [text for text in fresh.seen.words if "fully checked" in text]
    if not answered or wanted not in answered[0]:
        wrong.append(f"{wanted} was requested, but the page shows {answered or fresh.seen.words}")
    await fresh.close()
    return wrong, fresh.seen.received


def different(seen: dict[str, Any], expected: dict[str, Any], key: str) -> str:
    """Return the differences between two pages."""
    if isinstance(seen[key], dict):
        keys = [k for k in {*seen[key], *expected[key]} if seen[key].get(k) != expected[key].get(k)]
        return ", ".join(f"{k}: {seen[key].get(k)!r} for {expected[key].get(k)!r}" for k in keys)
    one, other = ([x for x in a if x not in b] for a, b in (
        (seen[key], expected[key]), (expected[key], seen[key])))  # fmt: skip
    return f"{one} for {other}"[:600]


def memory(pid: int) -> float:
    """Return the memory of a process [MB]."""
    with open(f"/proc/{pid}/status") as file:
        (line,) = (line for line in file if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


async def run(address: str, pid: int, pages: int, minutes: float, seed: int) -> list[str]:
    """Run the test; return the errors."""
    tabs = [Tab(address, k) for k in range(pages)]
    for tab in tabs:
        await tab.open()
    while not all(tab.seen.nodes and tab.seen.controls for tab in tabs):
        await asyncio.sleep(0.1)
    rng, wrong, held = random.Random(seed), [], []
    began = time.monotonic()
    while time.monotonic() - began < 60 * minutes:
        until = min(time.monotonic() + ROUND, began + 60 * minutes)
        await asyncio.gather(*(acting(t, random.Random(rng.random()), until) for t in tabs))
        found, cost = await compared(tabs)
        wrong += found
        held.append(memory(pid))
        acts = sum(tab.acts for tab in tabs)
        print(f"{time.monotonic() - began:5.0f} s: {acts} acts, {held[-1]:.0f} MB, "
              f"{cost / 1e6:.2f} MB to open a page, "
              f"{len(wrong)} wrong", flush=True)  # fmt: skip
        if wrong:
            break
    for tab in tabs:
        await tab.close()
    third = max(len(held) // 3, 1)
    middle, last = max(held[third : 2 * third] or held), max(held[-third:])
    print(f"memory: start {held[0]:.0f}, middle {middle:.0f}, end {last:.0f} MB")
    if last > GROWTH * middle:
        wrong.append(f"memory grew from {middle:.0f} to {last:.0f} MB")
    return wrong


def while_served(
    act: Callable[[str, int], Coroutine[Any, Any, list[str]]],
) -> tuple[list[str], list[str]]:
    """Serve a kitchen while pages act at its address; its second argument is the server's process.

    Returns:
        What is wrong, and the lines that the server printed as errors.
    """
    command = [sys.executable, "-m", "momapos", "view", "kitchen_small", "--port", "0"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None
        assert server.stderr is not None
        found = re.search(r"http://\S+", server.stdout.readline())
        assert found is not None
        failed = asyncio.run(act(found[0], server.pid))
        server.terminate()
        return failed, server.stderr.read().splitlines()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pages", type=int, default=20)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    failed, errors = while_served(
        lambda address, pid: run(address, pid, args.pages, args.minutes, args.seed)
    )
    if errors:
        failed.append("\n".join(["the server printed:", *errors]))
    print("\n".join(failed) if failed else "all pages show the same; no exception")
    sys.exit(bool(failed))
