"""Which kinds of entries of the trace are recorded of whom, and how that is changed while the run goes on."""

import signal
from collections.abc import Callable, Collection
from pathlib import Path

from robbie_mp.supervisor.child_spec import ChildKind
from robbie_mp.supervisor.output import SUPERVISOR
from robbie_mp.supervisor.supervised_child import SupervisedChild
from robbie_mp.supervisor.tree import Tree
from robbie_mp.trace.kinds import Kind
from robbie_mp.trace.levels import RECORDED_FILE, recorded_as_json, write_recorded


class Recording:
    """Sets it for the children of a tree, and tells them what is worth logging at all."""

    def __init__(self, run_folder: Path, tree: Tree):
        """Tell the children, none of which has been started yet.

        Args:
            run_folder: where children look.
            tree: the children, with what is recorded of them at first.
        """
        self._run_folder = run_folder
        self._tree = tree
        write_recorded(run_folder, self._recorded())  # before anybody looks

    def set(self, kinds: Collection[Kind], name: str | None, on_told: Callable[[bool], None]) -> None:
        """Record these kinds from now on.

        Args:
            kinds: the others are not recorded.
            name: of a module, of the core, or "supervisor" for its remarks; None: of all modules.
            on_told: called when the children concerned were told, with False if the disk refused that.

        Raises:
            NoSuchChild: nobody has that name.
        """
        if name == SUPERVISOR:
            self._tree.output.remarked_kinds = frozenset(kinds)
            self._tell([], on_told)
            return
        modules = [child for child in self._tree.children if child.spec.kind is ChildKind.MODULE]
        changed = modules if name is None else [self._tree.child(name)]
        for child in changed:
            child.output.kinds = frozenset(kinds)
        self._tell(changed, on_told)

    def _recorded(self) -> dict[str, Collection[Kind]]:
        recorded = {child.spec.name: child.output.kinds for child in self._tree.children}
        return {SUPERVISOR: self._tree.output.remarked_kinds, **recorded}

    def _tell(self, changed: Collection[SupervisedChild], on_told: Callable[[bool], None]) -> None:
        def on_done(is_done: bool) -> None:
            for child in changed:
                child.send_signal(signal.SIGURG)
            on_told(is_done)

        path = self._run_folder / RECORDED_FILE
        self._tree.output.disk.order(["replace", str(path)], recorded_as_json(self._recorded()), on_done)
