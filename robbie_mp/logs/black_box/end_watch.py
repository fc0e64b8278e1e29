"""Sees on the board that processes have ended as they should not, also while the black box was dead."""

from collections.abc import Iterator, Sequence

from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.board import TOOL_PREFIX, Board
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.run.supervisor.states import STATES, ChildState

FAILED = STATES.index(ChildState.FAILED) + 1
IN_ORDER = ("exit code 0", "exit code 0: the run is over", "killed by SIGTERM")
"""Ends of texts about processes that ended as they should, or in an ordered stop."""


class EndWatch:
    """Compares the board with what has been seen.

    Args:
        run_id: the run.
        rows: names of the board's rows.
        seen: for each module, the end of a process and the incarnation in FAILED that are known; updated.
    """

    def __init__(self, run_id: str, rows: Sequence[str], seen: dict[str, tuple[int, int]]):
        self._segment = Segment.attach(names.board(run_id), SegmentKind.BOARD)
        self._board = Board(self._segment.words)
        self._modules = {
            slot: name for slot, name in enumerate(rows) if slot and not name.startswith(TOOL_PREFIX)
        }
        self._seen = seen

    def look(self) -> Iterator[tuple[str, int]]:
        """Yield each crash and hang since the last look, and when it was on the machine's monotonic clock.

        If a module has crashed several times since, only the last one is described.
        """
        for slot, name in self._modules.items():
            ended_ns, state, incarnation = self._board.end_of(slot)
            before = self._seen.get(name, (0, 0))
            now = ended_ns, incarnation if state == FAILED else 0
            if now == before:
                continue
            self._seen[name] = now
            row = self._board.read(slot)
            if now[1] not in (0, before[1]):
                yield f"{name} is FAILED: {row.reason}", ended_ns
            elif ended_ns != before[0] and not row.last_end.endswith(IN_ORDER):
                yield f"{name} ended: {row.last_end}", ended_ns

    def close(self) -> None:
        """Unmap the board."""
        self._segment.close()
