"""What a static page shows over the scene: its title, the answer in words, phases of the motion."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

from momapos.core import escape_html

from .card import Card

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
