"""The controls of the page. They hold no state except what a user has set.

viser sends a change to all browsers except the one that made it. If two browsers change one control
at the same time, the later one receives the earlier change after its own, and would keep showing
it. viser has no function that sends a value the server has already.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from viser import _messages as messages

from momapos.core import TaskError, escape_markdown, parse_quantity
from momapos.model.records import JointVerb
from momapos.model.scene import Scene
from momapos.model.urdf import Joint
from momapos.planning.grasps import make_task
from momapos.simulation import GIF, MP4

from .card import CardView
from .playback import SPEEDS
from .question import METHODS, VERBS

if TYPE_CHECKING:
    from jaxtyping import Float
    from viser import GuiApi


Step: TypeAlias = Literal["choose", "place", "play", "drag", "why"]
WORDS: dict[Step, tuple[str, str]] = {
    "choose": ("Choose", "Choose a task and an object, or click an object in the room."),
    "place": ("Place", "Press Place: where must the robot stand?"),
    "play": ("Play", "Press Play: how does it move?"),
    "drag": ("Drag", "Drag the base by its arrows: does another place work, too?"),
    "why": ("Why not", "Drag it until the footprint turns red, and read why."),
}
"""The name and the instruction of each step."""


class Guide:
    """Shows the next step, and disappears after the last one."""

    def __init__(self, gui: Any) -> None:
        """Show the first step.

        Args:
            gui: Where to draw.
        """
        self._handle = gui.add_html(guide_html(set()))
        self._done: set[Step] = set()

    def done(self, *steps: Step) -> None:
        """Tick steps."""
        if self._done.issuperset(steps):
            return
        self._done |= set(steps)
        self._handle.content = guide_html(self._done)
        self._handle.visible = len(self._done) < len(WORDS)


def guide_html(done: set[Step]) -> str:
    """Return the steps as HTML, with the instruction of the first one that is not done."""
    steps = get_args(Step)
    current = next((step for step in steps if step not in done), None)
    marks = " ".join(
        f'<span style="white-space:nowrap;opacity:{1.0 if step == current else 0.6};'
        f'font-weight:{700 if step == current else 400}">'
        f"{'✓' if step in done else f'{k}.'} {WORDS[step][0]}</span>"
        for k, step in enumerate(steps, start=1)
    )
    words = "" if current is None else WORDS[current][1]
    return (
        '<div style="margin:.1em .75em .5em;font-size:.84em;line-height:1.5">'
        f'<div style="display:flex;flex-wrap:wrap;gap:0 .9em">{marks}</div>'
        f'<div style="color:var(--mantine-color-dimmed)">{words}</div></div>'
    )


UNLIMITED = {"revolute": math.pi, "continuous": math.pi, "prismatic": 1.0}
"""Joints without limits get sliders from minus to plus this [rad] or [m]."""
STEPS = {"deg": 1.0, "cm": 0.5}
"""Steps of the slider."""


@dataclass(frozen=True)
class HowFar:
    """Values that a task may move a part to."""

    unit: str
    """deg or cm"""
    low: float
    high: float
    usual: float
    """The value of the verb; all in the unit."""

    @property
    def step(self) -> float:
        """Step of the slider; a twentieth of the range where that is less."""
        return min(STEPS[self.unit], (self.high - self.low) / 20)

    def clipped(self, value: float) -> float:
        """Return the nearest value of the slider."""
        return min(max(round(value, 2), self.low), self.high)

    def text(self, value: float) -> str:
        """Return a value as a user of the command line types it; "" for the usual one."""
        return "" if abs(value - self.usual) < self.step / 2 else f"{value:g}{self.unit}"

    def value(self, text: str) -> float:
        """Return the slider's value for a text.

        Raises:
            TaskError: The text is no quantity.
        """
        if not text or text == "max":
            return self.usual
        quantity = parse_quantity(text).value
        return self.clipped(math.degrees(quantity) if self.unit == "deg" else 100 * quantity)


def how_far(scene: Scene, verb: str, target: str) -> HowFar | None:
    """Return the values for a part; None where the task moves a whole object.

    Args:
        scene: The room.
        verb: The verb of the task.
        target: The object and joint as "object/joint".
    """
    name, _, joint_name = target.partition("/")
    if verb not in get_args(JointVerb) or not joint_name:
        return None
    item = scene.object(name)
    joint = item.joint(joint_name)
    if joint.mimic is not None:  # a task moves the leader
        joint = item.joint(joint.mimic.joint)
    unit, factor = ("cm", 100.0) if joint.kind == "prismatic" else ("deg", math.degrees(1.0))
    most = UNLIMITED[joint.kind]
    low = math.ceil(10 * factor * max(joint.lower, -most) - 1e-6) / 10
    high = math.floor(10 * factor * min(joint.upper, most) + 1e-6) / 10
    if high - low < 1e-3:
        return None
    try:
        goal = make_task(scene, verb, name, joint_name).to
    except TaskError:  # the part is there already; the answer says so
        goal = item.values()[joint.name]
    usual = min(max(round(factor * (goal or 0.0), 2), low), high)
    return HowFar(unit, low, high, usual)


SLIDER_RESOLUTION = 1e-4
"""Joint values that differ by less are equal: sliders have no more digits [rad] or [m]."""
SLIDER_STEP = {"deg": 1.0, "m": 0.01}
"""Largest step of a slider; it is a twentieth of the range where that is less."""


@dataclass(frozen=True)
class JointRange:
    """A joint with a slider."""

    name: str
    low: float
    high: float
    """[rad] or [m]"""
    value: float
    turns: bool

    @property
    def unit(self) -> str:
        """The unit of the slider."""
        return "deg" if self.turns else "m"

    def to_slider(self, value: float) -> float:
        """Convert a joint value to the unit of the slider [deg] or [m]."""
        return math.degrees(value) if self.turns else value

    def from_slider(self, shown: float) -> float:
        """Convert a slider value to a joint value within the limits [rad] or [m]."""
        value = math.radians(shown) if self.turns else shown
        return min(max(value, self.low), self.high)


def joint_ranges(scene: Scene, name: str) -> tuple[JointRange, ...]:
    """Return the joints of an object that the user may move; none where there is no such object."""
    found = []
    for item in (one for one in scene.objects if one.name == name):
        values = item.values()
        for joint in item.model.joints.values():
            own = joint_range(joint, values[joint.name])
            if own is not None:
                found.append(own)
    return tuple(found)


def joint_range(joint: Joint, value: float) -> JointRange | None:
    """Return the range of a joint at a value [rad] or [m]; None if it follows or does not move."""
    limit = UNLIMITED[joint.kind]
    low, high = max(joint.lower, -limit), min(joint.upper, limit)
    if joint.mimic is not None or high - low <= 1e-6:
        return None
    return JointRange(joint.name, low, high, min(max(value, low), high), joint.kind != "prismatic")


def joint_slider(gui: GuiApi, joint: JointRange) -> Any:
    """Add the slider of a joint."""
    low, high = joint.to_slider(joint.low), joint.to_slider(joint.high)
    return gui.add_slider(
        f"{joint.name} [{joint.unit}]", min=round(low, 3), max=round(high, 3),
        initial_value=_within(joint.to_slider(joint.value), low, high),
        step=min(SLIDER_STEP[joint.unit], (high - low) / 20),
    )  # fmt: skip


POINT = "a point"
"""Place that a user types or clicks."""
CLICKS = ("the object", "the place")
"""What a click in the room chooses, where an object is brought to a place."""
WAIT = 1.0
"""Time after the last change of a control until its value is sent again [s]."""


class Resender:
    """Sends values again, with a timer for each control and node."""

    def __init__(self, *, wait: float = WAIT) -> None:
        """Set the time to wait after the last change [s]."""
        self._wait = wait
        self._lock = threading.Lock()
        self._timers: dict[str, threading.Timer] = {}
        self._closed = False

    def control(self, handle: Any) -> None:
        """Send a control again that a user has changed."""
        self._soon(handle._impl.uuid, partial(send_value, handle))

    def on_change(self, handle: Any, action: Callable[[], None]) -> None:
        """Send a control again and call an action when a user changes it."""

        def changed(event: Any) -> None:
            if event.client is not None:
                self.control(handle)
                action()

        handle.on_update(changed)

    def node(self, node: Any) -> None:
        """Send a node again that a user has dragged."""
        self._soon(node.name, partial(send_pose, node))

    def close(self) -> None:
        """Cancel all timers."""
        with self._lock:
            self._closed = True
            for timer in self._timers.values():
                timer.cancel()

    def _soon(self, key: str, send: Callable[[], None]) -> None:
        with self._lock:
            if self._closed:
                return
            before = self._timers.pop(key, None)
            if before is not None:
                before.cancel()
            timer = self._timers[key] = threading.Timer(self._wait, self._now, (key, send))
            timer.daemon = True
            timer.start()

    def _now(self, key: str, send: Callable[[], None]) -> None:
        with self._lock:
            if self._closed or self._timers.get(key) is not threading.current_thread():
                return  # it has changed again
            del self._timers[key]
        send()


def send_value(handle: Any) -> None:
    """Send the value of a control to all browsers, unless it was removed."""
    own = handle._impl
    if not own.removed:
        own.gui_api._websock_interface.queue_message(
            messages.GuiUpdateMessage(own.uuid, {"value": own.value})
        )


def send_pose(node: Any) -> None:
    """Send the pose of a node to all browsers, unless it was removed."""
    own = node._impl
    if not own.removed:
        x, y, z = (float(v) for v in own.position)
        a, b, c, d = (float(v) for v in own.wxyz)
        own.api._queue_scene_message(messages.SetPositionMessage(own.name, (x, y, z)))
        own.api._queue_scene_message(messages.SetOrientationMessage(own.name, (a, b, c, d)))


LAYERS = {
    "importance": "Importance, scene graph", "reach": "Arm reachability", "free": "Free area",
    "potential": "Potential", "opening": "Opening map", "candidates": "Candidates",
    "waypoints": "Waypoints and grasps", "path": "Start and base path",
    "tolerance": "Base-pose tolerance", "spheres": "Collision spheres",
    "collision": "Collision shapes",
}  # fmt: skip
"""Labels of the layers, in the order of the stages."""
INITIAL_LAYERS = ("path", "waypoints", "tolerance")
CLOUDS = ("by object", "original colors", "none")
"""Colorings of a scan's points."""
POINTS = {"50,000": 50_000, "200,000": 200_000, "all": None}
"""Maximum number of points drawn [-]. Without a graphics card, 100,000 of them take 0.1 s of CPU
time per frame."""
FILMS = {"Film (GIF)": GIF, "Film (MP4, 720p)": MP4}
"""Labels and file endings of films."""
NO_MOTION = ""
DRAG_HINT = "Keep the current base pose"


def set_theme(gui: GuiApi, *, dark: bool = False) -> None:
    """Set the light or dark theme, without links to the outside."""
    gui.configure_theme(
        show_logo=False, show_share_button=False, control_width="medium",
        brand_color=(42, 122, 184), dark_mode=dark,
    )  # fmt: skip


class Panel:
    """Builds the controls. Each view connects its own ones with `on_click` and `on_change`."""

    def __init__(
        self,
        gui: GuiApi,
        resender: Resender,
        *,
        scenes: Sequence[str],
        robots: Sequence[str],
        scene: str,
        robot: str,
    ) -> None:
        self._gui, self.resender = gui, resender
        self._how_far: HowFar | None = None
        self._exact = ""
        tabs = gui.add_tab_group()
        with tabs.add_tab("Task"):
            self._add_task(scenes, robots, scene, robot)
            self._add_answer()
            self._add_details()
        with tabs.add_tab("Layers"):
            self._add_layers()
        with tabs.add_tab("Compare"):
            self.add_answer = gui.add_button("Add this answer")
            self.clear_answers = gui.add_button("Remove all answers")
            self.comparison = gui.add_markdown("")
        with tabs.add_tab("Files"):
            self._add_files()
        self.question = (self.scene, self.robot, self.arm, self.verb, self.target, self.slider,
                         self.farthest, self.goal, self.point, self.method, self.seed)  # fmt: skip

    def _add_task(
        self, scenes: Sequence[str], robots: Sequence[str], scene: str, robot: str
    ) -> None:
        gui = self._gui
        self.guide = Guide(gui)
        self.scene = gui.add_dropdown("Scene", tuple(scenes), initial_value=scene)
        self.robot = gui.add_dropdown("Robot", tuple(robots), initial_value=robot)
        self.arm = gui.add_dropdown("Arm", ("any",), disabled=True, visible=False)
        self.verb = gui.add_dropdown("Task", VERBS)
        self.target = gui.add_dropdown("Object", ("-",), hint="Type to search, or click an object "
                                       "in the room")  # fmt: skip
        self.slider = gui.add_slider("How far", min=0.0, max=90.0, step=1.0, initial_value=90.0,
                                     disabled=True)  # fmt: skip
        self.farthest = gui.add_checkbox("As far as possible", False)
        self.goal = gui.add_dropdown("To", (POINT,), visible=False, hint="Type to search")
        self.point = gui.add_text("Point [m]", "", visible=False, hint="Middle of the base: X,Y,Z")
        self.clicks = gui.add_dropdown("A click chooses", CLICKS, visible=False)
        self.place = gui.add_button("Place", color="blue", hint="Key P")
        self.place_here = gui.add_button("Plan from here", hint=DRAG_HINT, visible=False)
        self.stop = gui.add_button("Stop", hint="Key X", disabled=True, visible=False)

    def _add_answer(self) -> None:
        gui = self._gui
        self.card = CardView(gui)
        self.play = gui.add_button("Play", hint="Key K or space", disabled=True)
        self.time = gui.add_slider("Time [s]", min=0.0, max=1.0, step=0.01, initial_value=0.0,
                                   disabled=True)  # fmt: skip
        self.speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1")
        self.moment = gui.add_markdown(NO_MOTION)

    def _add_details(self) -> None:
        gui = self._gui
        self.joints_folder = gui.add_folder("Joints of the object", expand_by_default=False)
        self._joints: dict[str, tuple[JointRange, Any]] = {}
        self.check_folder = gui.add_folder("Scene check", expand_by_default=False)
        with self.check_folder:
            self.check = gui.add_markdown("")
        with gui.add_folder("More options", expand_by_default=False):
            self.method = gui.add_dropdown("Method", METHODS)
            self.seed = gui.add_number("Seed", 0, min=0, max=2**31 - 1, step=1)
            self.start_here = gui.add_button("Start at the current base pose")
            self.start_of_scene = gui.add_button("Start at the scene's start pose")

    def _add_layers(self) -> None:
        gui = self._gui
        with gui.add_folder("Scan", visible=False) as self.scan_folder:
            self.cloud = gui.add_dropdown("Points", CLOUDS)
            self.points = gui.add_dropdown("Number of points", tuple(POINTS))
            self.points_shown = gui.add_markdown("")
            self.boxes = gui.add_checkbox("Boxes and names", True)
            self.furniture = gui.add_checkbox("Reconstructed scene", True)
        self.layers = {
            key: gui.add_checkbox(label, key in INITIAL_LAYERS) for key, label in LAYERS.items()
        }
        self.dark = gui.add_checkbox("Dark page", False)
        self.plain = gui.add_checkbox("Plain light", False, hint="No shadows: four times the "
                                      "frame rate without a graphics card")  # fmt: skip
        self.height = gui.add_slider("Reachability height [m]", min=0.0, max=2.0, step=0.05,
                                     initial_value=0.9)  # fmt: skip
        self.legend = gui.add_html("")
        self.clicked = gui.add_markdown("Click a candidate to see why it was rejected.")

    def _add_files(self) -> None:
        gui = self._gui
        self.plan_name = gui.add_text("Plan", "plan.json")
        self.save_plan = gui.add_button("Save plan")
        self.scene_name = gui.add_text("Scene", "scene.json")
        self.save_scene = gui.add_button("Save scene")
        self.image = gui.add_button("Image (PNG)")
        self.films = {ending: gui.add_button(label) for label, ending in FILMS.items()}
        for handle in (self.plan_name, self.scene_name):
            self.on_change(handle)
        self.files = gui.add_markdown("Files are saved in the folder where momapos was started.")

    # -------------------------------------------------------------------------- events of the user

    def on_click(self, button: Any, action: Callable[[], None]) -> None:
        """Call an action when a user presses a button."""
        button.on_click(lambda _: action())

    def on_change(self, handle: Any, action: Callable[[], None] = lambda: None) -> None:
        """Call an action when a user changes a control, but not when the page itself does."""
        self.resender.on_change(handle, action)

    def on_key(self, label: str, key: Any, action: Callable[[], None]) -> None:
        """Call an action when a user presses a key or chooses the command."""
        self._gui.add_command(label, hotkey=key).on_trigger(lambda _: action())

    # ---------------------------------------------------------------------------- what is shown

    def offer(self, handle: Any, options: Sequence[str], value: str) -> str:
        """Set the options of a list; select and return the value, or else the first option."""
        given = tuple(options) or ("-",)
        if handle.options != given:
            handle.options = given
        chosen = value if value in given else given[0]
        if handle.value != chosen:
            handle.value = chosen
        return chosen

    def show_check(self, lines: Sequence[str]) -> None:
        """List what is wrong in the scene."""
        self.check_folder.visible = bool(lines)
        self.check_folder.label = f"Scene check: {len(lines)}"
        self.check.content = "\n".join(f"- {escape_markdown(line)}" for line in lines)

    def show_joints(self, joints: Sequence[JointRange], moved: Callable[[], None]) -> None:
        """Show a slider for each joint of the object.

        Args:
            joints: The joints.
            moved: Called when a user moves a slider.
        """
        for _, handle in self._joints.values():
            handle.remove()
        self._joints = {}
        self.joints_folder.visible = bool(joints)
        with self.joints_folder:
            for joint in joints:
                slider = joint_slider(self._gui, joint)
                self.on_change(slider, moved)
                self._joints[joint.name] = joint, slider

    @property
    def joint_values(self) -> dict[str, float]:
        """Values of the object's joints that differ from the scene [rad] or [m]."""
        values = {
            name: joint.from_slider(float(s.value)) for name, (joint, s) in self._joints.items()
        }
        return {
            n: v for n, v in values.items() if abs(v - self._joints[n][0].value) > SLIDER_RESOLUTION
        }

    def show_joint_values(self, values: Mapping[str, float]) -> None:
        """Set the joint sliders [rad] or [m]; other joints get the scene's value."""
        for name, (joint, slider) in self._joints.items():
            shown = joint.to_slider(values.get(name, joint.value))
            slider.value = _within(shown, float(slider.min), float(slider.max))

    def offer_range(self, how_far: HowFar | None) -> None:
        """Offer the values of another part; None where the task moves a whole object."""
        if how_far == self._how_far:
            return
        self._how_far, self._exact = how_far, ""
        slider = self.slider
        slider.visible = self.farthest.visible = how_far is not None
        slider.disabled = how_far is None
        self.farthest.value = False
        if how_far is not None:
            slider.label = f"How far [{how_far.unit}]"
            slider.min, slider.max, slider.step = how_far.low, how_far.high, how_far.step
            slider.value = how_far.usual

    def offer_places(self, places: Sequence[str]) -> None:
        """Offer where to bring an object; none where the task brings nothing."""
        bring = bool(places)
        if bring:
            self.offer(self.goal, (*places, POINT), self.goal.value)
        self.goal.visible = self.clicks.visible = bring
        self.point.visible = bring and self.goal.value == POINT

    def click_place(self, point: Float[np.ndarray, "3"]) -> None:
        """Set the place to a point [m]."""
        self.goal.value, self.point.visible = POINT, True
        self.point.value = ",".join(f"{value:.3f}" for value in point.tolist())

    @property
    def to(self) -> str:
        """The joint value or the place of the task, as a user of the command line types it."""
        if self.goal.visible:
            return str(self.point.value if self.goal.value == POINT else self.goal.value)
        if self._how_far is None:
            return ""
        if self.farthest.value:
            return "max"
        value = float(self.slider.value)
        if self._exact and value == self._how_far.value(self._exact):
            return self._exact
        return self._how_far.text(value)

    def show_to(self, text: str) -> None:
        """Set the joint value of the task; it stays exact until a user moves the slider."""
        if self._how_far is not None:
            self._exact = text
            self.farthest.value = text == "max"
            self.slider.value = self._how_far.value(text)

    def show_busy(self, busy: bool) -> None:
        """Show Stop while there is work to stop."""
        self.stop.disabled, self.stop.visible = not busy, busy

    def show_duration(self, duration: float) -> None:
        """Set the duration of the motion [s]; 0 where there is none."""
        self.play.disabled = self.time.disabled = duration <= 0
        self.time.value = 0.0
        if duration > 0:
            self.time.max = math.ceil(100 * duration) / 100  # whole steps of the slider

    def show_playing(self, playing: bool) -> None:
        """Label the button Pause while the motion plays, else Play."""
        label = "Pause" if playing else "Play"
        if self.play.label != label:
            self.play.label = label

    def show_moment(self, seconds: float, text: str) -> None:
        """Show the time [s] and the phase of the motion."""
        self.time.value = min(round(seconds, 2), float(self.time.max))
        self.moment.content = f"{seconds:.1f} s: {text}"


def _within(value: float, low: float, high: float) -> float:
    """Round and clip a value as its slider does."""
    return min(max(round(value, 3), round(low, 3)), round(high, 3))
