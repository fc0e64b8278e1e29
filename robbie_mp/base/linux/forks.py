"""Keeps a forked process from using what belongs to its parent.

A forked process shares the mapped memory of its parent, and has a copy of the parent's Python objects: the
next place in a ring, the free blocks. If both processes went on, they would overwrite each other's messages,
and nothing would count the lost ones. So os.register_at_fork disables such objects in every forked process;
a process that does not fork pays nothing for that. New processes (subprocess, or multiprocessing with
"spawn") inherit nothing in the first place.
"""

import functools
import os
import weakref
from types import TracebackType
from typing import Any, NoReturn, Protocol

from robbie_mp.base.errors import RobbieError


class ForkedProcess(RobbieError, RuntimeError):
    """A process that a module forked used an object that only the module itself may use.

    Example scenarios:
      - a function that `multiprocessing` runs in a forked process publishes a message
      - a handler forks, and both processes return from it
    """

    def __init__(self) -> None:
        super().__init__(
            f"process {os.getpid()} was forked by a module and is not part of the run: only the module "
            "itself may publish, subscribe, take messages, and show or keep its state. Send results to the "
            'module by a queue or pipe, and start processes with multiprocessing.get_context("spawn")'
        )


class Own(Protocol):
    """An object that belongs to the process that made it."""

    def disown(self) -> None:
        """Disable this object; called in a forked process, perhaps more than once."""


class Refusal:
    """Replaces an object that belongs to another process; every use raises ForkedProcess."""

    def __getattr__(self, _name: str) -> NoReturn:
        raise ForkedProcess

    def __call__(self, *_arguments: object) -> NoReturn:
        """Refuse to be called."""
        raise ForkedProcess

    def __enter__(self) -> NoReturn:
        """Refuse, in the place of a lock."""
        raise ForkedProcess

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


REFUSED: Any = Refusal()


def keep_from_forks(own: Own) -> None:
    """Call `own.disown()` in every process that this one forks, as long as `own` exists."""
    _own().add(own)


@functools.cache
def _own() -> "weakref.WeakSet[Own]":
    """Return the set of objects to disable; the first call creates it and registers the fork handler."""
    everything: weakref.WeakSet[Own] = weakref.WeakSet()

    def disown() -> None:
        for own in list(everything):
            own.disown()

    os.register_at_fork(after_in_child=disown)
    return everything
