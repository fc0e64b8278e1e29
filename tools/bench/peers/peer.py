"""The base class of all peers. The file of each peer has an instance named `PEER`."""

import importlib.metadata
import importlib.util
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from tools.bench.publishing import passing_on
from tools.bench.record import OnMessage
from tools.bench.work import Work

Send = Callable[[int], None]
"""Stamps and publishes the message with a given number. Returns when the transport has the message."""


class Peer:
    """A transport from Python to Python.

    A derived class imports its library inside its methods, because the library may be missing.

    Attributes:
        title: name in tables.
        package: distribution whose version is reported; '': none.
        module: Python module that can be imported if the peer is installed; '': none is needed.
        how: one line about the messages and how the subscriber waits.
        can_fill_in_place: whether arrays can be filled in the published memory.
        has_relay: whether there is a third process between publisher and subscriber.
    """

    title: str
    package = ""
    module = ""
    how: str
    can_fill_in_place = False
    has_relay = False

    def publisher(self, work: Work) -> AbstractContextManager[Send]:
        """Yield a function that publishes. It works until the context ends."""
        raise NotImplementedError

    def receive(self, work: Work, index: int, handle: OnMessage) -> None:
        """Receive until `handle` returns True."""
        raise NotImplementedError

    def pass_on(self, source: Work, target: Work) -> None:
        """Send a message for each one received, until the last one: a stage's part of the work."""
        with self.publisher(target) as send:
            self.receive(source, 0, passing_on(source, send))

    def relay(self, work: Work) -> None:
        """Pass messages on until the last one. Called only with `has_relay`."""
        raise NotImplementedError

    def commands(self, name: str, work: Work, work_file: Path) -> list[list[str]]:
        """Return the command lines of the peer's processes, subscribers first."""
        roles = [f"subscriber-{index}" for index in range(work.subscribers)]
        roles += ["relay"] if self.has_relay else []
        roles += [f"stage-{index}" for index in reversed(range(work.stages))]
        return [worker_command(name, role, work_file) for role in (*roles, "publisher")]

    def clean(self, work: Work) -> None:
        """Remove what killed processes may have left."""

    @property
    def why_absent(self) -> str:
        """Why the peer cannot be measured here; '' if it can."""
        try:
            found = not self.module or importlib.util.find_spec(self.module) is not None
        except ImportError as error:
            return f"{self.module}: {error}"
        return "" if found else f"{self.package or self.module} is not installed"

    @property
    def version(self) -> str:
        """Version of the distribution."""
        try:
            return importlib.metadata.version(self.package) if self.package else ""
        except importlib.metadata.PackageNotFoundError:
            return "unknown"


def worker_command(name: str, role: str, work_file: Path) -> list[str]:
    """Return the command line of one process of a peer."""
    return [sys.executable, "-m", "tools.bench.worker", name, role, str(work_file)]
