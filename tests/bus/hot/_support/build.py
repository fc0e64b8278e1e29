"""Builds the sources of the hot path for tests: as a module with a fuse, or as programs under a sanitizer.

The compiler is the one that setuptools uses for the installed module.
"""

import fcntl
import hashlib
import importlib.machinery
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from robbie_mp.bus._hot.sources import digest, sources_in, write_c

HOT = Path(__file__).parents[4] / "robbie_mp" / "bus" / "_hot"
HERE = Path(__file__).parent
PROGRAMS = HERE.parent / "programs"
NAME = "robbie_mp.bus._hot.native"
C_STANDARD = "-std=c11"
COMPILE_S = float(os.environ.get("ROBBIE_TEST_COMPILE_S", "900"))


def compiler() -> list[str] | None:
    """Return the command of the C compiler; None if there is none."""
    command = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")
    return command if shutil.which(command[0]) else None


def compile_c(command: Sequence[str], target: Path, sources: Sequence[Path], *options: str) -> None:
    """Compile C sources to one file.

    Raises:
        AssertionError: the compiler refuses; this shows what it says.
    """
    line = [
        *command,
        C_STANDARD,
        "-g",
        *options,
        f"-I{HOT}",
        *map(str, sources),
        "-o",
        str(target),
        "-pthread",
    ]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=COMPILE_S)
    assert done.returncode == 0, f"{shlex.join(line)}\n{done.stderr}"


@contextmanager
def exclusively(lock: Path) -> Iterator[None]:
    """Wait until no other process is in such a block with the same file."""
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def fused_module(folder: Path, *options: str, hot: Path = HOT) -> ModuleType:
    """Return the hot path with a fuse in every store, built into a folder unless it is there already.

    Args:
        folder: where it is kept.
        options: further options of the compiler, such as those of a sanitizer.
        hot: where the sources are.
    """
    command = compiler()
    assert command is not None
    sources = [*sorted(hot.glob("*.c")), HERE / "fuse.c"]
    texts = b"".join(path.read_bytes() for path in (*sources_in(hot), HERE / "fuse.c", Path(__file__)))
    made_with = f"{sysconfig.get_config_var('SOABI')} {command} {options}"
    name = hashlib.sha256(texts + made_with.encode()).hexdigest()[:16]
    built = folder / f"native-{name}.so"
    with exclusively(folder / "lock"):  # of several test processes, one builds
        if not built.exists():
            being_built = folder / f"{name}-{os.getpid()}.so"
            made = folder / f"{name}-{os.getpid()}"
            made.mkdir()
            sources.append(write_c(hot, made))
            include = f"-I{hot}", f"-I{made}", f"-I{sysconfig.get_paths()['include']}"
            defined = "-DROBBIE_FUSE", f'-DROBBIE_SOURCES="{digest(hot)}"'
            compile_c(command, being_built, sources, "-O1", "-fPIC", "-shared", *defined, *include, *options)
            being_built.rename(built)
            shutil.rmtree(made)
    loader = importlib.machinery.ExtensionFileLoader("native", str(built))
    spec = importlib.util.spec_from_file_location("native", built, loader=loader)
    assert spec is not None
    before = sys.modules.get(NAME)
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    if before is None:
        sys.modules.pop(NAME, None)  # where Cython has entered it: it is not the installed one
    return module
