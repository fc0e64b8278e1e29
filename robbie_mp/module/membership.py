"""What the process of a module, or of a tool, maps of its run."""

from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.board import Board
from robbie_mp.bus.transport.channels import ChannelNames
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.run_memory import IncarnationMemory, RingSizes, attach_core_wakeup, make_endpoint
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.module.calls.peers import RunPeers
from robbie_mp.module.wiring import UNCHANGED, Wiring


class Membership:
    """The memory of one process, the tables of the core, and the board.

    Args:
        run_id: the run.
        slot, incarnation: of this process.
        sizes: of its rings.
        native: what is written in C; None: Python does it.
        wiring: the names that the profile gives to its topics.

    Attributes:
        memory: its own memory.
        words: its out segment.
        core: the core segment.
        endpoint: its connection to the core.
        board: the board.
        channel_name: returns type, version and topic of a channel's messages.
        peers: the modules of the run.

    Raises:
        SegmentMissing: the run has ended.
    """

    def __init__(
        self,
        run_id: str,
        slot: int,
        incarnation: int,
        sizes: RingSizes,
        native: Native | None,
        wiring: Wiring = UNCHANGED,
    ):
        self.native = native
        self.memory = IncarnationMemory.attach_as_module(run_id, slot, incarnation, native)
        self.words = self.memory.out.words
        self._core_segment = Segment.attach(names.core(run_id), SegmentKind.CORE)
        self.core = self._core_segment.words
        self._core_wakeup = attach_core_wakeup(run_id, self._core_segment, native)
        self.wake_core = self._core_wakeup.post
        self.endpoint = make_endpoint(self.memory, slot, incarnation, sizes, self.wake_core, native)
        self._board_segment = Segment.attach(names.board(run_id), SegmentKind.BOARD)
        self.board = Board(self._board_segment.words)
        self.channel_name = ChannelNames(self.core)
        self.peers = RunPeers(run_id, slot, incarnation, self.core, self.board, wiring)

    def close(self) -> None:
        """Let go of the memory."""
        self.endpoint.close()
        self.memory.close()
        self._core_wakeup.close()
        self._board_segment.close()
        self._core_segment.close()
