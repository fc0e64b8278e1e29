"""Publishers and subscribers, read from the modules' own words; this costs the robot nothing."""

from dataclasses import dataclass

from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.board import Board
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.records import ANY_VERSION, Outbound
from robbie_mp.bus.transport.segment import Segment, SegmentMismatch, SegmentMissing
from robbie_mp.bus.transport.tables import ChannelName, DeclarationRow


@dataclass(frozen=True)
class ObservedDeclaration:
    """A module's declaration that it publishes messages of a type on a topic, or subscribes to them."""

    module: str
    is_publisher: bool
    type_name: str
    version: int
    topic: str
    """For a subscription: '' for all topics."""

    @property
    def name(self) -> ChannelName:
        """The channel that is published or subscribed to."""
        return ChannelName(self.type_name, self.version, self.topic)

    @property
    def is_by_patterns(self) -> bool:
        """Whether type and topic are patterns of a subscription."""
        return not self.is_publisher and self.version == ANY_VERSION


def read_declarations(run_id: str) -> list[ObservedDeclaration]:
    """Return the declarations of all live modules of a run so far, in start order.

    Raises:
        SegmentMissing: the run does not exist.
    """
    segment = Segment.attach(names.board(run_id), SegmentKind.BOARD)
    board = Board(segment.words)
    rows = [
        (slot, board.read(slot)) for slot in range(board.slots - 1)
    ]  # the core is last and declares nothing
    found = [
        entry
        for slot, row in rows
        if row.pid
        for entry in _declarations_of(run_id, slot, row.incarnation, row.name)
    ]
    segment.close()
    return found


def _declarations_of(run_id: str, slot: int, incarnation: int, module: str) -> list[ObservedDeclaration]:
    try:
        segment = Segment.attach(names.outbound(run_id, slot, incarnation), SegmentKind.OUT)
    except (SegmentMissing, SegmentMismatch):  # it ended, or destroyed its segment itself
        return []
    found = [
        ObservedDeclaration(module, row.kind == Outbound.ADVERTISE, *row.name)
        for row in DeclarationRow.read_all(segment.words)
    ]
    segment.close()
    return found
