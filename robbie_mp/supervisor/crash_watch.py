"""Gathers what is known of a child that has come to an abnormal end."""

import signal
import time
from collections.abc import Callable
from pathlib import Path

from robbie_mp.supervisor.incarnations import Incarnations
from robbie_mp.supervisor.output import ChildOutput
from robbie_mp.supervisor.process import ExitStatus
from robbie_mp.trace.crash import CrashReport

VMSTAT = Path("/proc/vmstat")


class CrashWatch:
    """Follows one child, to report how it ended."""

    def __init__(
        self, name: str, output: ChildOutput, incarnations: Incarnations, clock: Callable[[], float]
    ):
        """Prepare.

        Args:
            name: of the child.
            output: has its last lines, and gets the report.
            incarnations: tells what it has left in memory.
            clock: a time in s that never goes back.
        """
        self._name = name
        self._output = output
        self._incarnations = incarnations
        self._clock = clock
        self._incarnation = 0
        self._pid = 0
        self._started_s = 0.0
        self._memory_kills = 0

    def begin(self, incarnation: int, pid: int) -> None:
        """Note the start of an incarnation."""
        self._incarnation = incarnation
        self._pid = pid
        self._started_s = self._clock()
        self._memory_kills = memory_kills()

    def report(self, status: ExitStatus, reason: str, *, was_killed_by_us: bool) -> None:
        """Report its end; its memory is not reclaimed yet, and all it has printed was read."""
        hints = []
        if status.signal == signal.SIGKILL and not was_killed_by_us:
            hints.append(self._who_killed_it())
        report = CrashReport(
            module=self._name,
            incarnation=self._incarnation,
            pid=self._pid,
            time_s=time.time(),
            uptime_s=self._clock() - self._started_s,
            reason=reason,
            exit_code=status.code,
            signal=status.signal,
            cpu_s=status.cpu_s,
            hints=hints,
            last_words=self._incarnations.last_words(self._name, self._incarnation),
            said=[],
            printed=[],
        )
        self._output.report_crash(report)

    def _who_killed_it(self) -> str:
        count = memory_kills() - self._memory_kills
        if count:
            return f"since its start the kernel has killed {count} processes for lack of memory: see dmesg"
        return "not killed by the supervisor, nor by the kernel for lack of memory"


def memory_kills(vmstat: Path = VMSTAT) -> int:
    """Return how many processes the kernel has killed because memory was full; 0 if it does not tell."""
    try:
        lines = vmstat.read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("oom_kill ")), 0)
