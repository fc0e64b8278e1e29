"""Who may work with a link: the module's thread, and those of Zenoh, one at a time."""

import threading


class Turns:
    """Gives a turn to one thread at a time.

    The module's thread uses it as a context, and waits for at most the packet that another thread is taking.
    A thread of Zenoh must not wait, because the network waits with it:

        if turns.begin_at_once():
            try:
                ...
            finally:
                turns.end()

    Attributes:
        module_waits: whether the module's thread waits for its turn.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.module_waits = False

    def __enter__(self) -> None:
        self.module_waits = True
        self._lock.acquire()
        self.module_waits = False

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def begin_at_once(self) -> bool:
        """Begin a turn; False if another thread has it, or the module's thread waits for it."""
        return not self.module_waits and self._lock.acquire(blocking=False)

    def end(self) -> None:
        """End a turn that `begin_at_once` began."""
        self._lock.release()
