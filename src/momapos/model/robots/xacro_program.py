"""Expand one xacro file; the program of the process that `expand_xacro` starts.

It prints JSON: the URDF or the reason why there is none, the tags without a prefix, and the
switches that are off. No file runs code in it: `xacro_expressions` evaluates what the library gives
to `eval`, and `Gate` refuses files outside the folders of the robot, and everything but reading.
"""

from __future__ import annotations

import json
import os
import re
import resource
import stat
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

OLD_TAGS = ("if", "unless", "include", "arg", "property", "macro", "insert_block", "call")
"""Tags that xacro expanded without its prefix until ROS Melodic."""
MAX_CALLS, MAX_FILE_BYTES = 100_000, 20_000_000
"""Largest number of elements and macros [-], of which Stretch 4 has 1,530, and size of a file
[bytes]."""
_OPTENV = re.compile(r"\$\(optenv\s+(\w+)\s*([^()]*)\)")
ARGUMENT = "--xacro-arg "
"""Prefix of the switches that are arguments; the others are environment variables."""
_OFF = ("", "0", "false", "none")
"""Defaults of switches that leave something out."""
_FORBIDDEN = ("ctypes", "exec", "os", "pty", "shutil", "socket", "subprocess")
"""First words of the events that `Gate` refuses: calls that do more than compute."""


class Refused(Exception):
    """A file asks for what no file needs."""


class Gate:
    """Lets the process read files of some folders, and nothing else.

    The grammar of expressions leaves no path to other calls; the gate holds if it has a hole.
    """

    def __init__(self, roots: list[str]) -> None:
        """Name the folders; the gate is open."""
        self.roots = [os.path.realpath(root) for root in roots]
        self._trusted = False

    def close(self) -> None:
        """Close the gate, for good; no module can be loaded from then on."""
        sys.addaudithook(self._check)

    @contextmanager
    def trusted(self) -> Iterator[None]:
        """Allow everything while packages are looked up in the folders that the user has set."""
        before, self._trusted = self._trusted, True
        try:
            yield
        finally:
            self._trusted = before

    def _check(self, event: str, details: tuple[Any, ...]) -> None:
        if self._trusted:
            return
        if event == "open":
            path, _, flags = details
            if isinstance(path, int):
                return
            if flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC):
                raise Refused(f"writing {path!r:.200} is not allowed in a file")
            self._check_file(os.fsdecode(path))
        elif event in ("os.listdir", "os.scandir"):
            self._check_inside(os.fsdecode(details[0] or "."))
        elif event.partition(".")[0] in _FORBIDDEN:
            raise Refused(f"{event} is not allowed in a file")

    def _check_file(self, path: str) -> None:
        self._check_inside(path)
        try:
            status = os.stat(path)
        except OSError:
            return  # opening it reports why
        if not stat.S_ISREG(status.st_mode):
            raise Refused(f"{path!r:.200} is not a regular file")
        if status.st_size > MAX_FILE_BYTES:
            raise Refused(f"{path!r:.200} is larger than {MAX_FILE_BYTES / 1e6:g} MB")

    def _check_inside(self, path: str) -> None:
        real = os.path.realpath(path)
        if not any(real == root or real.startswith(root.rstrip("/") + "/") for root in self.roots):
            raise Refused(f"{path!r:.200} is outside {self.roots[0]}, where the file is")


class Files:
    """What all files of a robot say, as xacro reads them."""

    def __init__(self, library: Any, *, old: bool) -> None:
        """Watch what the library reads.

        Args:
            library: The module xacro, which is changed.
            old: Whether tags and macros without a prefix are expanded.
        """
        self._call, self._library = library.handle_macro_call, library
        self._resolve, self._old = library.resolve_macro, old
        self._calls = 0
        self.old_tags: set[str] = set()
        self.switches: dict[str, str] = {}
        """Arguments and environment variables that are off by default, with their defaults."""
        library.parse = self.parse
        library.handle_macro_call = self.call

    def parse(self, source: Any, filename: str | None = None) -> Any:
        """Read a file as xacro does, but no document with entities."""
        from defusedxml import minidom

        if source is None:
            try:
                with open(os.path.join(self._library.root_dir, filename or ""), "rb") as file:
                    source = file.read(MAX_FILE_BYTES)
            except OSError as error:  # an optional file; the library reads the cause
                self._library.filestack.pop()
                words = f"{error.strerror}: {error.filename}"
                raise self._library.XacroException(words, exc=error) from error
        document = minidom.parseString(source)
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
        self._calls += 1
        if self._calls > MAX_CALLS:
            raise Refused(f"more than {MAX_CALLS} elements and macros")
        if self._old and ":" not in node.tagName:
            try:
                self._resolve(node.tagName, macros, symbols)
            except KeyError:
                return False
            node.tagName = f"xacro:{node.tagName}"
        return self._call(node, macros, symbols)


def confine(library: Any, substitution_args: Any, packages: Any, gate: Gate) -> None:
    """Evaluate the expressions of a library by our grammar, within its files.

    Args:
        library: The module xacro, which is changed.
        substitution_args: Its module for `$(...)`, which is changed.
        packages: The module that finds packages by name.
        gate: It learns the folders of the packages.
    """
    from .xacro_expressions import MATH, PYTHON, Function, evaluate

    def find(name: str) -> str:
        if not re.fullmatch(r"[\w.-]*\w[\w.-]*", name):
            raise Refused(f"{name!r:.80} is not the name of a package")
        with gate.trusted():
            folder = os.path.realpath(packages.get_path(name))
        gate.roots.append(folder)
        return folder

    def substitute(text: str, context: Mapping[str, Any]) -> str:
        """Evaluate `$(eval ...)`, whose names are the arguments of the file."""
        convert, given = substitution_args.convert_value, context.get("arg", {})
        functions = {
            "arg": lambda name: convert(substitution_args._eval_arg(name, given), "auto"),
            "dirname": lambda: substitution_args._eval_dirname(context["filename"]),
            "env": substitution_args._eval_env, "optenv": substitution_args._eval_optenv,
            "find": find,
        }  # fmt: skip
        known = {name: convert(value, "auto") for name, value in given.items()}
        known |= {name: PYTHON[name] for name in ("list", "dict", "map", "str", "float", "int")}
        known |= MATH | {name: Function(name, run) for name, run in functions.items()}
        return str(evaluate(text, {**known, "true": True, "false": False}))

    _name_functions(library)
    library.safe_eval = lambda text, names, _=None: evaluate(text, names)
    substitution_args._eval, substitution_args._eval_find = substitute, find


def _name_functions(library: Any) -> None:
    """Replace the global names of the library; its messages, which nobody reads, are dropped."""
    from .xacro_expressions import MATH, PYTHON, Function, checked

    def silent(*_: Any, **__: Any) -> str:
        return ""

    def fatal(*words: Any) -> None:
        raise Refused(" ".join(map(str, words)))

    def tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
        return [part for part in re.split(f"[{re.escape(sep)}]", text) if part or not skip_empty]

    messages = ("message", "warning", "error", "print_location")
    functions = {
        "load_yaml": lambda name: checked(library.load_yaml(name)),
        "abs_filename": library.abs_filename_spec, "dotify": library.YamlDictWrapper,
        "arg": lambda name: library.substitution_args_context["arg"][name],
        "fatal": fatal, "tokenize": tokenize, **dict.fromkeys(messages, silent),
    }  # fmt: skip
    xacro = {name: Function(name, run) for name, run in functions.items()}
    names = library._global_symbols
    names.clear()
    for space, content in (("math", MATH), ("python", PYTHON), ("xacro", xacro)):
        names[space] = library.NameSpace()
        dict.update(names[space], content)
    plain = (
        "list", "dict", "map", "len", "str", "float", "int", "bool", "min", "max", "round",
        "sorted", "range",
    )  # fmt: skip
    names |= MATH | {name: PYTHON[name] for name in plain}
    names |= {name: xacro[name] for name in ("load_yaml", "abs_filename", "dotify")}
    for name in messages:
        setattr(library, name, silent)


def main() -> None:
    """Expand the file that the arguments name, as JSON; print the result as JSON."""
    asked = json.loads(sys.argv[1])
    # The folder of the file may hold modules, and an empty entry of the path would import them.
    sys.path[:] = [os.path.abspath(folder) for folder in sys.path]
    os.chdir(asked["folder"])  # paths of included files are relative to it
    resource.setrlimit(resource.RLIMIT_CPU, (asked["seconds"],) * 2)
    resource.setrlimit(resource.RLIMIT_AS, (asked["memory"],) * 2)
    import yaml  # noqa: F401  the library loads it later
    from defusedxml import minidom  # noqa: F401
    from xacrodoc import XacroDoc, packages, xacrodoc

    packages.update_package_cache(asked["packages"])
    gate = Gate([*asked["roots"], *asked["packages"].values()])
    files = Files(xacrodoc.xacro, old=asked["old"])
    confine(xacrodoc.xacro, xacrodoc.substitution_args, packages, gate)
    answer: dict[str, Any] = {}
    gate.close()
    try:
        doc = XacroDoc.from_file(
            asked["file"], walk_up=False, subargs=dict(asked["args"]), resolve_packages=False
        )
        left = {one.tagName for one in doc.dom.documentElement.childNodes if one.nodeType == 1}
        answer |= {"urdf": doc.dom.toxml(), "whole": not left & set(OLD_TAGS)}
        if len(answer["urdf"]) > asked["largest"]:
            raise Refused(f"it expands to more than {asked['largest'] / 1e6:g} MB")
    except Exception as error:
        answer = {"error": " ".join(str(error).split()) or type(error).__name__}
    off = {name: value for name, value in files.switches.items() if _is_open(name, asked["args"])}
    json.dump({**answer, "old_tags": sorted(files.old_tags), "off": off}, sys.stdout)


def _is_open(switch: str, args: dict[str, str]) -> bool:
    """Return whether no argument sets a switch."""
    return switch.removeprefix(ARGUMENT) not in args


if __name__ == "__main__":
    main()
