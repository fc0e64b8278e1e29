"""Runs a program, and ends its whole tree of processes when it or its module ends.

Started as `python -I -S guardian.py STOP_SIGNAL GRACE_S COMMAND …`, without our packages, so that it starts
quickly and needs little memory. It adopts the orphans of the program, whatever session and environment they
have. Its standard input is a pipe from the module: the byte `t` asks the program to end, and the pipe's end
means that the module has died, however it died.
"""

import contextlib
import ctypes
import os
import select
import signal
import sys
import time

PR_SET_PDEATHSIG = 1
PR_SET_CHILD_SUBREAPER = 36
STOP = b"t"
CANNOT_START = 127
"""Exit code, as a shell has it."""
SIGNALLED = 128
"""Added to the number of the signal that ended the program, as a shell does."""
END_WAIT_S = 5.0
RETRY_S = 0.005


class Guardian:
    """One program.

    Args:
        stop_signal: asks it to end.
        grace_s: time until it is killed.
    """

    def __init__(self, stop_signal: int, grace_s: float):
        self._stop_signal, self._grace_s = stop_signal, grace_s
        self._kill_at_s: float | None = None
        self._code: int | None = None
        self._pid = 0

    def run(self, command: list[str]) -> int:
        """Run the program until it, or the module, has ended; return its exit code."""
        _prctl(PR_SET_CHILD_SUBREAPER, 1)
        wakes, wake = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
        for signum in (signal.SIGCHLD, signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(signum, lambda _signal, _frame: None)  # programs do not inherit handlers
        self._pid = _start(command)
        while self._may_go_on():
            wait_s = None if self._kill_at_s is None else max(0.0, self._kill_at_s - time.monotonic())
            ready, _, _ = select.select([0, wakes], [], [], wait_s)
            if wakes in ready:
                with contextlib.suppress(BlockingIOError):
                    os.read(wakes, 4096)
            if 0 in ready and not self._hear():
                break
        self._end_all()
        return SIGNALLED + signal.SIGKILL if self._code is None else self._code

    def _may_go_on(self) -> bool:
        """Reap what has ended; return whether the program still runs, and may."""
        self._reap()
        is_late = self._kill_at_s is not None and time.monotonic() >= self._kill_at_s
        return self._code is None and not is_late

    def _hear(self) -> bool:
        """Do what the module asks for; return whether it still lives."""
        asked = os.read(0, 1)
        if asked == STOP and self._kill_at_s is None:
            self._kill_at_s = time.monotonic() + self._grace_s
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._pid, self._stop_signal)
                os.killpg(self._pid, signal.SIGCONT)
        return asked != b""

    def _reap(self) -> None:
        with contextlib.suppress(ChildProcessError):
            while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                if ended[0] == self._pid:
                    code = os.waitstatus_to_exitcode(ended[1])
                    self._code = code if code >= 0 else SIGNALLED - code

    def _end_all(self) -> None:
        """Kill all that is left of the tree; again, because processes may fork meanwhile."""
        give_up_s = time.monotonic() + END_WAIT_S
        while (pids := _descendants()) and time.monotonic() < give_up_s:
            for pid in pids:
                with contextlib.suppress(OSError):
                    os.kill(pid, signal.SIGKILL)
            time.sleep(RETRY_S)
            self._reap()


def _start(command: list[str]) -> int:
    """Start a program in a process group of its own; return its pid."""
    own_pid = os.getpid()
    pid = os.fork()
    if pid:
        with contextlib.suppress(OSError):  # it may have done so itself, and begun
            os.setpgid(pid, pid)
        return pid
    try:
        os.setpgid(0, 0)
        _prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        if os.getppid() == own_pid:
            os.execvp(command[0], command)
    except OSError as error:
        os.write(2, f"{command[0]} cannot be started: {error.strerror}\n".encode())
    os._exit(CANNOT_START)


def _descendants() -> list[int]:
    """Return the pids of all processes that descend from this one, zombies included."""
    children: dict[int, list[int]] = {}
    for name in os.listdir("/proc"):
        if name.isdecimal():
            with contextlib.suppress(OSError), open(f"/proc/{name}/stat", "rb") as file:
                children.setdefault(int(file.read().rpartition(b")")[2].split()[1]), []).append(int(name))
    found, new = [], [os.getpid()]
    while new:
        new = [child for pid in new for child in children.get(pid, [])]
        found += new
    return found


def _prctl(option: int, value: int) -> None:
    ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), 0, 0, 0)


if __name__ == "__main__":
    sys.exit(Guardian(int(sys.argv[1]), float(sys.argv[2])).run(sys.argv[3:]))
