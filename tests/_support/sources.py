"""What Robbie-MP is built from."""

import shutil
from pathlib import Path

from tests.docs._support.pages import ROOT

FOLDERS = ("robbie_mp", "robbie_robots", "profiles", "modules", "workers", "hw")
FILES = ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE")


def copy_sources(target: Path) -> None:
    """Copy everything that a build needs into a new folder, and nothing that was built before."""
    target.mkdir()
    for folder in FOLDERS:
        ignored = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(ROOT / folder, target / folder, symlinks=True, ignore=ignored)
    for name in FILES:
        shutil.copy(ROOT / name, target)
