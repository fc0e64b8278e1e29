"""The floor with futexes: ctypes calls futex(2) on a word in a mapped file."""

import ctypes
import platform
from collections.abc import Callable

from tools.bench.peers.floor import Floor, InFolder, map_file
from tools.bench.work import Work

CALLS = {"x86_64": 202, "aarch64": 98}
"""Number of the system call futex(2)."""
WAIT, WAKE = 0, 1
WRAP = 1 << 32


class Futexes(InFolder):
    """One word for each process that sleeps. The word counts the wake-ups."""

    title = "2 futexes by ctypes"
    how = "futex(2) called with ctypes, which releases the GIL"

    def waiting(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that sleeps while the count has not changed since the last call."""
        count, futex = _word(work, name)
        seen = 0

        def wait() -> None:
            nonlocal seen
            while count.value == seen:
                futex(WAIT, seen)
            seen = (seen + 1) % WRAP

        return wait

    def waking(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that increments the count and wakes the process."""
        count, futex = _word(work, name)

        def wake() -> None:
            count.value += 1
            futex(WAKE, 1)

        return wake


def _word(work: Work, name: str) -> tuple[ctypes.c_uint32, Callable[[int, int], int]]:
    count = ctypes.c_uint32.from_buffer(map_file(work, f"{name}.futex", 4096))
    address = ctypes.c_void_p(ctypes.addressof(count))
    syscall = ctypes.CDLL(None).syscall
    number = CALLS[platform.machine()]

    def futex(operation: int, value: int) -> int:
        return int(syscall(number, address, operation, ctypes.c_uint32(value), None, None, 0))

    return count, futex


PEER = Floor(Futexes())
