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
"""Names to try. They have 64 random bits, so two taken names are no coincidence."""


class Wakeup:
    """A semaphore on which one process waits, and to which any number of processes post.

    The time-outs of POSIX semaphores follow the wall clock: if that is set back, a wait may last longer than
    asked. The supervisor watches for such steps and posts to every process.
    """

    def __init__(self, semaphore: posix_ipc.Semaphore, tag: int):
        self._semaphore = semaphore
        self.tag = tag
        """Names the semaphore to other processes of the run; see `names.wakeup`."""
        self.spin_s = 0.0
        """A wait polls for this time before it sleeps. Meanwhile other threads rarely get the GIL."""
        self.patience_s = 0.0
        """A wait sleeps at least for this time before it looks for posts, so one wake-up serves several."""
        self.post = semaphore.release
        keep_from_forks(self)

    def disown(self) -> None:
        """Prevent a forked process from posting, and from waiting, which would take its parent's posts."""
        self._semaphore = self.post = REFUSED

    @classmethod
    def create(cls, run_id: str) -> Self:
        """Create the semaphore under a random name.

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
            ForeignMemory: other users have access to it.
        """
        name = names.wakeup(run_id, tag)
        _check_owner(name)  # before mapping memory that may be another user's
        try:
            semaphore = posix_ipc.Semaphore(f"/{name}")
        except posix_ipc.ExistentialError as error:
            raise SegmentMissing(f"there is no semaphore {name}; its run is over") from error
        except posix_ipc.PermissionsError as error:
            raise ForeignMemory(f"semaphore {name} is not ours") from error
        try:
            _check_owner(name)  # again, as another user may have taken the name of ours in between
        except BaseException:
            semaphore.close()
            raise
        return cls(semaphore, tag)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for a post and take all posts; return False after the time-out or a signal.

        The wait releases the GIL. It takes all posts at once, because the caller then looks at every ring.
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
            semaphore.acquire(0)  # never blocks: no other process waits on this semaphore
        return True

    def close(self) -> None:
        """Close this process's handle."""
        self._semaphore.close()


def unlink_wakeup(run_id: str, tag: int) -> None:
    """Remove a semaphore's name if it exists and is this user's."""
    name = names.wakeup(run_id, tag)
    with contextlib.suppress(SegmentMissing, ForeignMemory, posix_ipc.ExistentialError):
        _check_owner(name)
        posix_ipc.unlink_semaphore(f"/{name}")


def _check_owner(name: str) -> None:
    """Check that a semaphore is this user's; then the sticky bit keeps others from replacing it."""
    try:
        problem = ownership_problem(os.lstat(SHARED_MEMORY / f"sem.{name}"))
    except FileNotFoundError as error:
        raise SegmentMissing(f"there is no semaphore {name}; its run is over") from error
    if problem:
        raise ForeignMemory(f"semaphore {name} {problem}")
