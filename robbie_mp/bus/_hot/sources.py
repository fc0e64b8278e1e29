"""Identifies the C sources, so that a module built from other sources is noticed.

`setup.py` runs this file before Robbie-MP is installed, so it imports nothing of Robbie-MP.
"""

import zlib
from pathlib import Path


def sources_in(folder: Path) -> list[Path]:
    """Return the C files and headers in a folder, in the order of their names."""
    return sorted([*folder.glob("*.c"), *folder.glob("*.h")])


def digest(folder: Path) -> str:
    """Return a checksum over names and contents of the C sources in a folder; '' if there are none."""
    checksum = 0
    for path in (files := sources_in(folder)):
        checksum = zlib.crc32(path.read_bytes(), zlib.crc32(path.name.encode(), checksum))
    return f"{checksum:08x}" if files else ""
