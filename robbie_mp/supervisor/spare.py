"""What runs in a spare interpreter: `python -m robbie_mp.supervisor.spare RUN_FOLDER`.

It imports what every child needs, says so on its standard input, a socket, and waits there for the name and
the incarnation of the child it is to be. See `robbie_mp.supervisor.spares`.
"""

import importlib
import json
import os
import socket
import sys
import traceback
from pathlib import Path

import numpy as np  # noqa: F401 - ahead, for the module that will run here

from robbie_mp.supervisor.child import run_child
from robbie_mp.supervisor.die_with_parent import die_with_parent
from robbie_mp.supervisor.plan import RunPlan
from robbie_mp.supervisor.prctl import set_process_name
from robbie_mp.supervisor.spares import READY


def main(run_folder: Path) -> None:
    """Wait to be needed, then run a child."""
    plan = RunPlan.load(run_folder)
    die_with_parent(plan.supervisor_pid)
    set_process_name("spare")
    for name in plan.spare_imports:
        try:
            importlib.import_module(name)
        except Exception:
            traceback.print_exc()  # the module that needs it will say so again
    line = _wait_for_assignment()
    if line:
        name, incarnation = json.loads(line)
        run_child(plan, name, incarnation)


def _wait_for_assignment() -> bytes:
    """Return the line that names the child; empty if none is needed. Standard input is empty afterwards."""
    with socket.socket(fileno=os.dup(0)) as connection:
        connection.sendall(READY)
        line = connection.makefile("rb").readline()
    nowhere = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nowhere, 0)
    os.close(nowhere)
    return line


if __name__ == "__main__":
    main(Path(sys.argv[1]))
