"""Complete the names of scenes, robots, objects and suites in a shell."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

from momapos.core import MomaposError, read_xml
from momapos.model.robots import library_names
from momapos.model.scene import builtin_names, find_scene

COMPLETE_NAMES = "--complete-names"
"""Hidden option of `momapos`: print the names that can stand at the end of a command line."""
MAX_BYTES = 5_000_000
"""Largest file that is read while a user types [bytes]."""
_SCENE, _ROBOT, _OBJECT, _PART, _SUITE = "scene", "robot", "object", "part", "suite"
_SHOWN = "scene or robot"
_POSITIONS = {
    ("place", "open"): (_SCENE, _PART), ("place", "close"): (_SCENE, _PART),
    ("place", "press"): (_SCENE, _PART), ("place", "follow"): (_SCENE,),
    ("place", "pick"): (_SCENE, _OBJECT), ("place", "place"): (_SCENE, _OBJECT),
    ("rank",): (_SCENE, _PART), ("view",): (_SHOWN,), ("scene", "show"): (_SCENE,),
    ("scene", "check"): (_SCENE,), ("scene", "convert"): (_SCENE,), ("scene", "scan"): (_SCENE,),
    ("robot", "show"): (_ROBOT,), ("robot", "check"): (_ROBOT,), ("robot", "export"): (_ROBOT,),
    ("reach", "build"): (_ROBOT,), ("reach", "eval"): (_ROBOT,),
    ("reach", "study"): (_ROBOT,), ("bench", "run"): (_SUITE,),
}  # fmt: skip
"""What the arguments without an option name, by command."""
_OPTIONS = {"--robot": _ROBOT, "--robots": _ROBOT, "--world": _SCENE, "--joint": _PART}
_SCRIPTS = {
    "bash": f"""
_momapos_names() {{
  _tyro_momapos "$@"
  local cur="${{COMP_WORDS[COMP_CWORD]}}" name word
  [[ ${{#COMPREPLY[@]}} = 1 && -z ${{COMPREPLY[0]}} ]] && COMPREPLY=()  # tyro's for nothing
  while IFS= read -r name; do
    printf -v word %q "$name"
    [[ -n $name && ( $name == "$cur"* || $word == "$cur"* ) ]] && COMPREPLY+=("$word")
  done < <(momapos {COMPLETE_NAMES} "${{COMP_WORDS[@]:1:COMP_CWORD-1}}" 2>/dev/null)
}}
complete -o default -F _momapos_names momapos
""",
    "zsh": f"""
_momapos_names() {{
  local -a names
  names=(${{(f)"$(momapos {COMPLETE_NAMES} ${{words[2,CURRENT-1]}} 2>/dev/null)"}})
  [[ -n "$names" ]] && compadd -a names
  _tyro_momapos "$@"
  (( compstate[nmatches] )) || _files
}}
(( $+functions[compdef] )) || {{ autoload -Uz compinit; compinit; }}
compdef _momapos_names momapos
""",
    "fish": f"""
complete --command momapos --arguments "(momapos {COMPLETE_NAMES} (commandline -opc)[2..-1] \
2>/dev/null)"
complete --command momapos --force-files --condition \
"not string match --quiet -- '-*' (commandline -ct)"
""",
}
"""What follows tyro's script for each shell: names of scenes, robots, objects and suites.

Names come from files of others, so no shell may expand them; bash's `compgen -W` would.
"""
_ZSH_CALL = 'typeset -A opt_args\n_tyro_momapos "$@"'
"""End of tyro's script for zsh, which is the body of a completion function, not one to source."""
SHELLS = tuple(_SCRIPTS)
_SPECIFICATION = re.compile(r"^COMPLETION_SPEC = .*$", re.MULTILINE)
"""What tyro's scripts complete, in one line."""
_CHOICES = re.compile(r"(choices\\?': \[)([^]]*)\]")
"""The choices of an option; fish's script escapes the quotes."""


def completion_script(shell: str, of_tyro: str) -> str:
    """Return the script that a shell sources to complete commands, options and names.

    Args:
        shell: One of `SHELLS`.
        of_tyro: Tyro's script for this shell, which completes commands and options.
    """
    cleaned = _SPECIFICATION.sub(lambda found: _clean(found[0]), of_tyro)
    return cleaned.replace(_ZSH_CALL, "") + _SCRIPTS[shell]


def _clean(specification: str) -> str:
    """Leave out the choice None, order the choices, and put each description in one line."""

    def ordered(found: re.Match[str]) -> str:
        words = sorted(word for word in found[2].split(", ") if "None" not in word)
        return f"{found[1]}{', '.join(words)}]"

    return re.sub(r"\\{1,2}n", " ", _CHOICES.sub(ordered, specification))


def names_for(words: Sequence[str]) -> list[str]:
    """Return the names that can follow the words of a command line, without `momapos`."""
    words = list(words)
    size = 2 if tuple(words[:2]) in _POSITIONS else 1
    positions = _POSITIONS.get(tuple(words[:size]))
    if positions is None:
        return []
    given = _positional(words[size:])
    if words[-1] in _OPTIONS:
        return _names(_OPTIONS[words[-1]], given)
    if words[-1].startswith("--"):
        return []
    if "then" in words:  # a tour: the tasks after the first name no scene
        after = words[len(words) - words[::-1].index("then") :]
        if len(after) != 1:
            return []
        return _names(_PART if after[0] in ("open", "close", "press") else _OBJECT, given)
    return _names(positions[len(given)], given) if len(given) < len(positions) else []


def _positional(words: Sequence[str]) -> list[str]:
    """Return the arguments that belong to no option; an option takes at most one word."""
    return [
        word
        for before, word in zip(["", *words], words, strict=False)
        if not word.startswith("--") and not before.startswith("--")
    ]


def _names(kind: str, given: Sequence[str]) -> list[str]:
    if kind == _SCENE:
        return list(builtin_names())
    if kind == _ROBOT:
        return list(library_names())
    if kind == _SHOWN:
        return [*builtin_names(), *library_names()]
    if kind == _SUITE:
        from momapos.apps.bench import SUITES

        return list(SUITES)
    return _objects(given[0], parts=kind == _PART) if given else []


def _objects(scene: str, *, parts: bool) -> list[str]:
    """Return the objects of a momapos scene, with their joints if requested."""
    try:
        path = find_scene(scene)
        if path.stat().st_size > MAX_BYTES:
            return []
        entries = json.loads(path.read_text(encoding="utf-8-sig"))["objects"]
        names = [name for entry in entries for name in _entry_names(entry, path.parent, parts)]
        return [name for name in names if name.isprintable()]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, MomaposError):
        return []  # the command itself says what is wrong with the file


def _entry_names(entry: dict[str, str], folder: Path, parts: bool) -> list[str]:
    name = entry["name"]
    if not parts or "urdf" not in entry:
        return [] if parts else [name]
    joints = read_xml(folder / entry["urdf"], MAX_BYTES).iter("joint")
    moving = [j.get("name") for j in joints if j.get("type") not in (None, "fixed")]
    return [name, *(f"{name}/{joint}" for joint in moving)] if moving else []
