"""Expand one xacro file; the program of the process that `expand_xacro` starts.

It imports nothing of this package and prints JSON: the URDF or the reason why there is none, the
tags without a prefix, and the switches that are off.
"""

from __future__ import annotations

import json
import os
import re
import resource
import sys
from typing import Any

OLD_TAGS = ("if", "unless", "include", "arg", "property", "macro", "insert_block", "call")
"""Tags that xacro expanded without its prefix until ROS Melodic."""
_OPTENV = re.compile(r"\$\(optenv\s+(\w+)\s*([^()]*)\)")
ARGUMENT = "--xacro-arg "
"""Prefix of the switches that are arguments; the others are environment variables."""
_OFF = ("", "0", "false", "none")
"""Defaults of switches that leave something out."""


class Files:
    """What all files of a robot say, as xacro reads them."""

    def __init__(self, library: Any, *, old: bool) -> None:
        """Watch what the library reads.

        Args:
            library: The module xacro, which is changed.
            old: Whether tags and macros without a prefix are expanded.
        """
        self._parse, self._call = library.parse, library.handle_macro_call
        self._resolve, self._old = library.resolve_macro, old
        self.old_tags: set[str] = set()
        self.switches: dict[str, str] = {}
        """Arguments and environment variables that are off by default, with their defaults."""
        library.parse = self.parse
        if old:
            library.handle_macro_call = self.call

    def parse(self, source: Any, filename: str | None = None) -> Any:
        """Read a file as xacro does."""
        document = self._parse(source, filename)
        for element in document.getElementsByTagName("*"):
            if element.tagName in OLD_TAGS:
                self.old_tags.add(element.tagName)
                if self._old:
                    element.tagName = element.nodeName = f"xacro:{element.tagName}"
            self._note_switches(element)
        return document

    def _note_switches(self, element: Any) -> None:
        name, default = element.getAttribute("name"), element.getAttribute("default")
        if element.tagName == "xacro:arg" and default.strip().lower() in _OFF:
            self.switches[f"{ARGUMENT}{name}"] = default
        for value in dict(element.attributes.items()).values():
            for name, default in _OPTENV.findall(value):
                if name not in os.environ and default.strip().lower() in _OFF:
                    self.switches[f"${name}"] = default

    def call(self, node: Any, macros: Any, symbols: Any) -> Any:
        """Expand a macro, whose name may stand without the prefix."""
        if ":" not in node.tagName:
            try:
                self._resolve(node.tagName, macros, symbols)
            except KeyError:
                return False
            node.tagName = f"xacro:{node.tagName}"
        return self._call(node, macros, symbols)


def main() -> None:
    """Expand the file that the arguments name, as JSON; print the result as JSON."""
    asked = json.loads(sys.argv[1])
    # The folder of the file may hold modules, and an empty entry of the path would import them.
    sys.path[:] = [os.path.abspath(folder) for folder in sys.path]
    os.chdir(asked["folder"])  # paths of included files are relative to it
    resource.setrlimit(resource.RLIMIT_CPU, (asked["seconds"],) * 2)
    resource.setrlimit(resource.RLIMIT_AS, (asked["memory"],) * 2)
    from xacrodoc import XacroDoc, packages, xacrodoc

    packages.update_package_cache(asked["packages"])
    files = Files(xacrodoc.xacro, old=asked["old"])
    answer: dict[str, Any] = {}
    try:
        doc = XacroDoc.from_file(asked["file"], subargs=dict(asked["args"]), resolve_packages=False)
        left = {one.tagName for one in doc.dom.documentElement.childNodes if one.nodeType == 1}
        answer |= {"urdf": doc.dom.toxml(), "whole": not left & set(OLD_TAGS)}
    except Exception as error:
        answer["error"] = " ".join(str(error).split()) or type(error).__name__
    off = {name: value for name, value in files.switches.items() if _is_open(name, asked["args"])}
    json.dump({**answer, "old_tags": sorted(files.old_tags), "off": off}, sys.stdout)


def _is_open(switch: str, args: dict[str, str]) -> bool:
    """Return whether no argument sets a switch."""
    return switch.removeprefix(ARGUMENT) not in args


if __name__ == "__main__":
    main()
