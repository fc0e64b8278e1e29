"""Has a capsule written of each crash, by a process of its own: the supervisor waits for no disk.

Before a dead module's memory is reclaimed, the supervisor opens what the capsule needs of it. The process
that writes gets these descriptors, so that nothing can be taken from it, and the module is restarted
meanwhile.
"""

import contextlib
import json
import os
import subprocess
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import BinaryIO

from robbie_mp.base.linux.python_command import python_command
from robbie_mp.base.token_bucket import TokenBucket
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.shared_folder import ForeignMemory, SegmentMissing, opened_folder
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.trace.crash import CRASH_FOLDER, CrashReport, report_name
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.trace.reader import LOG_FOLDER

WRITER = "robbie_mp.logs.capsule.write"
SUFFIX = ".capsule"
BURST, PER_S = 3, 0.1
"""Capsules of one module that may be written at once, and in each second: a loop of crashes is one crash."""
MOST_WAITING = 16
MOST_MESSAGE_BYTES = 16 << 20
"""A larger message that the module was handling is left out."""
END_S = 20.0
"""How long the end of a run waits for each capsule that is still to be written.

Its writer takes half a second of a processor, which is many seconds where 20 other processes run."""
STALL_S = 5.0
"""But not longer for one whose writer gets no further: the disk has stalled."""
POLL_S = 0.1
LIMIT_S = 60.0
"""A writer that takes longer is killed: the disk has stalled."""

Say = Callable[[str, Kind, str], None]


@dataclass
class Evidence:
    """What is needed of a dead module.

    Attributes:
        slot, incarnation: of the module.
        data: place of the message that it took last: slot, incarnation and segment of the publisher, offset,
            size.
    """

    slot: int
    incarnation: int
    data: tuple[int, int, int, int, int] | None = None


@dataclass
class _Order:
    module: str
    path: Path
    facts: bytes
    files: dict[str, BinaryIO] = field(default_factory=dict)

    def close(self) -> None:
        for file in self.files.values():
            file.close()


class Capsules:
    """Writes capsules, one at a time.

    Args:
        plan: the run.
        keep: how many of each module to keep.
        say: adds a remark about a module to the trace.
    """

    def __init__(self, plan: RunPlan, keep: int, say: Say):
        self._plan = plan
        self._keep = keep
        self._say = say
        self._waiting: deque[_Order] = deque()
        self._rates: dict[str, TokenBucket] = {}
        self._process: subprocess.Popen[bytes] | None = None
        self._order: _Order | None = None
        self._begun_s = 0.0

    @property
    def pids(self) -> set[int]:
        """The pid of the process that writes, if there is one."""
        return {self._process.pid} if self._process else set()

    def take(self, report: CrashReport, evidence: Evidence) -> None:
        """Open what is needed of a module that has just died, and have its capsule written."""
        if not self._keep:
            return
        rate = self._rates.setdefault(report.module, TokenBucket(PER_S, BURST))
        if len(self._waiting) >= MOST_WAITING or not rate.take(1):
            self._say(report.module, Kind.SYSTEM, "no capsule of this crash: too many in a short time")
            return
        order = self._prepare(report)
        try:
            self._open(order, evidence)
        except (OSError, SegmentMissing, ForeignMemory) as error:
            order.close()
            self._say(report.module, Kind.WARNING, f"no capsule of this crash: {error}")
            return
        self._waiting.append(order)
        self.turn()

    def _prepare(self, report: CrashReport) -> _Order:
        folder = Path(self._plan.output_directory) / LOG_FOLDER / CRASH_FOLDER
        path = folder / Path(report_name(report)).with_suffix(SUFFIX).name
        planned = next(one for one in self._plan.modules if one.name == report.module)
        facts = {
            "path": str(path),
            "keep": self._keep,
            "report": asdict(report),
            "class": planned.class_path,
            "workspace": self._plan.workspace,
            "types": self._plan.types,
        }
        return _Order(report.module, path, json.dumps(facts, default=str).encode())

    def _open(self, order: _Order, evidence: Evidence) -> None:
        run_id, own = self._plan.run_id, (evidence.slot, evidence.incarnation)
        wanted = {
            "out": names.outbound(run_id, *own),
            "core": names.core(run_id),
            "board": names.board(run_id),
            "history": names.history(run_id, *own),
        }
        with opened_folder(names.folder(run_id)) as folder:
            for what, name in wanted.items():
                with contextlib.suppress(FileNotFoundError):  # a module that died early has no history
                    order.files[what] = _opened(name.rpartition("/")[2], folder)
            if evidence.data is not None:
                slot, incarnation, segment, offset, size = evidence.data
                name = names.data(run_id, slot, incarnation, segment)
                if size <= MOST_MESSAGE_BYTES:
                    with contextlib.suppress(OSError):
                        order.files["message"] = _copied(name.rpartition("/")[2], folder, offset, size)
        order.files["facts"] = _in_memory(order.facts)

    def turn(self) -> None:
        """Begin the next capsule when the last one is done; called in every iteration of the loop."""
        if self._process is not None:
            if self._process.poll() is None:
                if time.monotonic() - self._begun_s > LIMIT_S:
                    self._process.kill()
                return
            self._end()
        if self._waiting:
            self._begin(self._waiting.popleft())

    def _begin(self, order: _Order) -> None:
        places = [f"{what}={file.fileno()}" for what, file in order.files.items()]
        try:
            self._process = subprocess.Popen(
                [*python_command(WRITER), *places],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                pass_fds=[file.fileno() for file in order.files.values()],
                start_new_session=True,  # Ctrl-C must not end it
            )
        except OSError as error:
            self._say(order.module, Kind.WARNING, f"no capsule of this crash: {error}")
        else:
            self._order, self._begun_s = order, time.monotonic()
        order.close()

    def _end(self) -> None:
        process, order = self._process, self._order
        assert process is not None and order is not None
        assert process.stderr is not None
        with process.stderr:
            os.set_blocking(process.stderr.fileno(), False)
            said = (process.stderr.read() or b"").decode(errors="replace").strip()
        self._process = self._order = None
        if process.returncode == 0:
            self._say(order.module, Kind.INFO, f"run this crash again: robbie replay {order.path}")
        else:
            why = said.rpartition("\n")[2] or f"its writer ended with {process.returncode}"
            self._say(order.module, Kind.WARNING, f"no capsule of this crash: {why}")

    def close(self) -> None:
        """Wait for what is being written, as long as the disk accepts data."""
        while self._process is not None:
            if not _ends(self._process):
                self._give_up()
                break
            self.turn()

    def _give_up(self) -> None:
        assert self._process is not None and self._order is not None
        self._process.kill()
        if self._process.stderr is not None:
            self._process.stderr.close()
        for order in (self._order, *self._waiting):
            order.close()
            self._say(
                order.module, Kind.WARNING, "no capsule of this crash: the run is over, the disk is slow"
            )


def _ends(process: "subprocess.Popen[bytes]") -> bool:
    """Wait for a process as long as it gets further; return whether it has ended."""
    begin_s = moved_s = time.monotonic()
    ran_ns = -1
    while (now_s := time.monotonic()) - begin_s < END_S and now_s - moved_s < STALL_S:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(POLL_S)
            return True
        if (ran := _ran_ns(process.pid)) != ran_ns:
            ran_ns, moved_s = ran, now_s
    return False


def _ran_ns(pid: int) -> int:
    """Return how long a process has been on a processor, or has waited for one."""
    try:
        ran_ns, waited_ns, _ = map(int, Path(f"/proc/{pid}/schedstat").read_bytes().split())
    except (OSError, ValueError):
        return 0
    return ran_ns + waited_ns


def _opened(name: str, folder: int) -> BinaryIO:
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    return os.fdopen(os.open(name, flags, dir_fd=folder), "rb", buffering=0)


def _copied(name: str, folder: int, offset: int, size: int) -> BinaryIO:
    """Copy a message out of its publisher's memory, which is reclaimed soon."""
    with _opened(name, folder) as file:
        return _in_memory(os.pread(file.fileno(), size, offset))


def _in_memory(data: bytes) -> BinaryIO:
    file = os.fdopen(os.memfd_create("robbie-capsule", os.MFD_CLOEXEC), "w+b", buffering=0)
    file.write(data)
    return file
