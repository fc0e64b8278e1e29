"""Counts a module's messages that are not handled yet, kept messages excluded."""

import numpy as np
from numpy.typing import NDArray

from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.board import Board
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.tables import CoreTables, Outcome
from robbie_mp.bus.transport.words import new_fence

_SLOT_BITS = 0xFFFF
STATE_BITS = 0xFF


def rows_at(core: Segment, at: int, rows: int, row_words: int) -> NDArray[np.uint64]:
    """Return one of the core's tables, `(rows, row_words)`; the core may change it while you read.

    Args:
        core: the core segment.
        at: its first word.
        rows: number of rows.
        row_words: words of a row.
    """
    words = np.frombuffer(core.buffer, np.uint64)
    return words[at : at + rows * row_words].reshape(rows, row_words)


class UnhandledMessages:
    """Counts the messages of one module that wait for a handler or are in one.

    It only maps the core's tables read-only, and so costs other processes nothing. A handled message does not
    count, even if a subscriber keeps it, nor does one that the core keeps for later subscribers.

    Args:
        run_id: the run.
        module: the name of the module, which must be running.

    Raises:
        SegmentMissing: the run does not exist, or the module does not run.
        ValueError: the run has no such module.
    """

    def __init__(self, run_id: str, module: str):
        board = Segment.attach(names.board(run_id), SegmentKind.BOARD)
        rows = Board(board.words)
        self._slot = rows.modules().index(module) + 1
        incarnation = rows.incarnation(self._slot)
        board.close()
        self._core = Segment.attach(names.core(run_id), SegmentKind.CORE)
        self._tables = CoreTables.attach(self._core.words)
        self._out = Segment.attach(names.outbound(run_id, self._slot, incarnation), SegmentKind.OUT)
        self._in = Segment.attach(names.inbound(run_id, self._slot, incarnation), SegmentKind.IN)
        self._fence = new_fence()

    def count(self) -> int:
        """Return the number of unhandled messages, including those that the core has not read yet."""
        unseen = self._out.words[layout.OUT_HEAD] - self._in.words[layout.IN_OUTBOUND_TAIL]
        self._fence()  # after the fence, the tables show everything the core has seen
        sizes = self._tables.sizes
        references = self._table(self._tables.reference(0), sizes.references, layout.REFERENCE_WORDS)
        handles = self._table(self._tables.handle(0), sizes.handles, layout.HANDLE_WORDS)
        is_held = (references[:, layout.REFERENCE_STATE] & STATE_BITS) == Outcome.HELD
        is_latch = self._is_latch()[references[:, layout.REFERENCE_SUBSCRIPTION] % sizes.subscriptions]
        held = np.unique(references[is_held & ~is_latch, layout.REFERENCE_HANDLE])
        sources = handles[held[held < sizes.handles], layout.HANDLE_SOURCE]
        return unseen + int(np.count_nonzero((sources & _SLOT_BITS) == self._slot))

    def _is_latch(self) -> NDArray[np.bool_]:
        """Whether each subscription, `(rows,)`, is the core's own, which keeps a message for later."""
        sizes = self._tables.sizes
        rows = self._table(self._tables.subscription(0), sizes.subscriptions, layout.SUBSCRIPTION_WORDS)
        is_latch: NDArray[np.bool_] = rows[:, layout.SUBSCRIPTION_SLOT] == sizes.slots - 1
        return is_latch

    def _table(self, at: int, rows: int, row_words: int) -> NDArray[np.uint64]:
        """One of the core's tables, `(rows, row_words)`; the core may change it while you read."""
        return rows_at(self._core, at, rows, row_words)

    def close(self) -> None:
        """Unmap the core's tables."""
        for segment in (self._core, self._out, self._in):
            segment.close()
