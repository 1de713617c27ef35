"""Builds ROS 2 interfaces without a ROS installation: from the wheels of rosidl, by the C compiler.

    python build_interfaces.py OUT PACKAGE_FOLDER...

OUT then goes onto PYTHONPATH. All of a package becomes one extension module: messages in C, their
type support for Fast DDS, and what Python imports. Where ROS is, `colcon build` does the same.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import rosidl_generator_c.cli
from rosidl_adapter import convert_to_idl
from rosidl_generator_py.cli import GeneratePython
from rosidl_typesupport_c.cli import GenerateCTypesupport
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport

PREFIX = Path(sys.prefix)
NEEDS = (
    "action_msgs", "builtin_interfaces", "geometry_msgs", "nav_msgs", "service_msgs", "std_msgs",
    "trajectory_msgs", "unique_identifier_msgs",
)  # fmt: skip
"""Packages whose messages ours hold."""
KINDS = (
    "rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c",
    "rosidl_typesupport_fastrtps_c",
)  # fmt: skip
"""What of each of them ours are linked to."""
RUNTIME = (
    "rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp", "rmw", "rcutils", "fastcdr",
)  # fmt: skip


def described(idl: list[str], descriptions: list[Path]) -> list[str]:
    """Pairs of interfaces and their descriptions, as rosidl_generator_c wants them.

    Its own function pairs them by name alone; GripperCommand is a message and an action.
    """
    found = {Path(path).with_suffix("").parts[-2:]: path for path in descriptions}
    files = [path.rpartition(":")[2] for path in idl]
    return [f"{file}:{found[Path(file).with_suffix('').parts[-2:]]}" for file in files]


rosidl_generator_c.cli.build_type_description_tuples = described


def generate(package: Path, out: Path) -> None:
    """Write the sources of a package's interfaces into a folder of its name."""
    name, made = package.name, out / package.name
    made.mkdir(parents=True)
    (made / "__init__.py").touch()
    kinds = ("msg", "srv", "action")
    files = [p for kind in kinds for p in sorted(package.glob(f"{kind}/*.{kind}"))]
    idl = [
        f"{made / 'idl'}:{written.relative_to(made / 'idl')}"
        for file in files
        for written in [convert_to_idl(package, name, file.relative_to(package), made / "idl")]
    ]
    share = [str(PREFIX / "share")]
    rosidl_generator_c.cli.GenerateC("c").generate(name, idl, share, made)
    GenerateFastRTPSCTypesupport("fastrtps_c").generate(name, idl, share, made)
    only = ["rosidl_typesupport_fastrtps_c"]
    GenerateCTypesupport("c", typesupport_implementations=only).generate(name, idl, share, made)
    only = ["rosidl_typesupport_c"]
    GeneratePython("py", typesupport_implementations=only).generate(name, idl, share, made)


def compile_module(name: str, out: Path) -> None:
    """Compile a package's sources into the module that its Python imports."""
    made = out / name
    includes = [out, sysconfig.get_path("include"), np.get_include(), PREFIX / "include"]
    includes += [p for p in (PREFIX / "include").iterdir() if p.is_dir()]
    libraries = [*RUNTIME, *(f"{need}__{kind}" for need in NEEDS for kind in KINDS)]
    objects = []
    for compiler, ending in (("gcc", ".c"), ("g++", ".cpp")):
        for source in sorted(made.rglob(f"*{ending}")):
            objects.append(f"{source}.o")
            flags = ["-O0", "-w", "-fPIC", *(f"-I{path}" for path in includes)]
            run = [compiler, *flags, "-c", str(source), "-o", objects[-1]]
            subprocess.run(run, check=True)
    target = made / f"{name}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    folder = PREFIX / "lib"
    linked = [f"-L{folder}", f"-Wl,-rpath,{folder}", "-Wl,--no-as-needed"]
    linked += [f"-l{library}" for library in libraries]
    subprocess.run(["g++", "-shared", *objects, *linked, "-o", str(target)], check=True)


def main(out: Path, packages: list[Path]) -> None:
    """Make the interfaces of packages importable from `out`."""
    os.environ["AMENT_PREFIX_PATH"] = sys.prefix
    for package in packages:
        generate(package, out)
        compile_module(package.name, out)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), [Path(path).resolve() for path in sys.argv[2:]])
