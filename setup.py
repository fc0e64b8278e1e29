"""Builds the hot path in C and Cython. Without a compiler, Robbie-MP does the same in Python."""

import os
import runpy
import shutil
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import BaseError, CCompilerError

FOLDER = Path("robbie_mp/bus/_hot")
STRICT = os.environ.get("ROBBIE_STRICT_BUILD", "") not in ("", "0")
"""Whether warnings of the compiler, and its absence, are errors."""
FLAGS = ("-std=c11", "-O2", "-fvisibility=hidden", "-Wall", "-Wextra")
sources = runpy.run_path(str(FOLDER / "sources.py"))


class BuildHotPath(build_ext):
    """Builds the hot path, or says in one line why not."""

    def finalize_options(self) -> None:
        """Build it even if it looks new: the times of files say nothing about what they contain."""
        super().finalize_options()
        self.force = True

    def build_extension(self, ext: Extension) -> None:
        """Build it if this is possible here."""
        try:
            if lack := self.what_is_missing():
                raise CCompilerError(lack)
            made = Path(self.build_temp)
            made.mkdir(parents=True, exist_ok=True)
            ext.sources.append(str(sources["write_c"](FOLDER, made, *(["-Werror"] if STRICT else []))))
            ext.include_dirs.append(str(made))
            super().build_extension(ext)
        except (BaseError, CCompilerError, RuntimeError) as error:
            if STRICT:
                raise
            reason = " ".join(str(error).split())
            print(f"Robbie-MP uses Python for its hot path, which is slower: {reason}", file=sys.stderr)

    def what_is_missing(self) -> str:
        """Say what a compiler would complain about at length; '' if nothing."""
        command = getattr(self.compiler, "compiler_so", None) or ["cc"]
        if shutil.which(command[0]) is None:
            return f"there is no C compiler ({command[0]}); install gcc"
        header = Path(sysconfig.get_path("include"), "Python.h")
        if not header.is_file():
            return f"the headers of Python are not installed ({header}); install python3-dev"
        if find_spec("Cython") is None:
            return "Cython is not installed; install it with pip (pip install cython)"
        return ""


setup(
    cmdclass={"build_ext": BuildHotPath},
    ext_modules=[
        Extension(
            "robbie_mp.bus._hot.native",
            sources=sorted(str(path) for path in FOLDER.glob("*.c")),
            define_macros=[("ROBBIE_SOURCES", f'"{sources["digest"](FOLDER)}"')],
            include_dirs=[str(FOLDER)],
            extra_compile_args=[*FLAGS, *(["-Werror"] if STRICT else [])],
            optional=not STRICT,
        )
    ],
)
