"""Where tests find the checkout's own files."""

from pathlib import Path

PROJECT = Path(__file__).parents[2]
ARENAS = PROJECT / "hw" / "simulation" / "arenas"
DOCS = PROJECT / "docs"
