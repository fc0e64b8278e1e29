"""What a dead module has left in shared memory, read before it is reclaimed. None of it is trusted."""

import time

from robbie_mp.trace.crash import LastMessage, LastWords
from robbie_mp.transport import layout
from robbie_mp.transport.board import Board
from robbie_mp.transport.layout import LINE_WORDS, NAME_WORDS, RECORD_WORDS, Activity
from robbie_mp.transport.records import Inbound
from robbie_mp.transport.tables import CoreTables
from robbie_mp.transport.words import Words, read_text

COUNTERS = {
    "handled": layout.OUT_HANDLED,
    "published": layout.OUT_PUBLISHED,
    "refused": layout.OUT_REFUSED,
    "ticks": layout.OUT_TICKS,
    "ticks missed": layout.OUT_TICKS_MISSED,
    "pinned": layout.OUT_PINNED,
    "copied": layout.OUT_COPIED,
    "bytes of data segments": layout.OUT_SEGMENT_BYTES,
}


class LastWordsReader:
    """Reads what modules have left.

    Args:
        tables: of the core, for the topics of messages; not kept, for it holds the core's lists of free rows.
        board: for the names of their senders.
        inbound_records: capacity of each inbound ring.
    """

    def __init__(self, tables: CoreTables, board: Board, inbound_records: int):
        self._core_words = tables.words
        self._channel_rows = [tables.channel(index) for index in range(tables.sizes.channels)]
        self._board = board
        self._inbound_records = inbound_records

    def read(self, out: Words, into: Words) -> LastWords:
        """Return what one module has left.

        Args:
            out: the words that it wrote.
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
        """Find the last message that was taken: its record stays in the ring until others take its place."""
        taken = out[layout.OUT_INBOUND_TAIL]
        for number in range(taken, max(0, taken - self._inbound_records), -1):
            at = layout.IN_RING + (number - 1) % self._inbound_records * RECORD_WORDS
            first, _, sequence, source, _, _, stamp_ns, its_number = (into[at + word] for word in range(8))
            channel, slot = first >> 32, layout.unpack_source(source)[0]
            is_sound = channel < len(self._channel_rows) and slot < self._board.slots
            if its_number != number or not is_sound:
                return None
            if first & 0xFF == Inbound.DELIVER:
                return self._message(channel, sequence, slot, now_ns - stamp_ns)
        return None

    def _message(self, channel: int, sequence: int, slot: int, age_ns: int) -> LastMessage:
        at = self._channel_rows[channel]
        return LastMessage(
            type_name=read_text(self._core_words, at + layout.CHANNEL_TYPE, NAME_WORDS),
            topic=read_text(self._core_words, at + layout.CHANNEL_TOPIC, NAME_WORDS),
            sequence=sequence,
            sender=self._board.name(slot),
            age_s=max(0.0, age_ns / 1e9),
        )


def describe_activity(out: Words, activity: int) -> str:
    """Put what a module is doing into words, as "handler on_scan of TYPE on TOPIC"; '' if nothing.

    Args:
        out: the words that it wrote.
        activity: as in `OUT_ACTIVITY`.
    """
    kind = activity & 0xFF
    if kind not in list(Activity) or kind == Activity.IDLE:
        return ""
    if kind != Activity.HANDLER:
        return Activity(kind).name.lower()
    number = (activity >> 8) % layout.DECLARATION_COUNT
    at = layout.OUT_DECLARATIONS + number * layout.DECLARATION_WORDS
    type_name = read_text(out, at + layout.DECLARATION_TYPE, NAME_WORDS)
    topic = read_text(out, at + layout.DECLARATION_TOPIC, NAME_WORDS)
    handler = read_text(out, at + layout.DECLARATION_HANDLER, NAME_WORDS)
    return f"handler {handler} of {type_name}" + (f" on {topic}" if topic else "")
