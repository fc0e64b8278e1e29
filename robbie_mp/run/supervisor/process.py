"""One child process: started in a separate session, watched by a pidfd, reaped exactly once."""

import contextlib
import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from typing_extensions import Self

from robbie_mp.base.linux.pidfd import P_PIDFD, open_process, send_signal
from robbie_mp.base.linux.proc import has_ended, read_stat
from robbie_mp.run.supervisor.leftovers import MARKER
from robbie_mp.run.trace.channel import CHANNEL_VARIABLE, open_channel


@dataclass(frozen=True)
class ExitStatus:
    """How a process ended: by an exit code or a signal."""

    code: int | None = None
    signal: int | None = None
    cpu_s: float = field(default=0.0, compare=False)
    """Processor time of the process."""

    @property
    def is_clean(self) -> bool:
        """Whether it ended with exit code 0."""
        return self.code == 0

    @property
    def reason(self) -> str:
        """Description in words, such as "exit code 1" or "killed by SIGSEGV"."""
        if self.signal is None:
            return f"exit code {self.code}"
        try:
            return f"killed by {signal.Signals(self.signal).name}"
        except ValueError:
            return f"killed by signal {self.signal}"  # real-time signals have no names


class ChildProcess:
    """A running child.

    Attributes:
        pid: also the number of its process group and session.
        pidfd: becomes readable when the child has ended (pidfd_open(2)).
        stdout: reading end of its standard output, non-blocking; the caller closes it.
        stderr: reading end of its standard error, likewise.
        log_channel: reading end of its log channel, likewise.
        marker: identifies its descendants.
    """

    def __init__(
        self,
        popen: "subprocess.Popen[bytes]",
        pidfd: int,
        stdout: int,
        stderr: int,
        log_channel: int,
        child_marker: str,
    ):
        self._popen = popen
        self.pid = popen.pid
        self.marker = child_marker
        self.pidfd = pidfd
        self.stdout = stdout
        self.stderr = stderr
        self.log_channel = log_channel

    @classmethod
    def start(
        cls,
        argv: Sequence[str],
        environment: Mapping[str, str],
        child_marker: str,
        folder: Path | None = None,
        stdin: int = subprocess.DEVNULL,
    ) -> Self:
        """Start a command with its output in pipes. It inherits no descriptor except its log channel.

        Call this from the main thread: children receive PR_SET_PDEATHSIG when the starting thread ends.

        Args:
            argv: the command.
            environment: the whole environment except `MARKER` and `CHANNEL_VARIABLE`.
            child_marker: the value of `MARKER`.
            folder: the working directory; None: this process's.
            stdin: standard input, empty by default; the caller still closes its descriptor.

        Raises:
            OSError: the command cannot be executed.
        """
        with contextlib.ExitStack() as on_failure, contextlib.ExitStack() as theirs:

            def ends(reader: int, writer: int) -> tuple[int, int]:
                on_failure.callback(os.close, reader)
                theirs.callback(os.close, writer)
                return reader, writer

            out_read, out_write = ends(*os.pipe2(os.O_CLOEXEC))
            error_read, error_write = ends(*os.pipe2(os.O_CLOEXEC))
            channel_read, channel_write = ends(*open_channel())
            os.set_blocking(out_read, False)
            os.set_blocking(error_read, False)
            popen = subprocess.Popen(
                argv,
                stdin=stdin,
                stdout=out_write,
                stderr=error_write,
                env={**environment, MARKER: child_marker, CHANNEL_VARIABLE: str(channel_write)},
                cwd=folder,
                start_new_session=True,
                close_fds=True,
                pass_fds=(channel_write,),
            )
            on_failure.callback(popen.wait)
            on_failure.callback(popen.kill)  # it is not reaped yet, so its pid cannot have been reused
            pidfd = open_process(popen.pid)
            on_failure.pop_all()
        return cls(popen, pidfd, out_read, error_read, channel_read, child_marker)

    def exit_status(self) -> ExitStatus | None:
        """Return how it ended, None while it runs. It stays a zombie, so its pid cannot be reused.

        A debugger that holds it is told first, and us it tells nothing: then it counts as killed.
        """
        ended = os.waitid(P_PIDFD, self.pidfd, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        if ended is None and not has_ended(self.pid):
            return None
        stat = read_stat(self.pid)  # of the zombie
        cpu_s = stat.cpu_ticks / os.sysconf("SC_CLK_TCK") if stat else 0.0
        if ended is None:
            return ExitStatus(signal=signal.SIGKILL, cpu_s=cpu_s)
        if ended.si_code == os.CLD_EXITED:
            return ExitStatus(code=ended.si_status, cpu_s=cpu_s)
        return ExitStatus(signal=ended.si_status, cpu_s=cpu_s)

    @property
    def is_stopped(self) -> bool:
        """Whether a signal such as SIGSTOP has stopped it."""
        try:
            return os.waitid(P_PIDFD, self.pidfd, os.WSTOPPED | os.WNOHANG | os.WNOWAIT) is not None
        except ChildProcessError:  # it has ended, perhaps since `exit_status` was asked: it will never stop
            return False

    def terminate(self) -> None:
        """Send SIGTERM; also continue a stopped process, which could not handle it otherwise."""
        self.send_signal(signal.SIGTERM)
        self.send_signal(signal.SIGCONT)

    def send_signal(self, signum: int) -> None:
        """Send a signal to it alone."""
        with contextlib.suppress(PermissionError):  # it runs as another user, as with sudo
            send_signal(self.pidfd, signum)

    def kill(self) -> None:
        """Kill its whole process group."""
        with contextlib.suppress(PermissionError):
            os.killpg(self.pid, signal.SIGKILL)

    def reap(self) -> None:
        """Reap it if it has ended, and close its pidfd. Do not use this object afterwards."""
        os.waitid(P_PIDFD, self.pidfd, os.WEXITED | os.WNOHANG)
        os.close(self.pidfd)
        # Otherwise Popen would reap the pid later, when it may belong to another process.
        self._popen.returncode = 0
