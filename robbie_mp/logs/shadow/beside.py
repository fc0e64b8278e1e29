"""The process of a shadow, as the one that feeds it sees it."""

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from tempfile import TemporaryDirectory
from types import TracebackType

from typing_extensions import Self

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.python_command import python_command
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.shadow.feed import Feed
from robbie_mp.logs.shadow.frames import (
    READ_BYTES,
    Begin,
    BrokenFrame,
    Done,
    EndedByError,
    Frames,
    OfShadow,
    Ready,
    Said,
    Start,
    Wants,
    packed,
)
from robbie_mp.run.supervisor.scheduling import computing_with

WINDOW = 8
"""Messages that the shadow may have been sent and not have handled."""
START_S = 300.0
"""Imports and setup may take this long."""
END_S = 1.0
MOST_TIMES = 100_000
MOST_READS = 64
"""Reads from the shadow in one go: a flood must not keep the tool from taking the run's messages."""


class ShadowFailed(RobbieError, RuntimeError):
    """The variant does not start.

    Example scenarios:
      - its setup() opens a device, which a shadow must not
      - it raises an exception
    """


class ShadowProcess:
    """Starts, feeds and ends the process.

    Args:
        begin: what it is; its folder is made here.
        compute_threads: see the profile.
        is_over: asked while it starts; true ends that.

    Attributes:
        feed: what waits for it.
        subscriptions: what it has subscribed to: type, version, topic, whether only the newest is wanted.
        handled: messages that it has handled.
        calls: calls that it has made.
        done_ns: up to which time it has handled everything.
        times_ns: how long it took for each of its last messages.
        end: how it ended; '' while it runs.
    """

    def __init__(self, begin: Begin, compute_threads: int, is_over: Callable[[], bool]):
        self._folder = TemporaryDirectory(prefix="robbie-shadow-")
        begin.folder = self._folder.name
        ours, theirs = socket.socketpair()
        self._connection = ours
        ours.setblocking(False)
        try:
            self._process = subprocess.Popen(
                [*python_command("robbie_mp.logs.shadow.process"), str(os.getpid())],
                stdin=theirs.fileno(),
                stdout=sys.stderr,
                env=computing_with(os.environ, compute_threads),
                start_new_session=True,
            )
        except BaseException:
            ours.close()
            self._folder.cleanup()
            raise
        finally:
            theirs.close()
        self._frames = Frames(OfShadow)
        self._unsent = memoryview(packed(begin))
        self._in_flight: deque[bool] = deque()
        """Of each frame that it has been sent and not handled: whether it is a message."""
        self._is_ready = False
        self._is_over = is_over
        self.feed = Feed()
        self.subscriptions: list[tuple[str, int, str, bool]] | None = None
        self.handled = self.calls = self.done_ns = 0
        self.times_ns: deque[int] = deque(maxlen=MOST_TIMES)
        self.end = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process, whatever it does."""
        self._connection.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._folder.cleanup()

    @property
    def unhandled(self) -> int:
        """Messages that it has not handled yet."""
        return sum(self._in_flight) + self.feed.messages

    def wait_until_ready(self) -> None:
        """Wait until its code is imported.

        Raises:
            ShadowFailed: that fails.
        """
        self._wait(lambda: self._is_ready, "imported")

    def start(self, begin_ns: int, checkpoint: bytes | None) -> None:
        """Let it run its setup, and wait until that is done.

        Args:
            begin_ns: the time.
            checkpoint: the state that it restores, encoded; None: it starts fresh.

        Raises:
            ShadowFailed: it ends, or takes too long.
        """
        self.done_ns = begin_ns
        self._unsent = memoryview(packed(Start(begin_ns, checkpoint)))
        self._wait(lambda: self.subscriptions is not None, "set up")

    def _wait(self, condition: Callable[[], bool], what: str) -> None:
        until_s = time.monotonic() + START_S
        while not condition():
            list(self.pump(0.05))
            if self.end:
                raise ShadowFailed(f"the shadow has ended before it was {what}: {self.end}")
            if self._is_over():
                raise ShadowFailed(f"the shadow was ended before it was {what}")
            if time.monotonic() > until_s:
                raise ShadowFailed(f"the shadow was not {what} within {START_S:g} s")

    def wants(self, type_name: str, version: int, topic: str) -> bool | None:
        """Return whether it subscribes to a channel; None: only to its newest message."""
        channel = ChannelName(type_name, version, topic)
        wanted = self.subscriptions or ()
        found = [one[3] for one in wanted if ChannelName(*one[:3]).takes(channel)]
        return None if found and all(found) else bool(found)

    def pump(self, timeout_s: float) -> Iterator[Said]:
        """Send what waits for it while it has room, and yield what it publishes.

        Args:
            timeout_s: how long to wait for either.
        """
        self._fill()
        if self.end:
            return
        writers = [self._connection] if self._unsent else []
        readable, writable, _ = select.select([self._connection], writers, [], timeout_s)
        if writable:
            self._send()
        for _ in range(MOST_READS if readable else 0):
            try:
                data = self._connection.recv(READ_BYTES)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                self._has_ended()
                break
            try:
                for frame in self._frames.add(data):
                    if isinstance(frame, Said):
                        yield frame
                    else:
                        self._take(frame)
            except BrokenFrame as error:
                self.end = f"it has written into its connection: {error}"
                return
        self._fill()

    def _fill(self) -> None:
        while not self.end and len(self.feed) and not self._unsent and len(self._in_flight) < WINDOW:
            given = self.feed.take()
            self._in_flight.append(bool(given.type_name))
            self._unsent = memoryview(packed(given))
            self._send()

    def _send(self) -> None:
        try:
            self._unsent = self._unsent[self._connection.send(self._unsent) :]
        except BlockingIOError:
            pass
        except OSError:  # it has ended; what it said last is still to be read
            self._unsent = memoryview(b"")

    def _take(self, frame: "Ready | Wants | Done | EndedByError") -> None:
        match frame:
            case Ready():
                self._is_ready = True
            case Wants(subscriptions=subscriptions):
                self.subscriptions = subscriptions
            case Done(time_ns=time_ns, took_ns=took_ns, calls=calls) if self._in_flight:
                self.done_ns, self.calls = max(self.done_ns, time_ns), calls
                if self._in_flight.popleft():
                    self.handled += 1
                    self.times_ns.append(took_ns)
            case EndedByError(text=text):
                self.end = text

    def _has_ended(self) -> None:
        if self.end:
            return
        try:
            code = self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.end = "it has closed its connection"
            return
        self.end = f"exit code {code}" if code >= 0 else f"killed by {signal.Signals(-code).name}"
