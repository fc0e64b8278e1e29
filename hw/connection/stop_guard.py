"""Small processes that stop a robot when its driver no longer can: it has died, or it hangs.

They need no module of the project, so that they start at once.
"""

import os
import select
import struct
import subprocess
import sys
import time
from collections import deque
from contextlib import suppress

# An order: the time until which the robot may move, 0: it stands; and the time at which it was sent. Both by
# CLOCK_MONOTONIC, s, which all processes share. The guard answers with the newest order that it has read.
_ORDER = struct.Struct("dd")
PING_PERIOD_S = 0.05
ANSWER_LIMIT_S = 0.2
"""A guard that has not answered an order for this time counts as lost."""
FIRST_ANSWER_LIMIT_S = 2.0
"""A new guard may take this time to start; no guard is replaced sooner after its start."""
GUARDS = 2
"""If the driver hangs and one of them is lost, too, there is another."""
END_TIMEOUT_S = 1.0
WRITE_TIMEOUT_S = 0.5
REPEAT_PERIOD_S = 0.1
"""A driver that comes back may still write a command that has expired, and hang again."""
READ_BYTES = 65_536


class StopGuard:
    """Watches over one open port, and is watched itself: call `watch` every `PING_PERIOD_S`.

    The process stands outside the module's session and has none of its marks. The supervisor kills what a
    dead module leaves behind, and would kill the guard before it has written the stop. It ends when its
    orders end. A guard that has ended, or that does not answer, is replaced.

    Nothing here waits for the guard, except for its first start and its end, both for a bounded time. The
    guard waits for a slow line only at its end, so a line that takes no bytes does not make it silent.

    Args:
        descriptor: the open port's; the guard writes to the same port.
        stop: bytes that stop the robot.

    Raises:
        OSError: no process can be started.
    """

    def __init__(self, descriptor: int, stop: bytes) -> None:
        # Isolated, and without site packages: it starts within some 20 ms.
        self._command = [sys.executable, "-I", "-S", __file__, str(descriptor), stop.hex()]
        self._descriptor = descriptor
        self._until_s = 0.0
        self._unanswered: deque[float] = deque()
        self._is_lost = False
        self._started_s = 0.0
        self._process: subprocess.Popen[bytes] | None = None
        self._start()
        select.select([self._answers], [], [], FIRST_ANSWER_LIMIT_S)

    def allow(self, valid_for_s: float) -> bool:
        """Let the robot move for this time; 0: it stands. Return False if no guard answers: do not drive.

        An order that is refused changes nothing: the robot may still move by the one before.
        """
        is_answering = self.is_answering
        if valid_for_s > 0 and not is_answering:
            return False
        self._until_s = time.monotonic() + valid_for_s if valid_for_s > 0 else 0.0
        if is_answering:
            self._send()
        return is_answering

    def watch(self) -> str:
        """Replace the guard if it is lost. Return why it was, '' if it is not.

        A later call ends it and starts the new one: you stop the robot first. A guard that hangs may not
        end soon, and a new one has no order to end.
        """
        if self._is_lost:
            # Guards that keep dying would let the robot move by fits and starts.
            if time.monotonic() >= self._started_s + FIRST_ANSWER_LIMIT_S:
                self._replace()
            return ""
        reason = self._loss()
        if reason:
            self._until_s = 0.0
            self._is_lost = True
        elif self._has_answered and time.monotonic() >= self._sent_s + PING_PERIOD_S:
            self._send()
        return reason

    @property
    def is_answering(self) -> bool:
        """Return whether the guard would stop the robot if this process died now."""
        return not self._is_lost and not self._loss() and self._has_answered

    def close(self) -> None:
        """End the guard. It stops the robot, as at every end."""
        if self._process is not None and self.is_answering:
            assert self._process.stdin is not None
            self._process.stdin.close()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(END_TIMEOUT_S)
        self._kill()

    def _replace(self) -> None:
        self._kill()
        with suppress(OSError):
            self._start()

    def _start(self) -> None:
        """Start a process, and ask it for its first answer."""
        self._is_lost = self._has_answered = self._has_ended = False
        self._started_s = time.monotonic()
        self._unanswered.clear()
        self._unanswered.append(self._started_s)
        environment = {name: value for name, value in os.environ.items() if not name.startswith("ROBBIE_")}
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=[self._descriptor],
            start_new_session=True, env=environment,
        )  # fmt: skip
        assert self._process.stdin is not None and self._process.stdout is not None
        self._orders, self._answers = self._process.stdin.fileno(), self._process.stdout.fileno()
        # A guard that is stopped does not read: a full pipe would hang the driver.
        os.set_blocking(self._orders, False)
        os.set_blocking(self._answers, False)
        self._send()

    def _kill(self) -> None:
        if self._process is None:
            return
        self._process.kill()
        # A debugger may keep it from ending.
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(ANSWER_LIMIT_S)
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.stdout.close()
        self._process = None

    def _send(self) -> None:
        self._sent_s = time.monotonic()
        self._unanswered.append(self._sent_s)
        # What does not arrive is not answered.
        with suppress(OSError):
            os.write(self._orders, _ORDER.pack(self._until_s, self._sent_s))

    def _loss(self) -> str:
        """Return why the guard is lost, '' if it is not."""
        # Its answers come first: this process may have been away, or the answer comes just now.
        now_s = time.monotonic()
        self._hear()
        if self._has_ended and self._has_answered:
            return "the stop guard has ended"
        limit_s = ANSWER_LIMIT_S if self._has_answered else FIRST_ANSWER_LIMIT_S
        if self._unanswered and now_s - self._unanswered[0] > limit_s:
            return "the stop guard does not answer"
        return ""

    def _hear(self) -> None:
        """Take the guard's answers."""
        if self._process is None or self._has_ended:
            return
        try:
            data = os.read(self._answers, READ_BYTES)
        except BlockingIOError:
            return
        if not data:
            self._has_ended = True
            return
        _, answered_s = _ORDER.unpack(data[-_ORDER.size :])
        self._has_answered = True
        while self._unanswered and self._unanswered[0] <= answered_s:
            self._unanswered.popleft()


class StopGuards:
    """Guards of one open port, used like a single `StopGuard`: the robot moves only while all answer.

    Args:
        descriptor: see `StopGuard`.
        stop: likewise.

    Raises:
        OSError: a process cannot be started.
    """

    def __init__(self, descriptor: int, stop: bytes) -> None:
        self._guards: list[StopGuard] = []
        try:
            for _ in range(GUARDS):
                self._guards.append(StopGuard(descriptor, stop))
        except OSError:
            self.close()
            raise

    def allow(self, valid_for_s: float) -> bool:
        """Let the robot move for this time; 0: it stands. Return False if a guard does not answer.

        See `StopGuard.allow`.
        """
        if valid_for_s > 0 and not self.is_answering:
            return False
        return all([guard.allow(valid_for_s) for guard in self._guards])

    def watch(self) -> str:
        """Replace guards that are lost; see `StopGuard.watch`."""
        return next(filter(None, [guard.watch() for guard in self._guards]), "")

    @property
    def is_answering(self) -> bool:
        """Return whether each guard would stop the robot if this process died now."""
        return all(guard.is_answering for guard in self._guards)

    def close(self) -> None:
        """End the guards. They stop the robot, as at every end."""
        for guard in self._guards:
            guard.close()


def watch(orders: int, answers: int, port: int, stop: bytes) -> None:
    """Stop the robot when an order expires, until the next one comes, and at the end of the orders."""
    os.set_blocking(answers, False)
    until_s, unwritten = 0.0, b""
    while True:
        wait_s = max(0.0, until_s - time.monotonic()) if until_s else None
        ordered, writable, _ = select.select([orders], [port] if unwritten else [], [], wait_s)
        if ordered:
            data = os.read(orders, 64 * _ORDER.size)
            if not data:
                break
            order = data[-_ORDER.size :]
            until_s, _ = _ORDER.unpack(order)
            # The driver may have died, or takes no answers.
            with suppress(OSError):
                os.write(answers, order)
        elif until_s and time.monotonic() >= until_s:
            # What is left of a stop comes first: half of one is no command.
            until_s, unwritten = time.monotonic() + REPEAT_PERIOD_S, unwritten or stop
        elif writable:
            unwritten = unwritten[_write(port, unwritten) :]
    if select.select([], [port], [], WRITE_TIMEOUT_S)[1]:
        _write(port, stop)


def _write(port: int, data: bytes) -> int:
    """Return how many bytes need not be written again."""
    try:
        return os.write(port, data)
    except BlockingIOError:
        return 0
    except OSError:
        return len(data)  # the port was pulled out


if __name__ == "__main__":
    watch(0, 1, int(sys.argv[1]), bytes.fromhex(sys.argv[2]))
