"""Keeps a forked process from what belongs to the one that forked it.

A fork shares the memory that is mapped, and gets a copy of all that Python knows of it: which place in a ring
is the next, which blocks are free. If both went on they would write over each other's messages, and nobody
would count what is lost. So what is one process's own is taken away in each process that it forks, by
os.register_at_fork: who does not fork pays nothing for that. Processes started anew (subprocess, or
multiprocessing by "spawn") inherit nothing in the first place.
"""

import functools
import os
import weakref
from types import TracebackType
from typing import Any, NoReturn, Protocol

from robbie_mp.errors import RobbieError


class ForkedProcess(RobbieError, RuntimeError):
    """A process that a module has forked used what is the module's own.

    Example scenarios:
      - a function that `multiprocessing` runs in a forked process publishes by itself
      - a handler forks, and both processes return from it
    """

    def __init__(self) -> None:
        super().__init__(
            f"process {os.getpid()} was forked by a module, and has no place in the run: only the module "
            "itself may publish, subscribe, take messages, and show or keep its state. Send it what you have "
            'found by a queue or pipe, and start processes with multiprocessing.get_context("spawn")'
        )


class Own(Protocol):
    """Something that belongs to the process that made it."""

    def disown(self) -> None:
        """Be of no use any more: called in a process that was forked, and may be called again."""


class Refusal:
    """Stands where something was that belongs to another process; whatever is done with it is refused."""

    def __getattr__(self, _name: str) -> NoReturn:
        raise ForkedProcess

    def __call__(self, *_arguments: object) -> NoReturn:
        """Refuse to be called."""
        raise ForkedProcess

    def __enter__(self) -> NoReturn:
        """Refuse, as a lock that this process will never get."""
        raise ForkedProcess

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


REFUSED: Any = Refusal()


def keep_from_forks(own: Own) -> None:
    """Have something disowned in every process that this one forks, as long as it exists."""
    _own().add(own)


@functools.cache
def _own() -> "weakref.WeakSet[Own]":
    """Return what is this process's own; made when there is something."""
    everything: weakref.WeakSet[Own] = weakref.WeakSet()

    def disown() -> None:
        for own in list(everything):
            own.disown()

    os.register_at_fork(after_in_child=disown)
    return everything
