"""Many pages at once, each acting: memory, exceptions, and whether all see the same.

    python benchmarks/pages.py [--pages 20] [--minutes 10]

The server runs as `momapos view` does. A page is what a browser is to it: a connection that keeps
what it is told, and acts about every two seconds: drags the base, asks, changes the question,
switches layers, plays, keeps, forgets, reloads. Now and then all wait until nothing changes any
more; then every page, and one that is opened then, must show the same, and what is answered must be
what is asked. Exit status 1 where anything is wrong.
"""

from __future__ import annotations

import argparse
import asyncio
import random
import re
import subprocess
import sys
import time
from dataclasses import dataclass, field
from typing import Any

import msgspec
import viser
import zstandard
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Origin, Subprotocol

SPOKEN = Subprotocol(f"viser-v{viser.__version__}")
PAUSE = (1.0, 3.0)
"""Between what one page does and what it does next [s]."""
ROUND = 20.0
"""All act for so long, then all are compared [s]."""
QUIET = 1.5
"""Nothing changes any more when nothing has come for so long [s]."""
LONG = 120.0
"""Work that goes on for longer hangs [s]."""
GROWTH = 1.25
"""Memory is flat where the last third of the time takes at most so many times what the middle one
takes [-]."""
ROBOTS = ("segway_ur5e", "fetch")
TARGETS = ("fridge/door_hinge", "oven/door_hinge", "cabinet_right/drawer_top_slide",
           "microwave/door_hinge", "wall_cabinet/door_left_hinge")  # fmt: skip
LABELS = ("Importance, scene graph", "Arm reachability", "Free area", "Potential", "Candidates",
          "Waypoints and grasps", "Start and base path", "Base-pose tolerance",
          "Collision spheres")  # fmt: skip
KINDS = {"drag": 6, "layer": 4, "place": 3, "target": 3, "play": 3, "keep": 1, "forget": 1,
         "stop": 1, "reload": 1, "robot": 1, "beside": 1}  # fmt: skip
"""What pages do, and how often."""
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (3.0, 3.0, 3.0),
    "fov": 1.0, "near": 0.01, "far": 100.0, "image_height": 720, "image_width": 1280,
    "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip


@dataclass
class Told:
    """What a page was told so far: the properties of every control and of every node."""

    controls: dict[str, dict[str, Any]] = field(default_factory=dict)
    nodes: set[str] = field(default_factory=set)
    received: int = 0
    """[B]"""
    drawn: int = 0
    """How many nodes came, those that came again among them."""
    last: float = 0.0
    """When anything came."""

    def take(self, frame: bytes) -> None:
        """Take in what the server sends."""
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
        """The control with a label."""
        return next(u for u, one in self.controls.items() if one.get("label") == label)

    def value(self, label: str) -> Any:
        """What a control says."""
        return self.controls[self.named(label)].get("value")

    @property
    def busy(self) -> bool:
        """Whether there is work that could be stopped."""
        return not self.controls[self.named("Stop")]["disabled"]

    @property
    def words(self) -> list[str]:
        """All that is said, the control that is at work now and then apart."""
        texts = [one["_markdown"] for one in self.controls.values() if "_markdown" in one]
        return [re.sub(r"answered in \d+ ms", "", text) for text in texts]

    @property
    def state(self) -> dict[str, Any]:
        """All that all pages must see alike."""
        values = {one.get("label"): one.get("value") for one in self.controls.values()
                  if one.get("value") is not None and one.get("label")}  # fmt: skip
        return {"values": values, "words": sorted(self.words), "nodes": sorted(self.nodes)}


@dataclass
class Tab:
    """One page."""

    address: str
    number: int
    told: Told = field(default_factory=Told)
    acts: int = 0
    _line: ClientConnection | None = None
    _hears: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Connect, as a browser does that opens or reloads the page."""
        self.told = Told(last=time.monotonic())
        self._line = await connect(
            self.address.replace("http", "ws"), origin=Origin(self.address), max_size=None,
            subprotocols=[SPOKEN],
        )  # fmt: skip
        await self.send(CAMERA)
        self._hears = asyncio.create_task(self._hear(self._line))

    async def close(self) -> None:
        """Go away."""
        if self._line is not None:
            await self._line.close()
        if self._hears is not None:
            await self._hears

    async def _hear(self, line: ClientConnection) -> None:
        try:
            async for frame in line:
                assert isinstance(frame, bytes)
                self.told.take(frame)
        except ConnectionClosed:
            return

    async def send(self, message: dict[str, Any]) -> None:
        """Say something to the server."""
        assert self._line is not None
        await self._line.send(msgspec.msgpack.encode(message))

    async def set(self, label: str, value: Any) -> None:
        """Set a control; the server tells it to all others only."""
        uuid = self.told.named(label)
        self.told.controls[uuid]["value"] = value
        await self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    async def press(self, label: str) -> None:
        """Press a button."""
        uuid = self.told.named(label)
        await self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": True}})

    async def drag(self, rng: random.Random) -> None:
        """Drag the base along a short way."""
        x, y = rng.uniform(0.4, 3.0), rng.uniform(-2.5, -1.0)
        for step in range(8):
            await self.send({
                "type": "TransformControlsUpdateMessage", "name": "/robot", "owner": "",
                "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (x + 0.02 * step, y, 0.0),
            })  # fmt: skip
            await asyncio.sleep(0.04)

    async def act(self, rng: random.Random) -> None:
        """Do what people do."""
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
        elif kind == "beside":
            await self.set("Side by side", not self.told.value("Side by side"))
        elif kind == "layer":
            label = rng.choice(LABELS)
            await self.set(label, not self.told.value(label))
        elif kind == "play":
            labels = {one.get("label") for one in self.told.controls.values()}
            await self.press("Play" if "Play" in labels else "Pause")
        elif kind == "reload":
            await self.close()
            await self.open()
            while not self.told.controls:
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
    """Wait until nothing changes; what is wrong then, and what a page costs that is opened [B]."""
    await tabs[0].press("Stop")
    await asyncio.sleep(0.5)
    wanted = random.Random(tabs[0].acts).choice(TARGETS)
    await tabs[0].set("Object", wanted)
    await asyncio.sleep(1.0)
    await tabs[-1].press("Place")
    ends = time.monotonic() + LONG
    while time.monotonic() < ends:
        await asyncio.sleep(0.2)
        still = time.monotonic() - max(tab.told.last for tab in tabs) > QUIET
        if still and not any(tab.told.busy for tab in tabs):
            break
    else:
        return [f"work goes on for more than {LONG:.0f} s"], 0
    fresh = Tab(tabs[0].address, -1)
    await fresh.open()
    await asyncio.sleep(QUIET)
    wrong = []
    expected = fresh.told.state
    for tab in tabs:
        seen = tab.told.state
        for key in expected:
            if seen[key] != expected[key]:
                what = different(seen, expected, key)
                wrong.append(f"page {tab.number} shows other {key}: {what}")
    answered = [text for text in fresh.told.words if "candidates, " in text]
    name = wanted.replace("_", "\\_")
    if not answered or name not in answered[0]:
        wrong.append(f"{wanted} was asked, and the page says {answered or fresh.told.words}")
    await fresh.close()
    return wrong, fresh.told.received


def different(seen: dict[str, Any], expected: dict[str, Any], key: str) -> str:
    """Where two pages differ."""
    if isinstance(seen[key], dict):
        keys = [k for k in {*seen[key], *expected[key]} if seen[key].get(k) != expected[key].get(k)]
        return ", ".join(f"{k}: {seen[key].get(k)!r} for {expected[key].get(k)!r}" for k in keys)
    one, other = ([x for x in a if x not in b] for a, b in (
        (seen[key], expected[key]), (expected[key], seen[key])))  # fmt: skip
    return f"{one} for {other}"[:600]


def memory(pid: int) -> float:
    """What a process holds in memory [MB]."""
    with open(f"/proc/{pid}/status") as file:
        (line,) = (line for line in file if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


async def run(address: str, pid: int, pages: int, minutes: float, seed: int) -> list[str]:
    """All of it; what went wrong."""
    tabs = [Tab(address, k) for k in range(pages)]
    for tab in tabs:
        await tab.open()
    while not all(tab.told.nodes and tab.told.controls for tab in tabs):
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
              f"{cost / 1e6:.2f} MB to a page that is opened, "
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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pages", type=int, default=20)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    command = [
        sys.executable, "-c", "from momapos.apps.cli.main import entry; entry()", "view",
        "kitchen_small", "--port", "0",
    ]  # fmt: skip
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None
        assert server.stderr is not None
        found = re.search(r"http://\S+", server.stdout.readline())
        assert found is not None
        failed = asyncio.run(run(found[0], server.pid, args.pages, args.minutes, args.seed))
        server.terminate()
        said = server.stderr.read()
    if said:
        failed.append(f"the server said:\n{said}")
    print("\n".join(failed) if failed else "all pages saw the same; no exception")
    sys.exit(bool(failed))
