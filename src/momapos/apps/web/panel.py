"""The controls beside the picture. They hold no state but what a person has set."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from momapos.model.scene import Scene
from momapos.simulation import GIF, MP4

from .playback import SPEEDS
from .question import METHODS, VERBS

if TYPE_CHECKING:
    from viser import GuiApi

    from .page import Page

LAYERS = {
    "importance": "Importance, graph", "reach": "Arm's reach", "free": "Free area",
    "potential": "Potential", "opening": "Opening map", "candidates": "Candidates",
    "waypoints": "Waypoints, grasps", "way": "Start and path",
    "tolerance": "Tolerance of the base", "spheres": "Collision spheres",
    "collision": "Collision shapes",
}  # fmt: skip
"""Layers in the order of the stages, and what they are called."""
CLOUDS = ("by thing", "as seen", "none")
"""How the points of a scan are colored."""
POINTS = {"50 thousand": 50_000, "200 thousand": 200_000, "all": None}
"""How many points of a scan are shown at most; without a graphics card 100 thousand of them take a
tenth of a second of processor for each picture [-]."""
PLAIN = "No shadows: about twice as many pictures a second without a graphics card"
FILM_KINDS = {"Film (GIF)": GIF, "Film (MP4, 720p)": MP4}
"""Films of the motion that a browser may have, and how their names end."""
SHOWN = ("way", "waypoints", "tolerance")
"""Those that are seen at first."""


@dataclass(frozen=True)
class JointRange:
    """A joint of the object that may be moved."""

    name: str
    low: float
    high: float
    """[rad] or [m]"""
    value: float
    turns: bool

    @property
    def unit(self) -> str:
        """What a person reads it in."""
        return "deg" if self.turns else "m"

    def shown(self, value: float) -> float:
        """A value as a person reads it [deg] or [m]."""
        return math.degrees(value) if self.turns else value

    def meant(self, shown: float) -> float:
        """A value that a person set, within the limits [rad] or [m]."""
        value = math.radians(shown) if self.turns else shown
        return min(max(value, self.low), self.high)


SEEN = 1e-4
"""Joints that differ by less stand alike [rad] or [m]: sliders have no more digits."""
FINE = {"deg": 1.0, "m": 0.01}
"""Sliders of joints move by this, or by a twentieth of their way where that is less."""
WIDEST = {"revolute": math.pi, "continuous": math.pi, "prismatic": 1.0}
"""Joints without limits are offered from minus to plus this [rad] or [m]."""


def joint_ranges(scene: Scene, name: str) -> tuple[JointRange, ...]:
    """The joints of an object that may be moved by hand; none where there is no such object."""
    found = []
    for item in (one for one in scene.objects if one.name == name):
        values = item.values()
        for joint in item.model.joints.values():
            wide = WIDEST[joint.kind]
            low, high = max(joint.lower, -wide), min(joint.upper, wide)
            if joint.mimic is None and high - low > 1e-6:
                value = min(max(values[joint.name], low), high)
                turns = joint.kind != "prismatic"
                found.append(JointRange(joint.name, low, high, value, turns))
    return tuple(found)


def set_theme(gui: GuiApi, *, dark: bool = False) -> None:
    """Make the page light or dark. Nothing on it leads out of this machine."""
    gui.configure_theme(
        show_logo=False, show_share_button=False, control_width="medium",
        brand_color=(42, 122, 184), dark_mode=dark,
    )  # fmt: skip


class Panel:
    """Builds the controls, and tells the page what was done with them."""

    def __init__(
        self,
        gui: GuiApi,
        page: Page,
        *,
        scenes: Sequence[str],
        robots: Sequence[str],
        scene: str,
        robot: str,
    ) -> None:
        self._gui, self._page = gui, page
        tabs = gui.add_tab_group()
        with tabs.add_tab("Task"):
            self._task(scenes, robots, scene, robot)
        with tabs.add_tab("Motion"):
            self._motion()
        with tabs.add_tab("Layers"):
            self._layers()
        with tabs.add_tab("Files"):
            self._files()
        self._keys()

    def _task(self, scenes: Sequence[str], robots: Sequence[str], scene: str, robot: str) -> None:
        gui, page = self._gui, self._page
        self.scene = gui.add_dropdown("Scene", tuple(scenes), initial_value=scene)
        self.robot = gui.add_dropdown("Robot", tuple(robots), initial_value=robot)
        self.arm = gui.add_dropdown("Arm", ("any",), disabled=True)
        self.verb = gui.add_dropdown("Task", VERBS)
        self.target = gui.add_dropdown("Object", ("-",))
        self.to = gui.add_text("How far", "", hint="60deg, 0.3m or max; empty: 90deg, or the slide")
        with gui.add_folder("More", expand_by_default=False):
            self.method = gui.add_dropdown("Method", METHODS)
            self.seed = gui.add_number("Seed", 0, min=0, max=2**31 - 1, step=1)
            self._button("Start where the robot stands", page.start_here)
            self._button("Start of the scene", page.start_of_scene)
        self.place = self._button("Place", page.place, color="blue", hint="Key P")
        self.place_here = self._button("Plan from where it stands", page.place_here)
        self.stop = self._button("Stop", page.stop, hint="Key X", disabled=True)
        self.result = gui.add_markdown("Loading.")
        with gui.add_folder("Compare", expand_by_default=False):
            self._button("Keep this answer", lambda: page.compare.keep())
            self._button("Forget what was kept", lambda: page.compare.forget())
            self.beside = gui.add_checkbox("Side by side", False)
            self._listen(self.beside, lambda: page.compare.arrange())
            self.kept = gui.add_markdown("Nothing is kept.")
        for handle in (self.scene, self.robot, self.arm, self.verb, self.target, self.to,
                       self.method, self.seed):  # fmt: skip
            self._listen(handle, page.change)

    def _motion(self) -> None:
        gui, page = self._gui, self._page
        self.play = self._button(
            "Play", lambda: page.motion.toggle(), hint="Key K, or space", disabled=True
        )
        self.time = gui.add_slider("Time [s]", min=0.0, max=1.0, step=0.01, initial_value=0.0,
                                   disabled=True)  # fmt: skip
        self._listen(self.time, lambda: page.motion.seek(float(self.time.value)))
        self.speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1")
        self._listen(self.speed, lambda: page.motion.set_speed(float(self.speed.value)))
        self.moment = gui.add_markdown("There is no motion yet.")
        self.joints_folder = gui.add_folder("Joints of the object")
        self._joints: dict[str, tuple[JointRange, Any]] = {}

    def _layers(self) -> None:
        gui, page = self._gui, self._page
        with gui.add_folder("Scan", visible=False) as self.scan_folder:
            self.cloud = gui.add_dropdown("Points", CLOUDS)
            self.points = gui.add_dropdown("How many", tuple(POINTS))
            self.points_shown = gui.add_markdown("")
            self.boxes = gui.add_checkbox("Boxes and names", True)
            self.furniture = gui.add_checkbox("Scene of it", True)
        for handle in (self.cloud, self.points, self.boxes):
            self._listen(handle, lambda: page.scan.changed())
        self._listen(self.furniture, lambda: page.room.set_visible(self.furniture.value))
        self.layers = {key: gui.add_checkbox(words, key in SHOWN) for key, words in LAYERS.items()}
        self.dark = gui.add_checkbox("Dark page", False)
        self._listen(self.dark, lambda: set_theme(gui, dark=bool(self.dark.value)))
        self.plain = gui.add_checkbox("Plain light", False, hint=PLAIN)
        self._listen(self.plain, lambda: page.light.changed())
        self.height = gui.add_slider("Height of reach [m]", min=0.0, max=2.0, step=0.05,
                                     initial_value=0.9)  # fmt: skip
        for handle in self.layers.values():
            self._listen(handle, lambda: page.layers.changed())
        self._listen(self.layers["collision"], lambda: page.answer.change_look())
        self._listen(self.height, lambda: page.layers.height_changed())
        self.legend = gui.add_html("")
        self.clicked = gui.add_markdown("Click a candidate: why it was refused.")

    def _files(self) -> None:
        gui, page = self._gui, self._page
        self.plan_name = gui.add_text("Plan", "plan.json")
        self._button("Save the plan", lambda: page.extras.save_plan(self.plan_name.value))
        self.scene_name = gui.add_text("Scene", "scene.json")
        self._button("Save the scene", lambda: page.extras.save_scene(self.scene_name.value))
        picture = gui.add_button("Picture (PNG)")
        picture.on_click(lambda event: page.extras.picture(event.client))
        for words, ending in FILM_KINDS.items():
            film = gui.add_button(words)
            film.on_click(lambda event, ending=ending: page.extras.film(event.client, ending))
        for handle in (self.plan_name, self.scene_name):
            self._listen(handle, lambda: None)  # what is typed is read when it is saved
        self.files = gui.add_markdown("Files go into the folder where the page was started.")

    def _keys(self) -> None:
        page = self._page
        keys: Mapping[str, tuple[Any, Callable[[], None]]] = {
            "Place": ("P", page.place), "Stop": ("X", page.stop),
            "Play or pause": ("space", lambda: page.motion.toggle()),
            # The space bar presses what has the focus, such as the tab that was clicked last.
            "Play or pause, too": ("K", lambda: page.motion.toggle()),
            "Back by 1 s": ("J", lambda: page.motion.step(-1.0)),
            "On by 1 s": ("L", lambda: page.motion.step(1.0)),
            "Look at the whole room": ("H", page.look_at_room),
        }  # fmt: skip
        for label, (key, action) in keys.items():
            command = self._gui.add_command(label, hotkey=key)
            command.on_trigger(lambda _, action=action: action())

    def _button(
        self, label: str, action: Callable[[], None], *, color: Any = None, hint: str | None = None,
        disabled: bool = False,
    ) -> Any:  # fmt: skip
        button = self._gui.add_button(label, color=color, hint=hint, disabled=disabled)
        button.on_click(lambda _: action())
        return button

    def _listen(self, handle: Any, action: Callable[[], None]) -> None:
        """Call an action when a person changes a control; not when the page itself does."""

        def changed(event: Any) -> None:
            if event.client is not None:
                self._page.settled.control(handle)
                action()

        handle.on_update(changed)

    # ---------------------------------------------------------------------------- what is shown

    def offer(self, handle: Any, options: Sequence[str], value: str) -> str:
        """Offer other choices; the one that is chosen then is the one named, where it is there."""
        given = tuple(options) or ("-",)
        if handle.options != given:
            handle.options = given
        chosen = value if value in given else given[0]
        if handle.value != chosen:
            handle.value = chosen
        return chosen

    def show_joints(self, joints: Sequence[JointRange]) -> None:
        """A slider for each joint of the object."""
        for _, handle in self._joints.values():
            handle.remove()
        self._joints = {}
        self.joints_folder.visible = bool(joints)
        with self.joints_folder:
            for joint in joints:
                low, high = joint.shown(joint.low), joint.shown(joint.high)
                slider = self._gui.add_slider(
                    f"{joint.name} [{joint.unit}]", min=round(low, 3), max=round(high, 3),
                    initial_value=_within(joint.shown(joint.value), low, high),
                    step=min(FINE[joint.unit], (high - low) / 20),
                )  # fmt: skip
                self._listen(slider, self._page.motion.move_joints)
                self._joints[joint.name] = joint, slider

    @property
    def joint_values(self) -> dict[str, float]:
        """Joints of the object that do not stand as the scene has them [rad] or [m]."""
        values = {name: joint.meant(float(s.value)) for name, (joint, s) in self._joints.items()}
        return {n: v for n, v in values.items() if abs(v - self._joints[n][0].value) > SEEN}

    def show_joint_values(self, values: Mapping[str, float]) -> None:
        """Where joints of the object stand [rad] or [m]; others are as the scene has them."""
        for name, (joint, slider) in self._joints.items():
            shown = joint.shown(values.get(name, joint.value))
            slider.value = _within(shown, float(slider.min), float(slider.max))

    def show_busy(self, busy: bool) -> None:
        """Whether there is anything to stop."""
        self.stop.disabled = not busy

    def show_story(self, duration: float) -> None:
        """How long the motion takes [s]; 0 where there is none."""
        self.play.disabled = self.time.disabled = duration <= 0
        self.time.value = 0.0
        if duration > 0:
            self.time.max = math.ceil(100 * duration) / 100  # whole steps of the slider

    def show_playing(self, playing: bool) -> None:
        """Whether the motion goes on."""
        label = "Pause" if playing else "Play"
        if self.play.label != label:
            self.play.label = label

    def show_moment(self, seconds: float, words: str) -> None:
        """Where the motion stands."""
        self.time.value = min(round(seconds, 2), float(self.time.max))
        self.moment.content = f"{seconds:.1f} s: {words}"


def _within(value: float, low: float, high: float) -> float:
    """A value that a slider can stand at, with as many digits as are read."""
    return min(max(round(value, 3), round(low, 3)), round(high, 3))
