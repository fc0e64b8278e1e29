"""Prints the table of some kinds, or of all: `python -m tests.logs.strangers_kinds NAME…|FROM:TO`."""

import os
import sys
import tempfile
from pathlib import Path

from tests.logs.strangers_kinds.kinds import KINDS
from tests.logs.strangers_kinds.trial import attempt

PROJECT = Path(__file__).parents[3]
LINES = 14
"""So many lines of each written test are shown."""


def main(folder: Path) -> None:
    """Print a row of each kind whose name has one of the words, as soon as there is one."""
    (folder / "runtime").mkdir(mode=0o700)
    os.environ["XDG_RUNTIME_DIR"] = str(folder / "runtime")
    os.environ["PYTHONPATH"] = str(PROJECT)
    words = sys.argv[1:] or [""]
    first, colon, end = words[0].partition(":")
    for number, kind in enumerate(KINDS):
        if int(first) <= number < int(end) if colon else any(word in kind.name for word in words):
            outcome = attempt(kind, folder / f"kind_{number}")
            print(outcome.row(), flush=True)
            for line in outcome.test.partition("-> None:\n")[2].splitlines()[:LINES]:
                print("    " + line, flush=True)


main(Path(tempfile.mkdtemp(prefix="kinds-")))
