"""The board: state, process and start time of every module. The supervisor writes it, all others read it."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.layout import LINE_WORDS, NAME_WORDS
from robbie_mp.bus.transport.words import WORD_MAX, Words, read_text, write_text

TOOL_PREFIX = "~tool"
"""First characters of the names of rows for attached tools; a module's name cannot begin with them."""


@dataclass(frozen=True)
class Totals:
    """Totals over a module's earlier incarnations, whose segments are gone."""

    published: int = 0
    refused: int = 0
    handled: int = 0
    cpu_ns: int = 0
    checkpoints: int = 0
    """Saved; if there are any, the next incarnation must find one."""
    ill_formed: int = 0


@dataclass(frozen=True)
class SlotState:
    """One row of the board."""

    name: str
    state: int
    pid: int
    incarnation: int
    restarts: int
    started_ns: int
    reason: str
    past: Totals
    last_end: str = ""
    """How its last process ended; '' if none has."""
    last_end_ns: int = 0
    """When, monotonic clock."""


@dataclass(frozen=True)
class SlotBounds:
    """Limits of a module that the profile sets."""

    queue_messages: int = 0
    queue_bytes: int = 0
    memory_bytes: int = 0


class Board:
    """Reads and writes the words of the board."""

    def __init__(self, words: Words):
        self._words = words

    def create(self, names: list[str], bounds: Sequence[SlotBounds] = ()) -> None:
        """Write the names and limits of all rows: supervisor, modules, tools, core."""
        words = self._words
        for slot, name in enumerate(names):
            write_text(words, self._row(slot) + layout.SLOT_NAME, NAME_WORDS, name)
        for slot, bound in enumerate(bounds):
            at = self._row(slot)
            words[at + layout.SLOT_QUEUE_MESSAGES] = bound.queue_messages
            words[at + layout.SLOT_QUEUE_BYTES] = bound.queue_bytes
            words[at + layout.SLOT_MEMORY_BYTES] = bound.memory_bytes
        words[layout.BOARD_SLOTS] = len(names)

    def bounds(self, slot: int) -> SlotBounds:
        """Read a module's limits."""
        words, at = self._words, self._row(slot)
        return SlotBounds(
            words[at + layout.SLOT_QUEUE_MESSAGES],
            words[at + layout.SLOT_QUEUE_BYTES],
            words[at + layout.SLOT_MEMORY_BYTES],
        )

    @property
    def slots(self) -> int:
        """Number of rows."""
        return self._words[layout.BOARD_SLOTS]

    @property
    def may_go(self) -> bool:
        """Whether every module is ready, so that modules may start their work."""
        return self._words[layout.BOARD_GO] == 1

    def go(self) -> None:
        """Let all modules start their work."""
        self._words[layout.BOARD_GO_NS] = time.monotonic_ns()
        self._words[layout.BOARD_GO] = 1

    @property
    def went_ns(self) -> int:
        """When modules could start their work, monotonic clock; 0: they still wait for each other."""
        return self._words[layout.BOARD_GO_NS] if self.may_go else 0

    def modules(self) -> list[str]:
        """Return the names of all modules; their slots start at 1, and tools and the core follow them."""
        names = [self.name(slot) for slot in range(1, self.slots - 1)]
        return [name for name in names if not name.startswith(TOOL_PREFIX)]

    def name(self, slot: int) -> str:
        """Name of the module in a slot."""
        return read_text(self._words, self._row(slot) + layout.SLOT_NAME, NAME_WORDS)

    def incarnation(self, slot: int) -> int:
        """Incarnation of the newest process of the module in a slot."""
        return self._words[self._row(slot) + layout.SLOT_INCARNATION]

    def end_of(self, slot: int) -> tuple[int, int, int]:
        """Return when the last process of a module ended, its state, and its incarnation, at little cost."""
        words, at = self._words, self._row(slot)
        return (
            words[at + layout.SLOT_LAST_END_NS],
            words[at + layout.SLOT_STATE],
            words[at + layout.SLOT_INCARNATION],
        )

    def is_left_by_tool(self, slot: int) -> bool:
        """Whether a row is reserved for tools and no tool is attached there now."""
        return not self._words[self._row(slot) + layout.SLOT_PID] and self.name(slot).startswith(TOOL_PREFIX)

    def is_attached_as(self, slot: int, incarnation: int, pid: int) -> bool:
        """Whether a slot is still assigned to a tool; see `supervisor.attached_tools`."""
        words, at = self._words, self._row(slot)
        return (words[at + layout.SLOT_PID], words[at + layout.SLOT_INCARNATION]) == (pid, incarnation)

    def write(self, slot: int, row: SlotState) -> None:
        """Write a module's state; its name stays."""
        words, at = self._words, self._row(slot)
        words[at + layout.SLOT_STATE] = row.state
        words[at + layout.SLOT_PID] = row.pid
        words[at + layout.SLOT_INCARNATION] = row.incarnation
        words[at + layout.SLOT_RESTARTS] = row.restarts
        words[at + layout.SLOT_STARTED_NS] = row.started_ns
        write_text(words, at + layout.SLOT_REASON, LINE_WORDS, row.reason)
        # A module writes these counts, and a wild pointer in it must not end the supervisor.
        words[at + layout.SLOT_PAST_PUBLISHED] = min(row.past.published, WORD_MAX)
        words[at + layout.SLOT_PAST_REFUSED] = min(row.past.refused, WORD_MAX)
        words[at + layout.SLOT_PAST_HANDLED] = min(row.past.handled, WORD_MAX)
        words[at + layout.SLOT_PAST_CPU_NS] = row.past.cpu_ns
        words[at + layout.SLOT_PAST_CHECKPOINTS] = min(row.past.checkpoints, WORD_MAX)
        words[at + layout.SLOT_PAST_ILL_FORMED] = min(row.past.ill_formed, WORD_MAX)
        write_text(words, at + layout.SLOT_LAST_END, LINE_WORDS, row.last_end)
        words[at + layout.SLOT_LAST_END_NS] = row.last_end_ns

    def read(self, slot: int) -> SlotState:
        """Read a module's state."""
        words, at = self._words, self._row(slot)
        return SlotState(
            name=self.name(slot),
            state=words[at + layout.SLOT_STATE],
            pid=words[at + layout.SLOT_PID],
            incarnation=words[at + layout.SLOT_INCARNATION],
            restarts=words[at + layout.SLOT_RESTARTS],
            started_ns=words[at + layout.SLOT_STARTED_NS],
            reason=read_text(words, at + layout.SLOT_REASON, LINE_WORDS),
            past=Totals(
                words[at + layout.SLOT_PAST_PUBLISHED],
                words[at + layout.SLOT_PAST_REFUSED],
                words[at + layout.SLOT_PAST_HANDLED],
                words[at + layout.SLOT_PAST_CPU_NS],
                words[at + layout.SLOT_PAST_CHECKPOINTS],
                words[at + layout.SLOT_PAST_ILL_FORMED],
            ),
            last_end=read_text(words, at + layout.SLOT_LAST_END, LINE_WORDS),
            last_end_ns=words[at + layout.SLOT_LAST_END_NS],
        )

    def show_health(self, slot: int, line: str) -> None:
        """Write why a module's figures make it DEGRADED; '' if they do not."""
        write_text(self._words, self._row(slot) + layout.SLOT_HEALTH, LINE_WORDS, line)

    def health(self, slot: int) -> str:
        """Read why a module's figures make it DEGRADED."""
        return read_text(self._words, self._row(slot) + layout.SLOT_HEALTH, LINE_WORDS)

    @staticmethod
    def _row(slot: int) -> int:
        return layout.BOARD_ROWS + slot * layout.SLOT_WORDS
