"""`robbie run --reload`: restarts the modules whose source files were saved, if the new code can be imported.

A spare interpreter rehearses first: it imports the module's class and checks its settings. If that fails, the
module that runs stays, and one line says why. Otherwise the module is stopped in order, and the spare, which
has imported everything already, takes its place.
"""

import contextlib
import importlib.util
import os
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from robbie_mp.base.linux.file_events import FileEvents
from robbie_mp.run.profile.model import ModuleSpec
from robbie_mp.run.profile.preflight import first_problem
from robbie_mp.run.supervisor.imported_files import (
    FOLDER,
    Version,
    checked_versions,
    read_imports,
    version_of,
)
from robbie_mp.run.supervisor.spares import Rehearsal
from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.supervisor.supervised_child import SupervisedChild
from robbie_mp.run.supervisor.tree import CannotControl, Tree
from robbie_mp.run.trace.kinds import Kind

LOOK_S = 0.5
"""How often the files are looked at where the file system does not tell that they were saved."""
MAX_FILES = 10_000
MAX_NAMED = 3
RELOADED = (ChildState.STARTING, ChildState.RUNNING, ChildState.BACKOFF, ChildState.FAILED)
"""The states in which a module gets new code; somebody has stopped a STOPPED one, or it has done its work."""
_FILE = re.compile(r'File "([^"<>]+)"')
_MISSING = re.compile(r"No module named '([\w.]+)'")


class Reloader:
    """Watches the files of all modules.

    Args:
        run_folder: the run's folder, where modules report what they have imported.
        workspace: the robot's folder.
        modules: the modules.
        tree: restarts them.
        clock: monotonic time in s.
    """

    def __init__(
        self,
        run_folder: Path,
        workspace: Path,
        modules: Sequence[ModuleSpec],
        tree: Tree,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._tree = tree
        self._clock = clock
        self._events = FileEvents()
        self._watched = [_Watched(tree.child(one.name), run_folder, workspace) for one in modules]
        self._next_s = clock()
        if self._events.fd >= 0:
            tree.watch(self._events.fd, self._on_event)

    def turn(self) -> None:
        """Look at the files, if it is time; called in every turn of the loop."""
        if self._clock() < self._next_s:
            return
        self._next_s = self._clock() + LOOK_S
        for one in self._watched:
            one.read_report()
            for folder in one.folders:
                self._events.watch(folder)
            saved = [] if one.is_rehearsed or not one.may_restart else one.saved()
            if saved:
                self._rehearse(one, saved)

    def close(self) -> None:
        """Watch no longer; the tree has ended."""
        self._events.close()

    def _on_event(self) -> None:
        self._events.forget()
        self._next_s = self._clock()

    def _rehearse(self, one: "_Watched", saved: list[str]) -> None:
        for file in saved:  # what was compiled of the last save may look like that of this one
            with contextlib.suppress(OSError, NotImplementedError):
                os.unlink(importlib.util.cache_from_source(file))
        one.is_rehearsed = True

        def on_done(answer: dict[str, Any] | None, why: str) -> None:
            one.is_rehearsed = False
            self._next_s = self._clock()
            self._on_rehearsed(one, saved, answer, why)

        spec = one.child.spec
        self._tree.rehearse(Rehearsal(spec.name, on_done, keeps_spare=spec.may_be_warm))

    def _on_rehearsed(
        self, one: "_Watched", saved: list[str], answer: dict[str, Any] | None, why: str
    ) -> None:
        names = ", ".join(os.path.relpath(file, one.workspace) for file in saved[:MAX_NAMED])
        names += f" and {len(saved) - MAX_NAMED} more" if len(saved) > MAX_NAMED else ""
        if answer is not None:
            one.add(checked_versions(answer.get("files")))
            why = first_problem(answer)
            one.add(dict.fromkeys(_named_files(str(answer.get("failure", "")), one.workspace)))
        if why:
            stays = "the one that runs stays" if one.child.pid else "it is not started"
            one.child.output.say(Kind.WARNING, f"{names} was saved, but {stays}: {why}")
            return
        with contextlib.suppress(CannotControl):  # the run stops, or it hangs in the kernel
            self._tree.restart_child(one.child.spec.name, f"{names} was saved")


class _Watched:
    """A module and the files that it has imported.

    Args:
        child: the module.
        run_folder: where it reports them.
        workspace: the robot's folder.

    Attributes:
        is_rehearsed: whether its new code is being imported.
        folders: the folders of its files.
    """

    def __init__(self, child: SupervisedChild, run_folder: Path, workspace: Path):
        self.child = child
        self.workspace = workspace
        self.is_rehearsed = False
        self.folders: set[str] = set()
        self._report = run_folder / FOLDER / child.spec.name
        self._reported: Version | None = None
        self._seen: dict[str, Version | None] = {}
        """The version of each file that was seen last."""

    @property
    def may_restart(self) -> bool:
        """Whether it gets new code now; otherwise that is seen later."""
        return self.child.state in RELOADED and not self.child.is_stopping

    def read_report(self) -> None:
        """Read which files it has imported, if it has reported that since the last call."""
        version = version_of(str(self._report))
        if version != self._reported:
            self._reported = version
            self.add(read_imports(self._report))

    def add(self, files: dict[str, Version | None]) -> None:
        """Watch these files, too; what was seen of known ones stays."""
        for file, version in files.items():
            if len(self._seen) < MAX_FILES and file.endswith(".py"):
                self._seen.setdefault(file, version)
                self.folders.add(os.path.dirname(file))

    def saved(self) -> list[str]:
        """Return the files that were saved since the last call; one that was deleted waits to come back."""
        found = []
        for file, seen in self._seen.items():
            version = version_of(file)
            if version is not None and version != seen:
                self._seen[file] = version
                found.append(file)
        return found


def _named_files(failure: str, workspace: Path) -> list[str]:
    """Return the files of a workspace that a traceback names or misses: saving them may mend it."""
    found = [file for file in _FILE.findall(failure) if file.startswith(f"{workspace}/")]
    for name in _MISSING.findall(failure):
        path = workspace.joinpath(*name.split("."))
        found += [f"{path}.py", f"{path}/__init__.py"]
    return found
