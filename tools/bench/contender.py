"""Runs the processes of one peer for one piece of work, and ends them."""

import contextlib
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
import psutil
from numpy.typing import NDArray

from tools.bench import record
from tools.bench.peers.peer import Peer
from tools.bench.processes import mapped_names, remove_unmapped
from tools.bench.work import Work
from tools.robot import environment

LIMIT_S = 60.0


class Trouble(RuntimeError):
    """A contender failed to do its work."""


@dataclass
class WorkResult:
    """The result of one piece of work.

    Attributes:
        sent: number of messages published, without the warm-up.
        latencies_ns: latency for each subscriber and message; 0: the message has not arrived.
        took_s: time from the first publication to the last receipt.
    """

    sent: int
    latencies_ns: list[NDArray[np.int64]] = field(default_factory=list)
    took_s: float = 0.0

    @property
    def lost(self) -> int:
        """Number of messages that did not arrive, over all subscribers."""
        return sum(int(np.count_nonzero(one[: self.sent] == 0)) for one in self.latencies_ns)


class Contender(Protocol):
    """A system that the benchmarks measure."""

    @property
    def name(self) -> str:
        """Its name in results."""

    @property
    def title(self) -> str:
        """Its name in tables."""

    @property
    def how(self) -> str:
        """Its set-up, in one line."""

    @property
    def version(self) -> str:
        """Its version."""

    @property
    def why_absent(self) -> str:
        """Why it cannot be measured here; '' if it can."""

    @property
    def can_fill_in_place(self) -> bool:
        """Whether arrays can be filled in the published memory."""

    def run(self, work: Work) -> WorkResult:
        """Do the work.

        Raises:
            Trouble: the contender failed; the text says why.
        """


@contextlib.contextmanager
def work_folder() -> Iterator[tuple[str, Path]]:
    """Yield a topic and a folder that no other work uses, and remove the folder at the end."""
    with tempfile.TemporaryDirectory(prefix=f"robbie-bench{os.getpid()}-") as name:
        folder = Path(name)
        yield folder.name.replace("_", "-"), folder


class PeerContender:
    """Measures a peer."""

    def __init__(self, name: str, peer: Peer):
        self.name = name
        self.peer = peer
        self.title = peer.title
        self.how = peer.how

    @property
    def version(self) -> str:
        """The peer's version."""
        return self.peer.version

    @property
    def why_absent(self) -> str:
        """Why it cannot be measured here."""
        return self.peer.why_absent

    @property
    def can_fill_in_place(self) -> bool:
        """Whether the peer can."""
        return self.peer.can_fill_in_place

    def run(self, work: Work) -> WorkResult:
        """Start the peer's processes, and wait until they end."""
        with work_folder() as (topic, folder):
            here = work.at(topic, folder)
            try:
                with self.started(here) as processes:
                    wait_for_end(processes, LIMIT_S)
                return outcome(here)
            finally:
                self.peer.clean(here)

    @contextlib.contextmanager
    def started(self, work: Work) -> Iterator[list[subprocess.Popen[bytes]]]:
        """Start the peer's processes, subscribers first. At the end, kill those that still run.

        Raises:
            Trouble: the block raised it; this adds the last line that the processes printed.
        """
        work_file = work.folder / "work.json"
        work.save(work_file)
        with (work.folder / "stderr").open("w+") as errors:
            processes = [
                subprocess.Popen(
                    command,
                    cwd=work.folder,
                    env=environment(),
                    stdin=subprocess.DEVNULL,
                    stdout=errors,
                    stderr=errors,
                    start_new_session=True,
                )
                for command in self.peer.commands(self.name, work, work_file)
            ]
            try:
                yield processes
            except Trouble as trouble:
                raise Trouble(f"{trouble}: {last_words(work.folder / 'stderr')}") from None
            finally:
                end(processes)


def wait_for_end(processes: list[subprocess.Popen[bytes]], limit_s: float) -> None:
    """Wait until all processes have ended with exit code 0.

    Raises:
        Trouble: a process failed or did not end in time.
    """
    deadline_s = time.monotonic() + limit_s
    for process in reversed(processes):  # the publisher is last in the list and ends first
        try:
            code = process.wait(max(0.0, deadline_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            raise Trouble(f"it did not end within {limit_s:g} s") from None
        if code:
            raise Trouble(f"a process ended with {code}")
        deadline_s = min(deadline_s, time.monotonic() + 10.0)


def end(processes: list[subprocess.Popen[bytes]]) -> None:
    """Kill processes that still run, with their descendants, and remove the shared memory they leave."""
    left = []
    for process in processes:
        if process.poll() is None:
            with contextlib.suppress(psutil.NoSuchProcess):
                parent = psutil.Process(process.pid)
                left += [parent, *parent.children(recursive=True)]
    if not left:
        return
    names = mapped_names([one.pid for one in left])
    for one in left:
        with contextlib.suppress(psutil.NoSuchProcess):
            one.kill()  # psutil checks that the pid is still the same process
    for process in processes:
        process.wait()
    psutil.wait_procs(left, timeout=5)
    remove_unmapped(names)


def last_words(file: Path) -> str:
    """Return the last line of a file that is not empty."""
    lines = [line.strip(" -=") for line in file.read_text(errors="replace").splitlines()]
    return next(filter(None, reversed(lines)), "it printed nothing")


def outcome(work: Work) -> WorkResult:
    """Read the records of finished work."""
    publisher = np.fromfile(record.publisher_file(work), np.int64)
    last_ns = 0
    latencies = []
    for index in range(work.subscribers):
        words = np.fromfile(record.subscriber_file(work, index), np.int64)
        last_ns = max(last_ns, int(words[record.LAST_NS]))
        latencies.append(words[record.HEADER :])
    took_s = (last_ns - int(publisher[record.BEGAN_NS])) / 1e9
    return WorkResult(int(publisher[record.SENT]), latencies, took_s)
