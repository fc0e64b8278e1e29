"""The evidence of a crash: what a dead child left in shared memory, and how its process ended."""

import signal
import time
from collections.abc import Callable
from pathlib import Path

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.board import Board
from robbie_mp.bus.transport.layout import LINE_WORDS, RECORD_WORDS, Activity
from robbie_mp.bus.transport.records import Delivery
from robbie_mp.bus.transport.tables import CoreTables, DeclarationRow
from robbie_mp.bus.transport.words import Words, read_text
from robbie_mp.run.supervisor.incarnations import Incarnations
from robbie_mp.run.supervisor.output import ChildOutput
from robbie_mp.run.supervisor.process import ExitStatus
from robbie_mp.run.trace.crash import CrashReport, LastMessage, LastWords

COUNTERS = {
    "handled": layout.OUT_HANDLED,
    "published": layout.OUT_PUBLISHED,
    "refused": layout.OUT_REFUSED,
    "ticks": layout.OUT_TICKS,
    "ticks missed": layout.OUT_TICKS_MISSED,
    "pinned": layout.OUT_PINNED,
    "copied": layout.OUT_COPIED,
    "ill_formed": layout.OUT_ILL_FORMED,
    "bytes of data segments": layout.OUT_SEGMENT_BYTES,
}


class LastWordsReader:
    """Reads what dead modules left in shared memory. It trusts none of it.

    Args:
        tables: the core's tables, which hold the topics of messages. Only their words are kept.
        board: names the senders.
        inbound_records: capacity of each inbound ring.
    """

    def __init__(self, tables: CoreTables, board: Board, inbound_records: int):
        self._channel_rows = [tables.channel_row(index) for index in range(tables.sizes.channels)]
        self._board = board
        self._inbound_records = inbound_records

    def read(self, out: Words, into: Words) -> LastWords:
        """Return what one module left.

        Args:
            out: the words that the module wrote.
            into: its inbound ring.
        """
        now_ns = time.monotonic_ns()
        activity = describe_activity(out, out[layout.OUT_ACTIVITY])
        since_ns = out[layout.OUT_ACTIVITY_SINCE_NS]
        return LastWords(
            activity=activity,
            activity_s=max(0.0, (now_ns - since_ns) / 1e9) if activity else 0.0,
            message=self._last_message(out, into, now_ns),
            counters={name: out[at] for name, at in COUNTERS.items()},
            status=read_text(out, layout.OUT_STATUS, LINE_WORDS),
        )

    def _last_message(self, out: Words, into: Words, now_ns: int) -> LastMessage | None:
        """Find the last message taken: its record stays in the ring until it is overwritten."""
        if (delivery := self._last_delivery(out, into)) is None:
            return None
        slot = layout.unpack_source(delivery.source)[0]
        if delivery.channel >= len(self._channel_rows) or slot >= self._board.slots:
            return None
        return self._message(delivery.channel, delivery.sequence, slot, now_ns - delivery.stamp_ns)

    def last_place(self, out: Words, into: Words) -> tuple[int, int, int, int, int] | None:
        """Return where the message lies that the module was handling; None if it was handling none.

        Returns:
            Slot, incarnation and segment of its publisher, its offset and its size.
        """
        delivery = self._last_delivery(out, into)
        if delivery is None or out[layout.OUT_ACTIVITY] & 0xFF != Activity.HANDLER:
            return None
        slot, segment, incarnation = layout.unpack_source(delivery.source)
        return slot, incarnation, segment, delivery.offset, delivery.size

    def _last_delivery(self, out: Words, into: Words) -> Delivery | None:
        taken = out[layout.OUT_INBOUND_TAIL]
        for number in range(taken, max(0, taken - self._inbound_records), -1):
            at = layout.IN_RING + (number - 1) % self._inbound_records * RECORD_WORDS
            *record, its_number = (into[at + word] for word in range(8))
            if its_number != number:
                return None
            if (delivery := Delivery.unpack(tuple(record))) is not None:
                return delivery
        return None

    def _message(self, channel: int, sequence: int, slot: int, age_ns: int) -> LastMessage:
        name = self._channel_rows[channel].name
        return LastMessage(
            type_name=name.type_name,
            topic=name.topic,
            sequence=sequence,
            sender=self._board.name(slot),
            age_s=max(0.0, age_ns / 1e9),
        )


def describe_activity(out: Words, activity: int) -> str:
    """Describe a module's activity, such as "handler on_scan of TYPE on TOPIC"; '' if it is idle.

    Args:
        out: the words that the module wrote.
        activity: the value of `OUT_ACTIVITY`.
    """
    kind = activity & 0xFF
    if kind not in list(Activity) or kind == Activity.IDLE:
        return ""
    if kind != Activity.HANDLER:
        return Activity(kind).name.lower()
    number = (activity >> 8) % layout.DECLARATION_COUNT
    row = DeclarationRow.read(out, number)
    type_name, _, topic = row.name
    return f"handler {row.handler} of {type_name}" + (f" on {topic}" if topic else "")


VMSTAT = Path("/proc/vmstat")


class CrashWatch:
    """Collects the facts about one child's abnormal end and reports them."""

    def __init__(
        self, name: str, output: ChildOutput, incarnations: Incarnations, clock: Callable[[], float]
    ):
        """Prepare; nothing is watched yet.

        Args:
            name: the child's name.
            output: holds the child's last lines and receives the report.
            incarnations: reads what the child left in memory.
            clock: monotonic time in s.
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
        """Report the end. Call this after reading all output and before reclaiming the memory."""
        hints = []
        if status.signal == signal.SIGKILL and not was_killed_by_us:
            hints.append(self._killer_hint())
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
        self._incarnations.keep_evidence(self._output.report_crash(report))

    def _killer_hint(self) -> str:
        count = memory_kills() - self._memory_kills
        if count:
            return f"since its start the kernel has killed {count} processes for lack of memory: see dmesg"
        return "killed neither by the supervisor nor by the kernel for lack of memory"


def memory_kills(vmstat: Path = VMSTAT) -> int:
    """Return how many processes the kernel has killed for lack of memory; 0 if it does not report this."""
    try:
        lines = vmstat.read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("oom_kill ")), 0)
