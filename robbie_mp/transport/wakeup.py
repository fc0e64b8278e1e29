"""A named semaphore by which one process wakes another."""

import contextlib
import os
import secrets
import time
from typing import Self

import posix_ipc

from robbie_mp.linux.forks import REFUSED, keep_from_forks
from robbie_mp.linux.private_files import ownership_problem
from robbie_mp.transport import names
from robbie_mp.transport.segment import ForeignMemory, SegmentMissing, SharedMemoryFull
from robbie_mp.transport.shared_folder import SHARED_MEMORY, NamesTaken

MAX_TRIES = 100
"""Names of 64 random bits that may be taken; more than one is no accident."""


class Wakeup:
    """One process waits, any number post; a post that comes early is not lost.

    The time-outs of POSIX semaphores follow the wall clock: when that is set back, a wait may last longer
    than asked. The supervisor watches for such steps and posts everyone.
    """

    def __init__(self, semaphore: posix_ipc.Semaphore, tag: int):
        self._semaphore = semaphore
        self.tag = tag
        """By which another process of the run attaches to it; see `names.wakeup`."""
        self.spin_s = 0.0
        """A wait looks for a post so long before it sleeps; other threads get the GIL only now and then."""
        self.patience_s = 0.0
        """A wait sleeps at least so long before it looks for a post: who posts meanwhile wakes nobody."""
        self.post = semaphore.release
        keep_from_forks(self)

    def disown(self) -> None:
        """Let a forked process neither wait, which would take posts away from us, nor post."""
        self._semaphore = self.post = REFUSED

    @classmethod
    def create(cls, run_id: str) -> Self:
        """Create the semaphore, under a name that nobody could guess.

        Raises:
            SharedMemoryFull: there is no room for it.
            NamesTaken: every name tried was taken.
        """
        for _ in range(MAX_TRIES):
            tag = secrets.randbits(64)
            name = names.wakeup(run_id, tag)
            try:
                return cls(posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, mode=0o600), tag)
            except posix_ipc.ExistentialError:
                continue
            except OSError as error:
                raise SharedMemoryFull.of(f"semaphore {name}", error) from error
        raise NamesTaken(f"all {MAX_TRIES} names for a semaphore that were tried are taken, such as {name}")

    @classmethod
    def attach(cls, run_id: str, tag: int) -> Self:
        """Open an existing semaphore.

        Raises:
            SegmentMissing: there is none of that name.
            ForeignMemory: it is not ours alone.
        """
        name = names.wakeup(run_id, tag)
        _check_owner(name)  # before anything foreign is mapped
        try:
            semaphore = posix_ipc.Semaphore(f"/{name}")
        except posix_ipc.ExistentialError as error:
            raise SegmentMissing(f"there is no semaphore {name}; its run is over") from error
        except posix_ipc.PermissionsError as error:
            raise ForeignMemory(f"semaphore {name} is not ours") from error
        try:
            _check_owner(name)  # ours may have been unlinked in between, but nobody takes its place unseen
        except BaseException:
            semaphore.close()
            raise
        return cls(semaphore, tag)

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


def unlink_wakeup(run_id: str, tag: int) -> None:
    """Remove a semaphore's name if it is there, and ours."""
    name = names.wakeup(run_id, tag)
    with contextlib.suppress(SegmentMissing, ForeignMemory, posix_ipc.ExistentialError):
        _check_owner(name)
        posix_ipc.unlink_semaphore(f"/{name}")


def _check_owner(name: str) -> None:
    """See that a semaphore is ours. Nobody else could replace it then: /dev/shm is sticky."""
    try:
        problem = ownership_problem(os.lstat(SHARED_MEMORY / f"sem.{name}"))
    except FileNotFoundError as error:
        raise SegmentMissing(f"there is no semaphore {name}; its run is over") from error
    if problem:
        raise ForeignMemory(f"semaphore {name} {problem}")
