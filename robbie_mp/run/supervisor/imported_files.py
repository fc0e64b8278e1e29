"""The files of a robot that this interpreter has imported."""

import os
import sys


def imported_files(*folders: str) -> list[str]:
    """Return the files below these folders that this interpreter has imported."""
    below = tuple(os.path.join(folder, "") for folder in folders)
    files = [getattr(module, "__file__", None) or "" for module in list(sys.modules.values())]
    return [file for file in files if file.startswith(below)]
