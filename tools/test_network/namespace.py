"""A network namespace that ends with its owner, however the owner ends.

`ip netns` gives a namespace a name, which outlives a killed program. Here, an open file alone keeps it.
See namespaces(7).
"""

import contextlib
import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager

CLONE_NEWNET = 0x40000000
OWN = "/proc/thread-self/ns/net"


class Namespace:
    """A separate network: devices, addresses, routes and rules. Empty at first.

    It exists until `close`, or until the last process in it has ended.

    Raises:
        OSError: this user may not make one.
    """

    def __init__(self) -> None:
        with _returning():
            _call("unshare", CLONE_NEWNET)
            self._fd = os.open(OWN, os.O_RDONLY | os.O_CLOEXEC)

    @property
    def path(self) -> str:
        """A path by which other programs open the namespace, as long as this process lives."""
        return f"/proc/{os.getpid()}/fd/{self._fd}"

    def command(self, *command: str) -> list[str]:
        """Return a command that runs a command in the namespace, with the same process id."""
        return ["nsenter", f"--net={self.path}", "--", *command]

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Have the calling thread use this network. Sockets that it makes keep this network."""
        with _returning():
            _call("setns", self._fd, CLONE_NEWNET)
            yield

    def close(self) -> None:
        """Let go of it."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


@contextmanager
def _returning() -> Iterator[None]:
    """Bring the calling thread back to its present network."""
    with contextlib.ExitStack() as kept:
        before = os.open(OWN, os.O_RDONLY | os.O_CLOEXEC)
        kept.callback(os.close, before)
        kept.callback(_call, "setns", before, CLONE_NEWNET)
        yield


def _call(name: str, *arguments: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if getattr(libc, name)(*arguments) != 0:
        error = ctypes.get_errno()
        raise OSError(error, f"{name}: {os.strerror(error)}")
