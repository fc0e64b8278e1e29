"""A named semaphore by which one process wakes another."""

import contextlib
import time
from typing import Self

import posix_ipc

from robbie_mp.transport.segment import SegmentMissing, SharedMemoryFull


class Wakeup:
    """One process waits, any number post; a post that comes early is not lost.

    The time-outs of POSIX semaphores follow the wall clock: when that is set back, a wait may last longer
    than asked. The supervisor watches for such steps and posts everyone.
    """

    def __init__(self, semaphore: posix_ipc.Semaphore):
        self._semaphore = semaphore
        self.spin_s = 0.0
        """A wait looks for a post so long before it sleeps; other threads get the GIL only now and then."""
        self.patience_s = 0.0
        """A wait sleeps at least so long before it looks for a post: who posts meanwhile wakes nobody."""
        self.post = semaphore.release

    @classmethod
    def create(cls, name: str) -> Self:
        """Create the semaphore.

        Raises:
            SharedMemoryFull: there is no room for it.
            FileExistsError: the name is taken.
        """
        try:
            return cls(posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, mode=0o600))
        except posix_ipc.ExistentialError as error:
            raise FileExistsError(f"semaphore {name} exists already") from error
        except OSError as error:
            raise SharedMemoryFull.of(f"semaphore {name}", error) from error

    @classmethod
    def attach(cls, name: str) -> Self:
        """Open an existing semaphore.

        Raises:
            SegmentMissing: there is none of that name.
        """
        try:
            return cls(posix_ipc.Semaphore(f"/{name}"))
        except posix_ipc.ExistentialError as error:
            raise SegmentMissing(f"there is no semaphore {name}; its run is over") from error

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for a post and take all that have come; False after the time-out or a signal.

        The GIL is released meanwhile. All posts are taken at once because whoever wakes looks at everything.
        """
        semaphore = self._semaphore
        if self.patience_s:
            nap_s = self.patience_s if timeout_s is None else min(self.patience_s, timeout_s)
            time.sleep(nap_s)
            timeout_s = None if timeout_s is None else timeout_s - nap_s
        if self.spin_s:
            spin_s = self.spin_s if timeout_s is None else min(self.spin_s, timeout_s)
            end_ns = time.monotonic_ns() + spin_s * 1e9
            while not semaphore.value and time.monotonic_ns() < end_ns:
                pass
        try:
            semaphore.acquire(timeout_s)
        except (posix_ipc.BusyError, posix_ipc.SignalError):
            return False
        for _ in range(semaphore.value):
            semaphore.acquire(0)  # never blocks: nobody else takes from this semaphore
        return True

    def close(self) -> None:
        """Close this process's handle."""
        self._semaphore.close()


def unlink_wakeup(name: str) -> None:
    """Remove a semaphore's name if it is there."""
    with contextlib.suppress(posix_ipc.ExistentialError):
        posix_ipc.unlink_semaphore(f"/{name}")
