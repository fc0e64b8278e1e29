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
from typing import Any, NoReturn

from robbie_mp.base.linux.prctl import die_with_parent, set_process_name
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.checking_process import question_about
from robbie_mp.run.profile.model import ModuleSpec
from robbie_mp.run.supervisor.assignment import wait_for_assignment
from robbie_mp.run.supervisor.child import leave_interrupts_to_supervisor, run_child
from robbie_mp.run.supervisor.imported_files import robot_files, versions

IMPORTED_AHEAD = (
    "numpy.random",
    "robbie_mp.run.supervisor.core_child",
    "robbie_mp.run.supervisor.module_child",
)
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
    stage = Stage(run_folder, plan)
    set_process_name("spare")  # only now is it a spare
    if assignment := wait_for_assignment(stage.rehearse):
        if not stage.is_up_to_date(assignment[0]):
            start_afresh(run_folder, *assignment)
        run_child(run_folder, plan, *assignment)


class Stage:
    """Where a spare rehearses a module before it takes the place of one that runs.

    Args:
        run_folder: the run's folder.
        plan: the run.
    """

    def __init__(self, run_folder: Path, plan: RunPlan):
        self._run_folder = run_folder
        self._plan = plan
        self._imported = versions(robot_files(plan.workspace))
        self._rehearsed = ""
        if plan.reloads:
            self._warm_up()

    def rehearse(self, name: str) -> dict[str, object]:
        """Import a module's class as its process would; return what is wrong, and the imported files.

        The answer is that of `robbie_mp.run.profile.check.examine`, with `files`; or `{"stale": True}`: this
        process has imported files that were saved since.
        """
        if not self.is_up_to_date():
            return {"stale": True}
        importlib.invalidate_caches()
        result = self._examine(self._plan.modules[self._plan.names.index(name) - 1])
        result["flaws"] = [*result["flaws"], *self._changed_types()]
        self._imported = versions(robot_files(self._plan.workspace))
        self._rehearsed = name
        return {**result, "files": self._imported}

    def _examine(self, planned: ModuleSpec) -> dict[str, Any]:
        from robbie_mp.module.module import Module  # noqa: PLC0415 (a spare for the core imports it anyway)
        from robbie_mp.run.profile.check import examine  # noqa: PLC0415

        return examine(question_about(planned), Module, Path(self._plan.workspace), [])

    def _changed_types(self) -> list[tuple[str, int, str]]:
        """Return the classes of messages with other fields than in the run, as flaws of the code."""
        from robbie_mp.messages.descriptions import own_classes  # noqa: PLC0415 (as above)
        from robbie_mp.module.class_check import place_of  # noqa: PLC0415
        from robbie_mp.run.declared_types import DeclaredTypes  # noqa: PLC0415

        types = DeclaredTypes(self._run_folder, self._plan.types)
        return [(*place_of(one), flaw) for one in own_classes() if (flaw := types.flaw(one))]

    def _warm_up(self) -> None:
        """Examine a small module: the first time takes five times as long as the next."""
        self._examine(ModuleSpec("probe", "robbie_mp.run.battery_guard:BatteryGuard"))

    def is_up_to_date(self, name: str = "") -> bool:
        """Whether this process may become a module: it has rehearsed it, or no file has changed."""
        return name == self._rehearsed != "" or versions(self._imported) == self._imported


def start_afresh(run_folder: Path, name: str, incarnation: int) -> NoReturn:
    """Become a child with a new interpreter, because files that this one imported have changed."""
    child = ["-m", "robbie_mp.run.supervisor.child", str(run_folder), name, str(incarnation)]
    os.execv(sys.executable, [sys.executable, *child])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
