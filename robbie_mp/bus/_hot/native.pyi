"""What the module written in C offers; its sources lie beside this file.

What is declared here is listed in `Native` of `choice.py` as well.
"""

import weakref
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, MutableSequence
from typing import Any

from robbie_mp.bus.transport.records import Delivery, Outbound
from robbie_mp.bus.transport.ring import Record, RingPlace
from robbie_mp.bus.transport.words import Words

LAYOUT_VERSION: int
"""That of layout.py when the module was built."""
SOURCES: str
"""The checksum of the C sources when the module was built, see sources.py."""

class RingWriter:
    head: int
    def __init__(self, place: RingPlace) -> None: ...
    def room(self) -> int: ...
    def push(self, a: int, b: int, c: int, d: int, e: int, f: int, g: int, /) -> None: ...
    def close(self) -> None: ...
    def disown(self) -> None: ...

class RingReader:
    @property
    def tail(self) -> int: ...
    def __init__(self, place: RingPlace) -> None: ...
    def waiting(self) -> int: ...
    def peek(self) -> Record: ...
    def glance(self) -> int: ...
    def take(self) -> None: ...
    def next(self) -> Record | None: ...
    def close(self) -> None: ...
    def disown(self) -> None: ...

class NumberRingWriter:
    head: int
    def __init__(self, place: RingPlace) -> None: ...
    def push(self, number: int, /) -> None: ...
    def close(self) -> None: ...
    def disown(self) -> None: ...

class NumberRingReader:
    @property
    def tail(self) -> int: ...
    def __init__(self, place: RingPlace) -> None: ...
    def take_all(self) -> list[int]: ...
    def close(self) -> None: ...
    def disown(self) -> None: ...

class Wakeup:
    patience_ns: int
    @property
    def has_posts(self) -> bool: ...
    def __init__(self, posts: memoryview, asleep: Words | None = None, at: int = 0) -> None: ...
    def post(self) -> None: ...
    def wait(self, timeout_s: float | None, /) -> bool: ...
    def close(self) -> None: ...
    def disown(self) -> None: ...

class MessageCodec:
    """Creates, encodes and decodes the messages of one class.

    Args:
        message_type: the class.
        describe: called at the first use; returns the fields, as `tabulate` does.
        make: given the name of a function, returns the one in Python.
    """

    def __init__(
        self,
        message_type: type[Any],
        describe: Callable[[], tuple[Any, ...]],
        make: Callable[[str], Callable[..., Any]],
    ) -> None: ...
    def install(self, name: str, /) -> None:
        """Give the class `__new__`, `encoded_size`, `encode_into`, `decode` or `forget_arrays`."""
    def decode(self, buffer: Any, /) -> Any: ...
    def lay_out(self, fields: dict[str, object], python: Callable[..., Any], /) -> MessageLayout | None: ...

class MessageLayout:
    """A `Layout` of loans.py."""

    @property
    def size(self) -> int: ...
    @property
    def loaned(self) -> frozenset[str]: ...
    def write(self, buffer: memoryview, offset: int = 0) -> Any: ...

class Lock:
    def acquire(self) -> bool: ...
    def release(self) -> None: ...
    def __enter__(self) -> bool: ...
    def __exit__(self, *error: object) -> None: ...

class Endpoint:
    def __init__(
        self,
        outbound: RingWriter,
        inbound: RingReader,
        freed: NumberRingReader,
        in_words: Words,
        source: int,
        reserve: int,
        backlog: deque[tuple[Outbound, int, int, int]],
        lock: Lock,
        wake_core: Callable[[], None],
        delivery: type[Delivery],
    ) -> None: ...
    def publish(
        self, declaration: int, segment: int, offset: int, size: int, stamp_ns: int, block: int, /
    ) -> bool: ...
    def give_back(self, kind: int, reference: int, sequence: int, /) -> bool: ...
    def take(self) -> Delivery | None: ...
    def close(self) -> None: ...
    def disown(self) -> None: ...

class Block:
    number: int
    @property
    def segment(self) -> int: ...
    @property
    def offset(self) -> int: ...
    @property
    def capacity(self) -> int: ...
    @property
    def buffer(self) -> memoryview: ...
    def __init__(
        self, number: int, segment: int, offset: int, buffer: memoryview, capacity: int, words: Words
    ) -> None: ...

class KeptBlocks:
    room_bytes: int
    @property
    def taken(self) -> dict[int, Block]: ...
    @property
    def kept(self) -> dict[int, list[Block]]: ...
    @property
    def taken_bytes(self) -> int: ...
    def reuse(self, size: int, /) -> Block | None: ...
    def has_kept(self, size: int, /) -> bool: ...
    def keep(self, block: Block, /) -> None: ...
    def free(self, numbers: Iterable[int], /) -> None: ...
    def clear(self) -> None: ...

class Publisher:
    def __init__(
        self,
        endpoint: Endpoint,
        blocks: KeptBlocks,
        words: Words,
        declarations: dict[tuple[type[Any], str], int],
        held: dict[int, weakref.ref[Any]],
    ) -> None: ...
    def publish(self, message: object, topic: str, /) -> int | None: ...
    def publish_encoded(self, declaration: int, data: memoryview, /) -> int | None: ...
    def hand_over(self, declaration: int, block: Block, size: int, /) -> int | None: ...
    def outstanding(self) -> int | None: ...
    def record_into(self, history: History, /) -> None: ...
    def close(self) -> None: ...

class FreeRows(list[int]):
    """As much of a list as the ledger uses: a stack of row numbers, at first all of them.

    Args:
        count: rows of the table.
    """

    def __init__(self, count: int) -> None: ...

class References(OrderedDict[int, int]):
    """As much of an ordered dict as the core uses; made by `Books.references`."""

class Subscription:
    """Holds the attributes of a subscription of the core that C uses; likewise the next three classes."""

class Channel: ...
class Link: ...
class Slot: ...

class Books:
    """What the core knows besides its tables, and the hot path over both.

    Args:
        words: the core segment.
        handles_at: where its table of handles begins; likewise of references.
        references_at: where its table of references begins.
        subscriptions: rows of its table of subscriptions.
        free_handles: free rows of the table of handles.
        free_references: free rows of the table of references.
        holders: of each handle: how many references are left.
        message_bytes: size of the largest valid message.
    """

    def __init__(
        self,
        words: Words,
        handles_at: int,
        references_at: int,
        subscriptions: int,
        free_handles: FreeRows,
        free_references: FreeRows,
        holders: MutableSequence[int],
        message_bytes: int,
    ) -> None: ...
    def set_slots(self, slots: tuple[Any, ...], /) -> None:
        """Set the slots of the run, in order; once."""
    def enter(self, subscription: Any, /) -> None:
        """Enter a subscription under its row."""
    def references(self) -> References:
        """Make a collection of references; a reference is in at most one of them."""
    def outdate(self, slot: Any, /) -> None:
        """Note that the figures of a slot must be written again."""
    def note_post(self, link: Any, /) -> None:
        """Have a link be woken, for it has been sent records."""
    def post(self) -> None:
        """Wake the links that have been sent records."""
    def write_figures(self) -> None:
        """Write the figures that have changed."""
    def somebody_waits(self) -> bool:
        """Whether messages wait for a module."""
    def before_sleep(self) -> bool:
        """Ask modules to post on a release, or not to; return whether the rings must be looked at again."""
    is_wanting: bool
    """Whether some module may have been asked to post when it releases."""
    left: int | None
    """Records of the turn that follow the one that Python must handle; None: the ring is corrupt."""
    is_unfinished: bool
    """Whether any ring has more records than the last round handled."""

    def set_links(self, links: tuple[Any, ...], /) -> None:
        """Set the links that are connected; between rounds."""
    def serve_round(self, records_per_turn: int, is_special: object, /) -> Any:
        """Begin a round over the rings, or go on with it.

        Args:
            records_per_turn: most records of one module that are handled in its turn.
            is_special: see `serve`.

        Returns:
            A link of which Python must handle the next record; None: the round is over.
        """
    def work(
        self, post: Callable[[], None], records_per_turn: int, heartbeat_ns: int, is_special: object, /
    ) -> Any:
        """Wait for posts and handle what is common, again and again, until Python must do something.

        This returns after a signal, and at the latest some `heartbeat_ns` after the last post.

        Args:
            post: that of the core's own wake-up in C.
            records_per_turn: see `serve_round`.
            heartbeat_ns: longest wait; after this time it also returns between two rounds.
            is_special: see `serve`.

        Returns:
            A link as from `serve_round`, or None.
        """
    def serve(self, link: Any, records: int, is_special: object, /) -> int:
        """Handle the next records of a link, up to the first that is not common.

        Args:
            link: the module.
            records: how many there are.
            is_special: whether a dead publisher has live messages.

        Returns:
            How many were handled.
        """

class MappedSegment:
    def __init__(self, buffer: memoryview) -> None: ...

class Unreferenced:
    def __init__(self) -> None: ...
    def __len__(self) -> int: ...
    def append(self, reference: int, /) -> None: ...
    def popleft(self) -> int: ...
    def remove(self, reference: int, /) -> None: ...

class Pins:
    def __init__(self, words: Words) -> None: ...
    def __len__(self) -> int: ...
    def add(self, delivery: Delivery, kept: object, /) -> None: ...
    def remove(self, reference: int, /) -> Delivery: ...
    def have_room_for(self, delivery: Delivery, free_bytes: int, /) -> bool: ...
    def close(self) -> None: ...

class Subscriber:
    @property
    def current(self) -> Delivery | None: ...
    @property
    def source(self) -> int | None: ...
    def __init__(
        self,
        endpoint: Endpoint,
        words: Words,
        segments: dict[int, MappedSegment],
        subscriptions: dict[int, Any],
        unreferenced: Unreferenced,
        pins: Pins,
        robbie_error: type[Exception],
    ) -> None: ...
    def handle_next(self, inbox: Any, /) -> bool | None: ...
    def record_into(self, history: History, /) -> None: ...
    def close(self) -> None: ...

class History:
    def __init__(self, words: Words, ready_bytes: int = 0) -> None: ...
    def append(
        self, kind: int, time_ns: int = 0, a: int = 0, b: int = 0, c: int = 0, d: int = 0, data: Any = b"", /
    ) -> None: ...
    def prepare(self) -> None: ...
    def close(self) -> None: ...
    def disown(self) -> None: ...

class TickTimes:
    due_ns: int
    ticks: int
    missed: int
    def __init__(self) -> None: ...

class Loop:
    def __init__(
        self,
        runner: Any,
        subscriber: Subscriber,
        inbox: Any,
        outbox: Any,
        module: Any,
        calls: Any,
        ticks: Any,
        times: TickTimes,
        wake: Callable[[], object],
        max_wait_ns: int,
    ) -> None: ...
    def turn(self) -> bool:
        """Do the common form of a turn; return False, without a store, if Python must do it."""
