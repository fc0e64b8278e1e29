"""Where the stock robots are: in the package `robbie_robots`, which is installed together with this one."""

from pathlib import Path

STOCK = "robbie:"
"""Begins a name that is looked up in Robbie-MP, not in the workspace: `robbie:rescue`, `robbie:hw/robots`."""
ROBOTS = Path(__file__).parents[2] / "robbie_robots"


def stock_path(path: Path) -> Path:
    """Return a path with a leading `robbie:` replaced by the folder of the stock robots."""
    return ROBOTS / str(path).removeprefix(STOCK) if str(path).startswith(STOCK) else path
