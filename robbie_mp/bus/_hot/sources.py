"""Finds the sources of the hot path, and has Cython make C of those that are not C.

`setup.py` runs this file before Robbie-MP is installed, so it imports nothing of Robbie-MP.
"""

import subprocess
import sys
import zlib
from pathlib import Path

KINDS = (".c", ".h", ".pxi", ".pyx")
"""How the names of sources end; `native.pyx` includes those in Cython."""


def sources_in(folder: Path) -> list[Path]:
    """Return the sources and headers in a folder, in the order of their names."""
    return sorted(path for path in folder.glob("*.*") if path.suffix in KINDS)


def digest(folder: Path) -> str:
    """Return a checksum over names and contents of the sources in a folder; '' if there are none."""
    checksum = 0
    for path in (files := sources_in(folder)):
        checksum = zlib.crc32(path.read_bytes(), zlib.crc32(path.name.encode(), checksum))
    return f"{checksum:08x}" if files else ""


def write_c(folder: Path, target: Path, *options: str) -> Path:
    """Write the C that Cython makes of `native.pyx`, the Python module, and the header with its types.

    Args:
        folder: where the sources are.
        target: the folder to write into.
        options: further options of Cython.

    Returns:
        The file in C; its header is beside it.

    Raises:
        RuntimeError: Cython refuses; this shows what it says.
    """
    source, made = folder / "native.pyx", target / "native_made.c"
    command = [sys.executable, "-m", "cython", "--module-name", "robbie_mp.bus._hot.native", *options]
    done = subprocess.run([*command, source, "-o", made], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"Cython refuses {source}:\n{done.stderr}")
    return made
