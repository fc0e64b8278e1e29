"""What wheels of ROS 2 lack beside a ROS that is installed: `colcon`, and libraries that find each other.

    .venv/ros-jazzy/bin/python tools/ros_wheels.py interfaces FOLDER OUTPUT
    .venv/ros-jazzy/bin/python tools/ros_wheels.py flags

`interfaces` builds Python types of a package for rclpy, with the generators in the wheels and g++. FOLDER has
the package's name and its `msg/*.msg`, `srv/*.srv` and `action/*.action`; OUTPUT, in PYTHONPATH, gets
the package. `flags` prints what g++ needs to link a program. Start it with the Python that has the wheels.
"""

import argparse
import contextlib
import importlib
import io
import json
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROS = Path(sys.prefix)
KINDS = ("msg", "srv", "action")
HASHES = "rosidl_generator_type_description"
WIRE, FIELDS = "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"
"""What FastDDS serializes by, and what describes the fields; rmw_fastrtps_cpp loads both by name."""
LIBRARIES = {
    "rosidl_generator_c": [
        "*/detail/*__functions.c",
        "*/detail/*__description.c",
        "*/detail/*__type_support.c",
    ],
    FIELDS: ["*/detail/*__type_support.c"],
    WIRE: ["*/detail/*__type_support_c.cpp"],
    "rosidl_typesupport_c": ["*/*__type_support.cpp"],
}
"""Libraries of a package, each after those that it needs, and the files that their generators write."""
GENERATORS: list[tuple[Any, ...]] = [
    (HASHES, "generate_type_hash"),
    ("rosidl_generator_c", "generate_c"),
    (FIELDS, "generate_c"),
    (WIRE, "generate_typesupport_fastrtps_c"),
    ("rosidl_typesupport_c", "generate_c", [WIRE, FIELDS]),
    ("rosidl_generator_py", "generate_py", ["rosidl_typesupport_c"]),
]
"""Each with its function, and what that takes beside its file of arguments; the later read the hashes."""
EXTENSION = ["*/_*_s.c", "_*_s.ep.rosidl_typesupport_c.c"]


class Builder:
    """Generates and compiles a package in a temporary folder."""

    def __init__(self, source: Path, output: Path, scratch: Path):
        self.source, self.scratch = source.absolute(), scratch
        self.name = self.source.name
        self.package = output.absolute() / self.name
        self.idl = scratch / "idl"
        self.interfaces = [
            path.relative_to(self.source)
            for kind in KINDS
            for path in sorted((self.source / kind).glob(f"*.{kind}"))
        ]

    def build(self) -> None:
        """Write the package."""
        if not self.interfaces:
            raise SystemExit(f"{self.source} has no msg/*.msg, srv/*.srv or action/*.action")
        for path in self.interfaces:
            kind = path.suffix[1:]
            convert = ros(f"rosidl_adapter.{kind}", f"convert_{kind}_to_idl")
            convert(self.source, self.name, path, self.idl / path.parent)
        for generator, function, *more in GENERATORS:
            ros(generator, function)(self.arguments(generator), *more)
        self.write_visibility()
        made: list[Path] = []
        for library, patterns in LIBRARIES.items():
            made.append(self.compile(library, patterns, f"lib{self.name}__{library}.so", made))
        extension = f"{self.name}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
        self.compile("rosidl_generator_py", EXTENSION, extension, made)
        for path in self.folder("rosidl_generator_py").rglob("*.py"):
            target = self.package / path.relative_to(self.folder("rosidl_generator_py"))
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(path.read_bytes())
        (self.package / "__init__.py").touch()

    def folder(self, generator: str) -> Path:
        """Where a generator writes; the path within it is that of its headers in `#include`."""
        return self.scratch / generator / self.name

    def arguments(self, generator: str) -> str:
        """Write the arguments of a generator; return the file's name."""
        others = [path for path in sorted((ROS / "share").iterdir()) if list(path.glob("*/*.idl"))]
        hashes = self.folder(HASHES)
        found = {
            "package_name": self.name,
            "output_dir": str(self.folder(generator)),
            "template_dir": str(ROS / "share" / generator / "resource"),
            "idl_tuples": [f"{self.idl}:{path.with_suffix('.idl')}" for path in self.interfaces],
            "ros_interface_dependencies": [
                f"{one.name}:{idl}" for one in others for idl in one.glob("*/*.idl")
            ],
            "include_paths": [f"{one.name}:{one}" for one in others],
            "target_dependencies": [],
            "type_description_tuples": [
                f"{path.with_suffix('.idl')}:{hashes / path.with_suffix('.json')}" for path in self.interfaces
            ],
        }
        file = self.scratch / f"{generator}.json"
        file.write_text(json.dumps(found))
        return str(file)

    def write_visibility(self) -> None:
        """Write the headers which CMake makes otherwise."""
        for generator in LIBRARIES:
            for template in (ROS / "share" / generator / "resource").glob("*visibility_control.h.in"):
                text = template.read_text().replace("@PROJECT_NAME@", self.name)
                header = self.folder(generator) / "msg" / template.stem
                header.parent.mkdir(parents=True, exist_ok=True)
                header.write_text(text.replace("@PROJECT_NAME_UPPER@", self.name.upper()))

    def compile(self, generator: str, patterns: list[str], name: str, needed: list[Path]) -> Path:
        """Compile what a generator has written into a library of the package."""
        places = [self.scratch / one for one in LIBRARIES]
        python = [Path(sysconfig.get_paths()["include"]), Path(np.get_include())]
        places += [*python, ROS / "include", *(ROS / "include").iterdir()]
        includes = [f"-I{place}" for place in places]
        objects = []
        for source in (path for pattern in patterns for path in sorted(self.folder(generator).glob(pattern))):
            objects.append(self.scratch / f"{generator}.{source.name}.o")
            compiler = "g++" if source.suffix == ".cpp" else "gcc"
            run([compiler, "-O1", "-fPIC", "-c", *includes, str(source), "-o", str(objects[-1])])
        made = self.package / name
        made.parent.mkdir(parents=True, exist_ok=True)
        # A name in the library lets the loader find it again when rmw_fastrtps_cpp asks for it by that name.
        options = ["-shared", f"-Wl,-soname,{name}", "-Wl,-rpath,$ORIGIN", f"-Wl,-rpath,{ROS / 'lib'}"]
        own = ["-Wl,--no-as-needed", *map(str, needed), "-Wl,--as-needed"]
        others = map(str, sorted((ROS / "lib").glob("lib*.so")))
        run(["g++", *options, *map(str, objects), "-o", str(made), *own, *others])
        return made


def ros(module: str, function: str) -> Callable[..., Any]:
    """Return a function of the wheels."""
    try:
        return getattr(importlib.import_module(module), function)  # type: ignore[no-any-return]
    except ImportError:
        raise SystemExit(
            f"{sys.executable} has no {module}; start this with the Python of ROS's wheels"
        ) from None


def run(command: list[str]) -> None:
    """Run a command; end with what it says if it fails."""
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")


def build(options: argparse.Namespace) -> None:
    """Build a package."""
    # The generators print what they do.
    with tempfile.TemporaryDirectory() as scratch, contextlib.redirect_stdout(io.StringIO()):
        Builder(options.folder, options.output, Path(scratch)).build()


def print_flags(_: argparse.Namespace) -> None:
    """Print options for the linker: wheels keep libraries in several folders, and some need Python's own."""
    python = sysconfig.get_config_var("LIBDIR")
    places = [ROS / "lib", *sorted(Path(np.__file__).parents[1].glob("ros_*.libs")), python]
    tolerant = "--disable-new-dtags,--unresolved-symbols=ignore-in-shared-libs,--no-warnings,--no-as-needed"
    version = f"python{sysconfig.get_config_var('LDVERSION')}"
    found = (f"-Wl,-rpath,{place}" for place in places)
    print(f"-Wl,{tolerant}", f"-L{python}", f"-l{version}", *found)


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)
    interfaces = commands.add_parser("interfaces", help="build a package of interfaces for rclpy")
    interfaces.add_argument("folder", type=Path, help="the package: msg/*.msg, srv/*.srv, action/*.action")
    interfaces.add_argument("output", type=Path, help="where the Python package goes")
    interfaces.set_defaults(run=build)
    commands.add_parser("flags", help="print options for the linker").set_defaults(run=print_flags)
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
