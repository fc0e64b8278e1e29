"""What runs in a spare interpreter: `python -m robbie_mp.supervisor.spare RUN_FOLDER`.

It imports what every child needs, says so on its standard input, a socket, and waits there for the name and
the incarnation of the child it is to be. See `robbie_mp.supervisor.spares`.
"""

import importlib
import sys
import traceback
from pathlib import Path

import numpy as np  # noqa: F401 - ahead, for the module that will run here

from robbie_mp.die_with_parent import die_with_parent
from robbie_mp.prctl import set_process_name
from robbie_mp.supervisor.assignment import wait_for_assignment
from robbie_mp.supervisor.child import run_child
from robbie_mp.supervisor.plan import RunPlan


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
    if assignment := wait_for_assignment():
        run_child(run_folder, plan, *assignment)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
