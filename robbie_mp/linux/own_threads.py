"""What the kernel sets for each thread by itself, set for all threads of this process."""

import contextlib
from collections.abc import Callable
from pathlib import Path

_THREADS = Path("/proc/self/task")
_MAX_PASSES = 20


def for_all_threads(apply: Callable[[int], object]) -> None:
    """Apply something to every thread of this process, also to those that libraries have started.

    A thread that is started meanwhile inherits from the one that starts it, so this looks again until it
    has seen all; it ends even if threads are started faster than that.

    Args:
        apply: called with the number of each thread, once; may raise ProcessLookupError if it has ended.
    """
    done: set[int] = set()
    for _ in range(_MAX_PASSES):
        new = {int(thread.name) for thread in _THREADS.iterdir()} - done
        if not new:
            return
        for thread in new:
            with contextlib.suppress(ProcessLookupError):
                apply(thread)
        done |= new
