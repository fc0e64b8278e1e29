"""A named semaphore by which one process wakes another."""

from __future__ import annotations

import contextlib
import os
import secrets
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self

import posix_ipc

from robbie_mp._hot.choice import Native
from robbie_mp.linux.forks import REFUSED, keep_from_forks
from robbie_mp.linux.private_files import ownership_problem
from robbie_mp.transport import names
from robbie_mp.transport.segment import ForeignMemory, SegmentMissing, SharedMemoryFull
from robbie_mp.transport.shared_folder import SHARED_MEMORY, NamesTaken

if TYPE_CHECKING:
    from robbie_mp._hot.native import Semaphore

MAX_TRIES = 100
"""Names to try. They have 64 random bits, so two taken names are no coincidence."""
MAX_POSTS_TAKEN = 1000
"""Most posts that one wait takes. Any process of the run can write any count into the semaphore."""


class Wakeup:
    """A semaphore on which one process waits, and to which any number of processes post.

    Time-outs follow the monotonic clock where C waits and the C library can do so (glibc from 2.30 on).
    Elsewhere they follow the wall clock: if that is set back, a wait may last longer than asked. So the
    supervisor watches for such steps and posts to every process.

    Args:
        semaphore: the semaphore.
        tag: names it to other processes of the run.
        native: the same semaphore, opened by C; None: Python waits and posts.
    """

    def __init__(self, semaphore: posix_ipc.Semaphore, tag: int, native: Semaphore | None = None):
        self._semaphore = semaphore
        self._native: Any = native
        self.tag = tag
        """Names the semaphore to other processes of the run; see `names.wakeup`."""
        self.spin_s = 0.0
        """A wait polls for this time before it sleeps. Meanwhile other threads rarely get the GIL."""
        self.patience_s = 0.0
        """A wait sleeps at least for this time before it looks for posts, so one wake-up serves several."""
        self.post: Callable[[], None] = semaphore.release if native is None else native.post
        keep_from_forks(self)

    def disown(self) -> None:
        """Prevent a forked process from posting, and from waiting, which would take its parent's posts."""
        if self._native not in (None, REFUSED):
            self._native.disown()
        self._semaphore = self._native = self.post = REFUSED

    @classmethod
    def create(cls, run_id: str, native: Native | None = None) -> Self:
        """Create the semaphore under a random name.

        Args:
            run_id: the run.
            native: what is written in C; None: Python does it.

        Raises:
            SharedMemoryFull: there is no room for it.
            NamesTaken: every name tried was taken.
        """
        for _ in range(MAX_TRIES):
            tag = secrets.randbits(64)
            name = names.wakeup(run_id, tag)
            try:
                semaphore = posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, mode=0o600)
            except posix_ipc.ExistentialError:
                continue
            except OSError as error:
                raise SharedMemoryFull.of(f"semaphore {name}", error) from error
            return cls(semaphore, tag, None if native is None else native.Semaphore(f"/{name}"))
        raise NamesTaken(f"all {MAX_TRIES} names for a semaphore that were tried are taken, such as {name}")

    @classmethod
    def attach(cls, run_id: str, tag: int, native: Native | None = None) -> Self:
        """Open an existing semaphore.

        Args:
            run_id: the run.
            tag: of the semaphore.
            native: what is written in C; None: Python does it.

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
        opened = None
        try:
            opened = None if native is None else native.Semaphore(f"/{name}")
            _check_owner(name)  # again, as another user may have taken the name of ours in between
        except BaseException as error:
            semaphore.close()
            if opened is not None:
                opened.close()
            if isinstance(error, FileNotFoundError):
                raise SegmentMissing(f"there is no semaphore {name}; its run is over") from error
            raise
        return cls(semaphore, tag, opened)

    @property
    def sleeps_in_c(self) -> bool:
        """Whether a wait in C that sleeps at once is the same as `wait`."""
        return self._native is not None and not self.spin_s and not self.patience_s

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for a post and take all posts; return False after the time-out or a signal.

        The wait releases the GIL. It takes all posts at once, up to MAX_POSTS_TAKEN, because the caller then
        looks at every ring.
        """
        semaphore = self._semaphore if self._native is None else self._native
        if self.patience_s:
            nap_s = self.patience_s if timeout_s is None else min(self.patience_s, timeout_s)
            time.sleep(nap_s)
            timeout_s = None if timeout_s is None else timeout_s - nap_s
        if self.spin_s:
            spin_s = self.spin_s if timeout_s is None else min(self.spin_s, timeout_s)
            end_ns = time.monotonic_ns() + spin_s * 1e9
            while not semaphore.value and time.monotonic_ns() < end_ns:
                pass
        if self._native is not None:
            return bool(self._native.wait(timeout_s))
        try:
            semaphore.acquire(timeout_s)
        except (posix_ipc.BusyError, posix_ipc.SignalError):
            return False
        for _ in range(min(semaphore.value, MAX_POSTS_TAKEN)):
            semaphore.acquire(0)  # never blocks: no other process waits on this semaphore
        return True

    def close(self) -> None:
        """Close this process's handle; a second call does nothing."""
        with contextlib.suppress(posix_ipc.ExistentialError):
            self._semaphore.close()
        if self._native is not None:
            self._native.close()


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
