"""Hands what is to be written to a process of its own, so that the supervisor never waits for a disk.

A process and not a thread: one that sleeps on a stalled disk cannot be killed, and a thread like that would
keep the supervisor itself from ending. See `robbie_mp.trace.writer_process`.
"""

import contextlib
import fcntl
import json
import os
import select
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from robbie_mp.trace import writer_process

PIPE_BYTES = 1 << 20
"""What an ordinary process may ask for on Linux (fs.pipe-max-size)."""
MAX_WAITING_BYTES = 8 << 20
CLOSE_LIMIT_S = 5.0
"""So long the end of a run waits for a disk that does not take anything more."""
START_EVERY_S = 1.0
OnDone = Callable[[bool], None]


class DiskWriter:
    """Gives orders to a process that writes; no call waits for the disk, but for `flush` and `close`.

    What finds no room, because too many bytes wait already, is refused at once. A process that died is
    replaced; what it had not answered counts as refused.

    Args:
        max_waiting_bytes: bound of all that the disk has not taken yet.
        clock: a time in s that never goes back.

    Attributes:
        on_restart: called when a dead process was replaced, before any other order.
        unfinished: orders that the disk had not taken when this was closed.
    """

    def __init__(
        self,
        max_waiting_bytes: int = MAX_WAITING_BYTES,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._max_waiting_bytes = max_waiting_bytes
        self._clock = clock
        self.on_restart: Callable[[], None] = lambda: None
        self.unfinished = 0
        self._has_given_up = False
        self._unsent: deque[memoryview] = deque()
        self._unanswered: deque[tuple[int, OnDone]] = deque()
        self._waiting_bytes = 0
        self._answered_s = clock()
        self._started_s = float("-inf")
        self._was_started = self._is_closed = False
        self._process: subprocess.Popen[bytes] | None = None
        self._past: list[subprocess.Popen[bytes]] = []
        """Processes that were let go and are not reaped yet."""
        self._orders = self._answers = -1
        self._start()

    @property
    def pids(self) -> set[int]:
        """The process, if there is one."""
        return {self._process.pid} if self._process else set()

    @property
    def waiting(self) -> int:
        """How many orders the disk has not taken yet."""
        return len(self._unanswered)

    @property
    def stalled_s(self) -> float:
        """For how long the disk has taken nothing though something waits."""
        return self._clock() - self._answered_s if self._unanswered else 0.0

    def order(self, order: Sequence[str], data: bytes, on_done: OnDone = lambda _is_done: None) -> None:
        """Have something written.

        Args:
            order: its name and arguments; see `robbie_mp.trace.writer_process`.
            data: what is to be written.
            on_done: called in this thread, now or later, with whether the disk has taken it.
        """
        self.turn()
        frame = json.dumps([*order, len(data)]).encode() + b"\n" + data
        is_full = self._waiting_bytes + len(frame) > self._max_waiting_bytes
        if is_full or (self._process is None and not self._start()):
            on_done(False)
            return
        if not self._unanswered:
            self._answered_s = self._clock()
        self._unanswered.append((len(frame), on_done))
        self._waiting_bytes += len(frame)
        self._unsent.append(memoryview(frame))
        self._send()

    def turn(self) -> None:
        """Hear what was done, and send what found no room before; called every turn of the loop."""
        self._past = [process for process in self._past if process.poll() is None]
        if self._process:
            self._hear()
            self._send()

    def flush(self, limit_s: float = CLOSE_LIMIT_S) -> bool:
        """Wait until all is written; False if the disk takes nothing for so long.

        When that was waited for in vain, it is not waited for again before the disk takes something.
        """
        self.turn()
        begin_s = self._clock()
        while self._unanswered and not self._has_given_up:
            left_s = limit_s - (self._clock() - max(begin_s, self._answered_s))
            self._has_given_up = left_s <= 0
            to_send = [self._orders] if self._unsent else []
            select.select([self._answers], to_send, [], max(0.0, left_s))
            self.turn()
        return not self._unanswered

    def close(self, limit_s: float = CLOSE_LIMIT_S) -> None:
        """Wait for what is still to be written, as `flush`, and let the process end.

        What the disk has not taken by then is refused; but the process goes on trying.
        """
        self._is_closed = True
        self.flush(limit_s)
        self.unfinished += self.waiting
        self._let_go(limit_s if not self.waiting else 0.0)
        for process in self._past:
            if process.poll() is None:
                process.returncode = 0  # it sleeps on the disk; Popen would otherwise wait for it some day

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def _start(self) -> bool:
        if self._is_closed or self._clock() - self._started_s < START_EVERY_S:
            return False
        self._started_s = self._clock()
        theirs, self._orders = os.pipe2(os.O_CLOEXEC)
        self._answers, answers = os.pipe2(os.O_CLOEXEC)
        with contextlib.suppress(OSError):  # all pipes of this user together have a limit, too
            fcntl.fcntl(self._orders, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        os.set_blocking(self._orders, False)
        os.set_blocking(self._answers, False)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", writer_process.__name__],
                stdin=theirs,
                stdout=answers,
                stderr=subprocess.DEVNULL,  # else a terminal or a pipe would stay open as long as it lives
                start_new_session=True,
            )
        except OSError:
            self._close_pipes()
            return False
        finally:
            os.close(theirs)
            os.close(answers)
        if self._was_started:
            self.on_restart()
        self._was_started = True
        return True

    def _send(self) -> None:
        try:
            while self._unsent:
                frame = self._unsent[0]
                written = os.write(self._orders, frame)
                if written == len(frame):
                    self._unsent.popleft()
                else:
                    self._unsent[0] = frame[written:]
        except BlockingIOError:
            return
        except OSError:  # it has died
            self._let_go(0.0)

    def _hear(self) -> None:
        try:
            while answers := os.read(self._answers, 4096):
                self._answered_s = self._clock()
                self._has_given_up = False
                for answer in answers:
                    length, on_done = self._unanswered.popleft()
                    self._waiting_bytes -= length
                    on_done(answer == writer_process.DONE[0])
        except BlockingIOError:
            return
        self._let_go(0.0)  # it has died

    def _let_go(self, limit_s: float) -> None:
        """Be done with the process; it ends at the end of its input, sooner or later."""
        if self._process is None:
            return
        process, self._process = self._process, None
        os.close(self._orders)
        if limit_s:
            select.select([self._answers], [], [], limit_s)  # the end of its output is the end of it
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(limit_s)
        os.close(self._answers)
        self._orders = self._answers = -1
        if process.poll() is None:
            self._past.append(process)
        self._unsent.clear()
        unanswered, self._unanswered = self._unanswered, deque()
        self._waiting_bytes = 0
        for _, on_done in unanswered:
            on_done(False)

    def _close_pipes(self) -> None:
        os.close(self._orders)
        os.close(self._answers)
        self._orders = self._answers = -1
