"""What runs in a spare interpreter: `python -m robbie_mp.supervisor.spare RUN_FOLDER`.

It imports what every child needs, says so on its standard input, a socket, and waits there for the name and
the incarnation of the child it is to be. See `robbie_mp.supervisor.spares`.
"""

import importlib
import os
import sys
import traceback
from pathlib import Path
from typing import NoReturn

import numpy as np  # noqa: F401 - ahead, for the module that will run here

import robbie_mp.supervisor.core_child
import robbie_mp.supervisor.module_child  # noqa: F401 - ahead: it may become one or the other
from robbie_mp.linux.prctl import die_with_parent, set_process_name
from robbie_mp.run.plan import RunPlan
from robbie_mp.supervisor.assignment import wait_for_assignment
from robbie_mp.supervisor.child import run_child


def main(run_folder: Path) -> None:
    """Wait to be needed, then run a child."""
    plan = RunPlan.load(run_folder)
    die_with_parent(plan.supervisor_pid)
    sys.path.insert(0, plan.workspace)  # as in a module's process
    for name in plan.spare_imports:
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            print(f"cannot import {name} ahead: {error}", file=sys.stderr)
        except Exception:
            traceback.print_exc()  # the module that needs it will say so again
    files = imported_files(plan.workspace)
    imported = versions(files)
    set_process_name("spare")  # now that it is one
    if assignment := wait_for_assignment():
        if versions(files) != imported:
            start_afresh(run_folder, *assignment)
        run_child(run_folder, plan, *assignment)


def imported_files(folder: str) -> list[str]:
    """Return the files below a folder that this interpreter has imported."""
    below = os.path.join(folder, "")
    files = [getattr(module, "__file__", None) or "" for module in list(sys.modules.values())]
    return [file for file in files if file.startswith(below)]


def versions(files: list[str]) -> list[tuple[int, int] | None]:
    """Return time of change and size of each file; None for one that is gone."""
    found: list[tuple[int, int] | None] = []
    for file in files:
        try:
            stat = os.stat(file)
        except OSError:
            found.append(None)
        else:
            found.append((stat.st_mtime_ns, stat.st_size))
    return found


def start_afresh(run_folder: Path, name: str, incarnation: int) -> NoReturn:
    """Become a child that has imported nothing yet: what this process has imported has been edited since."""
    child = ["-m", "robbie_mp.supervisor.child", str(run_folder), name, str(incarnation)]
    os.execv(sys.executable, [sys.executable, *child])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
