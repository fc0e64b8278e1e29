"""Passes all writing to a separate process, so that the supervisor never waits for a disk.

It is a process and not a thread, because neither can be killed while it sleeps on a stalled disk: a thread
would keep the supervisor from ending. See `robbie_mp.run.trace.writer_process`.
"""

import contextlib
import fcntl
import json
import os
import select
import subprocess
import time
from collections import deque
from collections.abc import Callable, Sequence
from types import TracebackType

from typing_extensions import Self

from robbie_mp.base.linux.python_command import python_command
from robbie_mp.run.trace import writer_process

PIPE_BYTES = 1 << 20
"""The most that an unprivileged process may set (fs.pipe-max-size)."""
MAX_WAITING_BYTES = 8 << 20
MAX_FLUSH_S = 5.0
"""How long the end of a run waits for a disk that accepts nothing."""
RESTART_PERIOD_S = 1.0
OnDone = Callable[[bool], None]


class DiskWriter:
    """Sends orders to the process that writes. Only `flush` and `close` wait for the disk.

    An order is refused at once if too many bytes wait already. A writer process that died is replaced; orders
    that it had not acknowledged count as refused.

    Args:
        max_waiting_bytes: limit for the data that the disk has not accepted yet.
        clock: monotonic time in s.

    Attributes:
        on_restart: called when a dead process was replaced, before any other order.
        unfinished: number of orders that the disk had not accepted when this was closed.
        refused: number of orders that the disk refused, for example because it is full.
        refusal: the last reason; '': none was refused.
    """

    def __init__(
        self,
        max_waiting_bytes: int = MAX_WAITING_BYTES,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._max_waiting_bytes = max_waiting_bytes
        self._clock = clock
        self.on_restart: Callable[[], None] = lambda: None
        self.unfinished = self.refused = 0
        self.refusal = ""
        self._has_given_up = False
        self._unsent: deque[memoryview] = deque()
        self._unanswered: deque[tuple[int, OnDone]] = deque()
        self._waiting_bytes = 0
        self._answered_s = clock()
        self._started_s = float("-inf")
        self._was_started = self._is_closed = False
        self._process: subprocess.Popen[bytes] | None = None
        self._past: list[subprocess.Popen[bytes]] = []
        """Former writer processes that are not reaped yet."""
        self._orders = self._answers = -1
        self._start()

    @property
    def pids(self) -> set[int]:
        """The pid of the process, if there is one."""
        return {self._process.pid} if self._process else set()

    @property
    def waiting(self) -> int:
        """The number of orders that the disk has not accepted yet."""
        return len(self._unanswered)

    @property
    def stalled_s(self) -> float:
        """For how long the disk has accepted nothing although orders wait."""
        return self._clock() - self._answered_s if self._unanswered else 0.0

    def order(self, order: Sequence[str], data: bytes, on_done: OnDone = lambda _is_done: None) -> None:
        """Have something written.

        Args:
            order: its name and arguments; see `robbie_mp.run.trace.writer_process`.
            data: the data to write.
            on_done: called in this thread, now or later, with whether the disk accepted it.
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
        """Read acknowledgements and send waiting orders; called in every iteration of the loop."""
        self._past = [process for process in self._past if process.poll() is None]
        if self._process:
            self._read_acknowledgements()
            self._send()

    def flush(self, limit_s: float = MAX_FLUSH_S) -> bool:
        """Wait until all is written; return False if the disk accepts nothing for `limit_s`.

        After such a failure, further calls do not wait until the disk has accepted something.
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

    def close(self, limit_s: float = MAX_FLUSH_S) -> None:
        """Wait until all is written, as `flush` does, and let the process end.

        Orders that the disk has not accepted by then count as refused, but the process keeps trying.
        """
        self._is_closed = True
        self.flush(limit_s)
        self.unfinished += self.waiting
        self._let_go(limit_s if not self.waiting else 0.0)
        for process in self._past:
            if process.poll() is None:
                process.returncode = 0  # it sleeps on the disk; otherwise Popen would wait for it later

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def _start(self) -> bool:
        if self._is_closed or self._clock() - self._started_s < RESTART_PERIOD_S:
            return False
        self._started_s = self._clock()
        theirs, self._orders = os.pipe2(os.O_CLOEXEC)
        self._answers, answers = os.pipe2(os.O_CLOEXEC)
        with contextlib.suppress(OSError):  # the pipes of one user together have a limit too
            fcntl.fcntl(self._orders, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        os.set_blocking(self._orders, False)
        os.set_blocking(self._answers, False)
        try:
            self._process = subprocess.Popen(
                python_command(writer_process.__name__),
                stdin=theirs,
                stdout=answers,
                stderr=subprocess.DEVNULL,  # otherwise it would keep a terminal or a pipe open
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

    def _read_acknowledgements(self) -> None:
        try:
            while answers := os.read(self._answers, 4096):
                self._answered_s = self._clock()
                self._has_given_up = False
                for answer in answers:
                    length, on_done = self._unanswered.popleft()
                    self._waiting_bytes -= length
                    if answer != writer_process.DONE:
                        self.refused += 1
                        self.refusal = os.strerror(answer)
                    on_done(answer == writer_process.DONE)
        except BlockingIOError:
            return
        self._let_go(0.0)  # it has died

    def _let_go(self, limit_s: float) -> None:
        """Close the process's input, at the end of which it ends, and drop all unacknowledged orders."""
        if self._process is None:
            return
        process, self._process = self._process, None
        os.close(self._orders)
        if limit_s:
            select.select([self._answers], [], [], limit_s)  # its output ends when it ends
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
