"""A word of shared memory by which one process wakes another.

Every process of the run may write anything into that word, also a module that runs wild. So nothing is
concluded from its value, except whether it has changed; the kernel knows who sleeps (futex(2)). POSIX
semaphores do not suit: glibc trusts what it finds in them, and ends each process that posts to a damaged one.
"""

import ctypes
import threading
import time
from collections.abc import Callable
from random import Random
from typing import Any

from typing_extensions import Self

from robbie_mp.base.linux import futex
from robbie_mp.base.linux.forks import REFUSED, keep_from_forks
from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment, SegmentMismatch
from robbie_mp.bus.transport.words import WORD_BYTES, Words, new_fence

MAX_TIMEOUT_S = 1e9
"""30 years."""
_LOWER_HALF = 0xFFFFFFFF
"""The kernel compares 32 bits."""


class _Fence(threading.local):
    """A fence of each thread's own."""

    def __init__(self) -> None:
        self.issue = new_fence()


class Wakeup:
    """A word on whose change one thread of one process waits, and which any number of processes change.

    A post that another one overwrites is not lost, as the word has changed all the same. A process that was
    woken looks for work whatever the word says then. Only a module that runs wild can hide a post: it must
    write back the old value just when the other process falls asleep. That process then sleeps until the next
    post or its time-out. Time-outs follow the monotonic clock.

    Args:
        segment: its memory.
        native: what is written in C; None: Python waits and posts.
        asleep: words of which the process that waits, and no other, writes one: whether it sleeps. None:
            nothing says so, and every post is a system call.
        at: index of that one.
    """

    def __init__(
        self, segment: Segment, native: Native | None = None, asleep: Words | None = None, at: int = 0
    ):
        posts: Any = segment.part(layout.WAKEUP_POSTS, 1)
        self._segment = segment
        self._posts = posts
        self._asleep: Any = [1] if asleep is None else asleep
        self._at = at
        self._word: Any = ctypes.c_uint32.from_buffer(segment.buffer, layout.WAKEUP_POSTS * WORD_BYTES)
        self._seen = 0
        """The lower half of the word when posts were taken last."""
        self._fence = _Fence()
        self._random = Random()
        self._native: Any = None
        self.spin_s = 0.0
        """A wait without patience polls this long before it sleeps. Other threads rarely get the GIL then."""
        self._patience_s = 0.0
        self.post: Callable[[], None] = self._post
        if native is not None:
            self._native = native.Wakeup(posts, asleep, at)
            self.post = self._native.post
        keep_from_forks(self)

    def disown(self) -> None:
        """Prevent a forked process from posting, and from waiting."""
        if self._native not in (None, REFUSED):
            self._native.disown()
        self._posts = self._native = self._fence = self.post = REFUSED

    @classmethod
    def create(
        cls, name: str, native: Native | None = None, asleep: Words | None = None, at: int = 0
    ) -> Self:
        """Create it, as `Segment.create` does; the arguments are those of the class."""
        segment = Segment.create(name, layout.WAKEUP_WORDS, SegmentKind.WAKEUP)
        return cls(segment, native, asleep, at)

    @classmethod
    def attach(
        cls, name: str, native: Native | None = None, asleep: Words | None = None, at: int = 0
    ) -> Self:
        """Map an existing one.

        Raises:
            SegmentMissing: there is none of that name.
            SegmentMismatch: it was truncated.
            ForeignMemory: other users have access to it.
        """
        segment = Segment.map(name, write=True)
        if segment.size < layout.WAKEUP_WORDS * WORD_BYTES:
            segment.close()
            raise SegmentMismatch(f"shared memory {name} was truncated")
        return cls(segment, native, asleep, at)

    @property
    def sleeps_in_c(self) -> bool:
        """Whether a wait in C is the same as `wait`."""
        return self._native is not None and not self.spin_s

    @property
    def patience_s(self) -> float:
        """A wait sleeps at least for this time before it looks for posts, so one wake-up serves several."""
        return self._patience_s

    @patience_s.setter
    def patience_s(self, patience_s: float) -> None:
        self._patience_s = patience_s
        if self._native is not None:
            self._native.patience_ns = round(min(max(patience_s, 0.0), MAX_TIMEOUT_S) * 1e9)

    @property
    def has_posts(self) -> bool:
        """Whether there are posts that nobody has taken yet."""
        if self._native is not None:
            return bool(self._native.has_posts)
        return bool(self._posts[0] & _LOWER_HALF != self._seen)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for a post and take all posts; return False after the time-out or a signal.

        The wait releases the GIL. It takes all posts at once, because the caller then looks at every ring.
        """
        if self._native is None and self._patience_s:
            nap_s = self._patience_s if timeout_s is None else min(self._patience_s, timeout_s)
            time.sleep(nap_s)
            timeout_s = None if timeout_s is None else timeout_s - nap_s
        if self.spin_s and not self._patience_s:
            spin_s = self.spin_s if timeout_s is None else min(self.spin_s, timeout_s)
            end_ns = time.monotonic_ns() + spin_s * 1e9
            while not self.has_posts and time.monotonic_ns() < end_ns:
                pass
        if self._native is not None:
            return bool(self._native.wait(timeout_s))
        return self._take() or (timeout_s != 0 and self._sleep(timeout_s))

    def _post(self) -> None:
        """Change the word, and wake the process that waits if it sleeps.

        Python cannot add 1 in one step, as C does: two processes might write the same number one after the
        other, and nobody would notice the second. Random numbers are the same once in four thousand million.
        """
        fence = self._fence.issue
        fence()
        self._posts[0] = self._random.getrandbits(32)
        fence()  # the process that waits sets its word, and then looks at this one once more
        if self._asleep[self._at]:
            futex.wake_sleepers(self._word)

    def _take(self) -> bool:
        """Take all posts without waiting; return False if there is none."""
        found = self._posts[0] & _LOWER_HALF
        if found == self._seen:
            return False
        self._seen = found
        self._fence.issue()
        return True

    def _sleep(self, timeout_s: float | None) -> bool:
        until_ns = None
        if timeout_s is not None:
            until_ns = time.monotonic_ns() + round(min(max(timeout_s, 0.0), MAX_TIMEOUT_S) * 1e9)
        self._asleep[self._at] = 1
        self._fence.issue()
        try:
            if not self._take() and not futex.sleep_while(self._word, self._seen, until_ns):
                return False
        finally:
            self._asleep[self._at] = 0
        self._take()
        self._fence.issue()  # also if another process has written back the number that was seen
        return True

    def close(self) -> None:
        """Let go of the memory; a second call does nothing."""
        if self._native is not None:
            self._native.close()
        self._word = None
        if self._posts is not REFUSED:
            self._posts.release()
        self._segment.close()

    def unlink(self) -> None:
        """Remove the name."""
        self._segment.unlink()
