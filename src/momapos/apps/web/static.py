"""A plan as one HTML file that plays in any browser, without a server or network."""

from __future__ import annotations

import html
import json
import sys
import tempfile
import webbrowser
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import InputError, escape_html, write_file
from momapos.model.records import PlacementPlan, ToolPose
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning import PlacementResult, ReachStudy

from .cameras import DAY, DAY_INTENSITY, frame, lamps
from .card import Card
from .colors import INFEASIBLE, rgb
from .map_layers import draw_path
from .playback import RATE, Playable, Story
from .robot_view import RobotView
from .room_view import LIGHT, RoomView, large, sky
from .serve import open_server, quiet
from .words import answer_card, plan_card, target_text

if TYPE_CHECKING:
    from jaxtyping import Float


# viser makes the canvas almost transparent until its environment map has loaded, which it does each
# time the motion repeats, without an end.
STYLE = """<style>
canvas{opacity:1!important}
#mm-answer{position:fixed;top:.8em;right:.8em;width:21em;max-width:42vw;z-index:5;font-family:
system-ui,sans-serif;background:#fffffff2;color:#1d2731;border-radius:.4em;box-shadow:0 0 1em #0002}
#mm-answer .mm-card{margin:0;border-color:#dfe3e6;font-size:.9em}#mm-answer .d{color:#5c6873}
#mm-answer>summary{padding:.4em .8em;cursor:pointer;font-weight:600;font-size:.9em}
#mm-phases{position:fixed;left:95px;right:98px;bottom:40px;height:2.3em;z-index:5;display:flex;
gap:2px;font:.75em system-ui,sans-serif}
#mm-phases button{border:0;padding:0 .1em;overflow:hidden;font:inherit;line-height:1.1;
background:#fffffff2;color:#5c6873;cursor:pointer;min-width:2px;border-radius:2px}
#mm-now{position:fixed;left:95px;right:98px;bottom:calc(44px + 1.8em);z-index:5;text-align:center;
font:600 .85em system-ui,sans-serif;color:#1d2731;text-shadow:0 0 3px #fff,0 0 3px #fff;
pointer-events:none}
#mm-phases button.on{background:#2a7ab8;color:#fff;font-weight:600}
@media(max-width:700px){#mm-answer{font-size:.75em}}
@media(max-height:420px){#mm-answer{display:none}}
</style>"""
SCRIPT = """<script>
(function(){const phases=%s,bar=document.getElementById("mm-phases");
const time=()=>document.querySelector("#root input, input");
function go(t){const box=time();if(!box)return;
Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,"value").set.call(box,t.toFixed(2));
box.dispatchEvent(new Event("input",{bubbles:true}));}
phases.forEach(([name,begin,end])=>{const one=document.createElement("button");
one.dataset.name=name.replace(/^task (\\d+) of \\d+, [^:]*: /,"$1 ").replace(" the "," ");
one.title=name;one.setAttribute("aria-label",name);
one.style.flex=(end-begin)+" 1 0";
one.onclick=()=>go(begin+.02);bar.appendChild(one);});
const rest=document.createElement("i");
rest.style.flex=bar.dataset.pause+" 1 0";bar.appendChild(rest);
const fit=()=>phases.forEach((_,k)=>{const one=bar.children[k];one.textContent=one.dataset.name;
if(one.scrollWidth>one.clientWidth||one.scrollHeight>one.clientHeight)one.textContent="";});
fit();addEventListener("resize",fit);const now=document.getElementById("mm-now");
setInterval(()=>{const box=time();if(!box)return;const t=parseFloat(box.value);
let shown="";phases.forEach(([name,begin,end],k)=>{const on=t>=begin-.05&&t<end-.05;
bar.children[k].classList.toggle("on",on);if(on)shown=name;});now.textContent=shown;
},100);})();
</script>"""
Phase = tuple[str, float, float]
"""Name, begin and end of a phase [s]."""


def phases(words: Sequence[str], step: float) -> list[Phase]:
    """Join the images of a film that show the same phase.

    Args:
        words: The phase of each image.
        step: Time between images [s].
    """
    found: list[Phase] = []
    for k, name in enumerate(words):
        if found and found[-1][0] == name:
            found[-1] = (name, found[-1][1], (k + 1) * step)
        else:
            found.append((name, k * step, (k + 1) * step))
    return found


def with_overlay(page: str, card: Card, found: Sequence[Phase], pause: float) -> str:
    """Add title, answer and phases to a page of viser.

    Args:
        page: The page as HTML.
        card: The answer.
        found: The phases of the motion.
        pause: Time after the last phase [s].
    """
    title = f"{card.title}: {card.headline.lower()}" if card.title else card.headline
    summary, content = card.title or "The answer", replace(card, title="").html
    # A closing tag in a name would end the script.
    rows = json.dumps([[n, round(a, 3), round(b, 3)] for n, a, b in found]).replace("<", "\\u003c")
    overlay = (
        f'{STYLE}<details id="mm-answer" open><summary>{escape_html(summary)}</summary>'
        f"{content}</details>"
        f'<div id="mm-now"></div><div id="mm-phases" data-pause="{pause}"></div>{SCRIPT % rows}'
    )
    begin, end = page.index("<title>"), page.index("</title>")
    head, body = page[:begin], page[end + len("</title>") :]
    tail = body.rindex("</body>")
    return f"{head}<title>{escape_html(title)}</title>{body[:tail]}{overlay}{body[tail:]}"


ENDINGS = (".html", ".htm")
PAUSE_AT_END = 1.5
"""Time for which the last moment stays before the motion repeats [s]."""
CLOSE = 0.85
"""Distance of the camera relative to the one at which robot and object fit [-]."""
SPEED = 2.0
"""Playback speed, where 1 is real time [-]."""


def check_page(path: Path) -> None:
    """Check, before the work, that a page can be written to a path.

    Raises:
        InputError: The file ending is not that of a page, or the path is a folder.
    """
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"{path}: unsupported page format; use {' or '.join(ENDINGS)}")
    if path.is_dir():
        raise InputError(f"{path}: cannot be written (it is a folder)")


def write_page(
    scene: Scene,
    robot: Robot,
    plan: PlacementPlan,
    path: Path,
    *,
    story: Playable | None = None,
    active: str | None = None,
    card: Card | None = None,
) -> None:
    """Write a solved plan as a page that plays it in a loop.

    Args:
        scene: The room before the task.
        robot: The robot of the plan.
        plan: The plan.
        path: An HTML file; its folder is created if needed.
        story: The motion to play; by default that of the plan.
        active: What moves, as "object" or "object/joint"; by default that of the plan.
        card: The answer in words; by default that of the plan.

    Raises:
        InputError: The plan is not solved, or the file cannot be written.
    """
    check_page(path)
    content = page_of(scene, robot, plan, story, active, card)
    write_file(path, content)


def page_of(
    scene: Scene,
    robot: Robot,
    plan: PlacementPlan,
    story: Playable | None = None,
    active: str | None = None,
    card: Card | None = None,
) -> str:
    """Return the page as HTML; see `write_page`."""
    story = story or Story.of(plan, robot, scene)
    server = open_server("127.0.0.1", 0)  # viser records only what a server has drawn
    try:
        target = active or target_text(plan.task)
        last = story.at(story.duration).base
        room, robot_view = _furnish(server, scene, target, robot, story.at(0.0).base, last)
        if plan.base_path is not None:
            draw_path(server.scene, "/path", plan.base_path)
        if plan.motion is not None and plan.motion.base is not None:
            draw_path(server.scene, "/base", plan.motion.base)
        recording = server.get_scene_serializer()
        words = []
        for seconds in _times(story.duration):
            moment = story.at(seconds)
            moment.show(room, robot_view)
            words.append(moment.phase)
            recording.insert_sleep(1.0 / RATE)
        recording.insert_sleep(PAUSE_AT_END)
        html: str = with_overlay(
            recording.as_html(),
            card or plan_card(plan, scene),
            phases(words, 1.0 / RATE),
            PAUSE_AT_END,
        )
    finally:
        with quiet():
            server.stop()
    return html


def _furnish(
    server: Any,
    scene: Scene,
    target: str,
    robot: Robot,
    base: Float[np.ndarray, "3"],
    last: Float[np.ndarray, "3"],
) -> tuple[RoomView, RobotView]:
    """Draw a room and a robot at a base pose; the camera looks at the target from the last one."""
    frame(server, scene, target, np.array([last]), close=CLOSE)
    lamps(server.scene, LIGHT, plain=large(scene))
    server.scene.configure_default_lights(enabled=False, cast_shadow=False)
    server.scene.configure_environment_map(
        None if large(scene) else DAY, environment_intensity=DAY_INTENSITY
    )
    server.scene.set_background_image(sky(LIGHT), format="png")
    room, robot_view = RoomView(server.scene), RobotView(server.scene)
    name, _, joint = target.partition("/")
    room.show(scene, name, joint or None)
    robot_view.show(robot, base)
    robot_view.verdict("feasible")
    return room, robot_view


WELL_REACHED = ("#dde318", "#21918c", "#440f5c")
"""Colors of points from barely to best reached, for all kinds of color vision."""
POINT = 0.02
"""Size of a point on a surface [m]."""


def write_study_page(
    scene: Scene,
    robot: Robot,
    surface: str,
    poses: Sequence[ToolPose],
    study: ReachStudy,
    path: Path,
) -> None:
    """Write a page with a surface's points, colored by how well the robot reaches each.

    Args:
        scene: The room.
        robot: The robot, drawn at the base pose with its arm at home.
        surface: The object, or a part of it as OBJECT/PART.
        poses: Tool poses at its points.
        study: How well each is reached; red points are not.
        path: An HTML file; its folder is created if needed.

    Raises:
        InputError: No base pose reaches a point, or the file cannot be written.
    """
    check_page(path)
    if study.base_pose is None:
        raise InputError(f"{surface}: no base pose reaches a point, so there is no page to write")
    points = np.array([pose.xyz for pose in poses])
    share = study.dexterity / max(float(study.dexterity.max()), 1e-9)
    stops = np.array([rgb(color) for color in WELL_REACHED])
    at = np.linspace(0.0, 1.0, len(stops))
    shades = np.stack([np.interp(share, at, column) for column in stops.T], axis=1)
    shades[~study.reached] = rgb(INFEASIBLE)
    server = open_server("127.0.0.1", 0)
    try:
        base = np.array(study.base_pose)
        _furnish(server, scene, surface.partition("/")[0], robot, base, base)
        server.scene.add_point_cloud(
            "/points",
            points.astype(np.float32),
            shades.astype(np.uint8),
            point_size=POINT,
            point_shape="circle",
            precision="float32",
        )
        recording = server.get_scene_serializer()
        recording.insert_sleep(PAUSE_AT_END)
        reached = f"{int(study.reached.sum())} of {len(poses)} points are reached"
        words = Card(reached, "good", f"{robot.title} reaches {surface}")
        html = with_overlay(recording.as_html(), words, [("study", 0.0, 1.0)], PAUSE_AT_END)
    finally:
        with quiet():
            server.stop()
    write_file(path, html)


def _times(duration: float) -> Sequence[float]:
    times: Float[np.ndarray, " t"] = np.arange(0.0, duration, SPEED / RATE)
    return [*times.tolist(), duration]


HEIGHT = 480
"""Height of the page in a notebook [px]."""


def show(answer: PlacementResult) -> None:
    """Play a solved plan.

    Raises:
        InputError: The plan is not solved.
    """
    prepared = answer.prepared
    page = page_of(prepared.scene, prepared.robot, answer.plan, card=answer_card(answer))
    # A notebook has imported IPython already.
    shell = sys.modules.get("IPython")
    if shell is not None and shell.get_ipython() is not None:
        from IPython.display import HTML, display

        display(HTML(frame_of(page)))
        return
    with tempfile.NamedTemporaryFile(
        "w", prefix="momapos-", suffix=".html", delete=False, encoding="utf-8"
    ) as file:
        file.write(page)
    webbrowser.open(Path(file.name).as_uri())


def frame_of(page: str) -> str:
    """Embed a page in a sandboxed frame."""
    # In another element: IPython warns about a bare frame, and wants a URL instead.
    return (
        f'<div><iframe srcdoc="{html.escape(page, quote=True)}" sandbox="allow-scripts" '
        f'style="width:100%;height:{HEIGHT}px;border:0"></iframe></div>'
    )
