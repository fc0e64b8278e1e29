"""The shared memory of a run: which process creates, maps and writes which segment."""

from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass

from typing_extensions import Self

from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.blocks import BlockStore
from robbie_mp.bus.transport.endpoint import Endpoint, EndpointMemory
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.views import SegmentViews
from robbie_mp.bus.transport.wakeup import Wakeup


@dataclass(frozen=True)
class RingSizes:
    """Capacities of the rings, equal for every module of a run."""

    records: int
    credit: int


class IncarnationMemory:
    """The shared memory of one incarnation of a module, as the supervisor, the core or the module maps it.

    The argument `native` of its methods is what is written in C; None: Python does it.
    """

    def __init__(self, out: Segment, into: Segment, wakeup: Wakeup):
        self.out = out
        self.into = into
        self.wakeup = wakeup

    @classmethod
    def create(
        cls, run_id: str, slot: int, incarnation: int, sizes: RingSizes, native: Native | None = None
    ) -> Self:
        """Create it; only the supervisor does this.

        Raises:
            SharedMemoryFull: there is no room.
        """
        with ExitStack() as on_failure:

            def segment(name: str, words: int, kind: SegmentKind) -> Segment:
                made = Segment.create(name, words, kind, slot, incarnation)
                on_failure.callback(made.unlink)
                on_failure.callback(made.close)
                return made

            out_name = names.outbound(run_id, slot, incarnation)
            in_name = names.inbound(run_id, slot, incarnation)
            out = segment(out_name, layout.out_words(sizes.records), SegmentKind.OUT)
            into = segment(in_name, layout.in_words(sizes.credit), SegmentKind.IN)
            name = names.wakeup(run_id, slot, incarnation)
            wakeup = Wakeup.create(name, native, out.words, layout.OUT_ASLEEP)
            on_failure.pop_all()
        return cls(out, into, wakeup)

    @classmethod
    def attach_as_module(cls, run_id: str, slot: int, incarnation: int, native: Native | None = None) -> Self:
        """Map it for the module, which writes `out` and reads `in`."""
        return cls._attach(run_id, slot, incarnation, SegmentKind.OUT, native)

    @classmethod
    def attach_as_core(cls, run_id: str, slot: int, incarnation: int, native: Native | None = None) -> Self:
        """Map it for the core, which writes `in` and reads `out`."""
        return cls._attach(run_id, slot, incarnation, SegmentKind.IN, native)

    @classmethod
    def _attach(
        cls, run_id: str, slot: int, incarnation: int, written: SegmentKind, native: Native | None
    ) -> Self:
        with ExitStack() as on_failure:

            def segment(name: str, kind: SegmentKind) -> Segment:
                return on_failure.enter_context(closing(Segment.attach(name, kind, write=kind is written)))

            out = segment(names.outbound(run_id, slot, incarnation), SegmentKind.OUT)
            into = segment(names.inbound(run_id, slot, incarnation), SegmentKind.IN)
            name = names.wakeup(run_id, slot, incarnation)
            wakeup = Wakeup.attach(name, native, out.words, layout.OUT_ASLEEP)
            memory = cls(out, into, wakeup)
            on_failure.pop_all()
        return memory

    def close(self) -> None:
        """Unmap it in this process."""
        self.wakeup.close()
        self.out.close()
        self.into.close()

    def unlink(self) -> None:
        """Remove the names of the segments, but not of the data segments."""
        self.out.unlink()
        self.into.unlink()
        self.wakeup.unlink()


def attach_core_wakeup(run_id: str, core: Segment, native: Native | None = None) -> Wakeup:
    """Open what wakes the core.

    Args:
        run_id: the run.
        core: the core's segment.
        native: what is written in C; None: Python does it.

    Raises:
        SegmentMissing: the run is over.
        ForeignMemory: other users have access to it.
    """
    return Wakeup.attach(names.core_wakeup(run_id), native, core.words, layout.CORE_ASLEEP)


def make_endpoint(
    memory: IncarnationMemory,
    slot: int,
    incarnation: int,
    sizes: RingSizes,
    wake_core: Callable[[], None],
    native: Native | None = None,
) -> Endpoint:
    """Connect a module's memory with the core; `native` is what is written in C, None: Python does it."""
    words = EndpointMemory(slot, incarnation, memory.out.words, memory.into.words, wake_core)
    return Endpoint(words, sizes.records, sizes.credit, native)


def make_block_store(
    run_id: str,
    slot: int,
    incarnation: int,
    segment_bytes: int,
    limit_bytes: int,
    native: Native | None = None,
) -> BlockStore:
    """Make the memory for a module's messages; the first message creates the first segment.

    The argument `native` is what is written in C; None: Python does it.
    """

    def create(number: int, words: int) -> Segment:
        name = names.data(run_id, slot, incarnation, number)
        return Segment.create(name, words, SegmentKind.DATA, slot, incarnation)

    return BlockStore(create, segment_bytes, limit_bytes, native)


def make_views(run_id: str, native: Native | None = None) -> SegmentViews:
    """Make the map of other modules' messages; `native` is what is written in C, None: Python does it."""

    def attach(slot: int, incarnation: int, number: int) -> Segment:
        return Segment.attach(names.data(run_id, slot, incarnation, number), SegmentKind.DATA)

    return SegmentViews(attach, native)
