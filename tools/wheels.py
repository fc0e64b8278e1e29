"""Makes the wheels of a release from its source distribution: for each given Python and each processor.

    python -m tools.wheels SDIST PYTHON... [--processor x86_64|aarch64]... [--out FOLDER]

zig compiles for every processor and an old glibc on any machine, without a container or an emulator. It comes
from PyPI, as does auditwheel, which reads from each wheel what it needs: `pip install ziglang auditwheel`. A
PYTHON is the command of an interpreter that has pip and its headers. What is compiled for another processor
uses the `pyconfig.h` of this one, which says the same of 64-bit Linux with glibc, except for what only the
interpreter itself reads; Debian's own Python asks for that of the other one, from `libpython3-dev:arm64`. A
wheel for another processor cannot be tried here; `tools/arm64/run` does that.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

GLIBC = "2.31"
"""The oldest glibc with which the wheels work: that of Ubuntu 20.04 (docs/platforms.md)."""
PROCESSORS = ("x86_64", "aarch64")
"""As `uname -m` names them."""
ASK = "import sys, sysconfig; print(sys.implementation.cache_tag, sysconfig.get_path('include'))"
"""What an interpreter must say: such as `cpython-311 /usr/include/python3.11`."""


def make(sdist: Path, python: str, processor: str, folder: Path) -> Path:
    """Make one wheel.

    Args:
        sdist: the source distribution.
        python: command of the interpreter for which the wheel is.
        processor: one of `PROCESSORS`.
        folder: where to put the wheel.
    """
    compiler = shlex.join([zig(), "cc", "-target", f"{processor}-linux-gnu.{GLIBC}"])
    tag, headers = subprocess.check_output([python, "-c", ASK], text=True).split()
    # Instead of what the interpreter was built with, which is for another compiler and machine.
    environment = {
        "CC": compiler,
        "LDSHARED": f"{compiler} -shared -s",
        # Debian's pyconfig.h includes another one from the folder above, which zig does not search.
        "CFLAGS": shlex.join(["-DNDEBUG", "-idirafter", str(Path(headers).parent)]),
        "ROBBIE_STRICT_BUILD": "1",
        "SETUPTOOLS_EXT_SUFFIX": f".{tag}-{processor}-linux-gnu.so",
        "_PYTHON_HOST_PLATFORM": f"manylinux_{GLIBC.replace('.', '_')}_{processor}",
    }
    before = set(folder.glob("*.whl"))
    pip = [python, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-cache-dir", "--wheel-dir", str(folder)]
    subprocess.run([*pip, str(sdist)], env={**os.environ, **environment}, check=True)
    (wheel,) = set(folder.glob("*.whl")) - before
    return wheel


def zig() -> str:
    """Return the path of zig: pip's isolated build could not find its package by name."""
    package = find_spec("ziglang")
    if package is None or package.origin is None:
        raise SystemExit("zig is missing: pip install ziglang auditwheel")
    return str(Path(package.origin).with_name("zig"))


def glibc_needed(wheel: Path) -> str:
    """Return the oldest glibc that has all symbols that a wheel uses, such as '2.17'; auditwheel knows."""
    show = [sys.executable, "-m", "auditwheel", "show", "--json", str(wheel)]
    policy: str = json.loads(subprocess.check_output(show, text=True))["overall_tag"]
    name, *version = policy.split("_")  # manylinux_2_17_x86_64; linux_x86_64 is of no policy
    if name != "manylinux":
        raise SystemExit(f"{wheel.name} fits no policy for wheels: {policy}")
    return ".".join(version[:2])


def numbers(version: str) -> tuple[int, ...]:
    """Return a version such that it can be compared."""
    return tuple(map(int, version.split(".")))


def main() -> int:
    """Make the wheels; return 1 if one needs a newer glibc than its name says."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.wheels", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("sdist", type=Path, metavar="SDIST", help="such as dist/robbie_mp-1.2.3.tar.gz")
    parser.add_argument("pythons", nargs="+", metavar="PYTHON", help="such as python3.11")
    parser.add_argument("--processor", action="append", choices=PROCESSORS, help="(all)")
    parser.add_argument("--out", type=Path, default=Path("dist"), help="(%(default)s)")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    worst = GLIBC
    for python in chosen.pythons:
        for processor in chosen.processor or PROCESSORS:
            wheel = make(chosen.sdist, python, processor, chosen.out)
            needed = glibc_needed(wheel)
            print(f"{wheel.name}: needs glibc {needed}", flush=True)
            worst = max(worst, needed, key=numbers)
    return 1 if worst != GLIBC else 0


if __name__ == "__main__":
    sys.exit(main())
