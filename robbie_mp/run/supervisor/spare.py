"""The program of a spare interpreter: `python -m robbie_mp.run.supervisor.spare RUN_FOLDER`.

A spare imports what every child needs and reports `ready` on its standard input, which is a socket. There it
waits for its assignment: the name and the incarnation of the child that it becomes. See
`robbie_mp.run.supervisor.spares`.
"""

import importlib
import os
import sys
import traceback
from pathlib import Path
from typing import NoReturn

from robbie_mp.base.linux.prctl import die_with_parent, set_process_name
from robbie_mp.base.stock_robots import ROBOTS
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.supervisor.assignment import wait_for_assignment
from robbie_mp.run.supervisor.child import leave_interrupts_to_supervisor, run_child
from robbie_mp.run.supervisor.imported_files import imported_files

IMPORTED_AHEAD = ("numpy", "robbie_mp.run.supervisor.core_child", "robbie_mp.run.supervisor.module_child")
"""Modules that any child may need: a spare becomes the core or a module."""


def main(run_folder: Path) -> None:
    """Import what children need, wait for an assignment, then run a child."""
    leave_interrupts_to_supervisor()
    for name in IMPORTED_AHEAD:
        importlib.import_module(name)
    plan = RunPlan.load(run_folder)
    die_with_parent(plan.supervisor_pid)
    sys.path.insert(0, plan.workspace)  # as a module's process does
    for name in plan.spare_imports:
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            print(f"spares.imports names {name}, which cannot be imported: {error}", file=sys.stderr)
        except Exception:
            traceback.print_exc()  # the module that needs it will report it again
    files = imported_files(plan.workspace, str(ROBOTS))
    imported = versions(files)
    set_process_name("spare")  # only now is it a spare
    if assignment := wait_for_assignment():
        if versions(files) != imported:
            start_afresh(run_folder, *assignment)
        run_child(run_folder, plan, *assignment)


def versions(files: list[str]) -> list[tuple[int, int] | None]:
    """Return modification time and size of each file; None for a file that no longer exists."""
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
    """Become a child with a new interpreter, because files that this one imported have changed."""
    child = ["-m", "robbie_mp.run.supervisor.child", str(run_folder), name, str(incarnation)]
    os.execv(sys.executable, [sys.executable, *child])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
