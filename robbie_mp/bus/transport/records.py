"""The records of the rings: their kinds, and the words of each.

Outbound, from a module to the core (kind, then up to six words):

    ADVERTISE    declaration                                      a channel, described in the out segment
    SUBSCRIBE    declaration                                      likewise a subscription
    READY                                                         setup is over, messages may be sent
    PUBLISH      declaration, source, offset, bytes, stamp_ns, block
    DONE         reference, sequence                              handled, but its memory is still in use
    RELEASE      reference, sequence                              handled, and its memory is not in use
    WAIT_FREED   blocks                                           wake me when this total of blocks is freed
    MAKE_ROOM    messages, bytes, before_ns, latched_bytes        drop my oldest waiting ones, down to these

and, from the supervisor only:

    MODULE_UP    slot, incarnation
    MODULE_DOWN  slot, incarnation, whether its restart was ordered
    MODULE_GONE  slot                                             it will not come back

Inbound, from the core to a module; the first word of DELIVER is kind | declaration << 8 | channel << 32:

    DELIVER      reference, sequence, source, offset, bytes, stamp_ns
    SEGMENTS_GONE  slot, incarnation                            nothing refers to its data segments any more

and, to the supervisor only:

    RECLAIMED    slot, incarnation                                the next incarnation may start
    FAULTED      slot, incarnation, what                          it broke the protocol
"""

from enum import IntEnum
from typing import NamedTuple

from typing_extensions import Self


class Outbound(IntEnum):
    """Kinds of records that the core receives."""

    ADVERTISE = 1
    SUBSCRIBE = 2
    READY = 3
    PUBLISH = 4
    DONE = 5
    RELEASE = 6
    WAIT_FREED = 7
    MODULE_UP = 8
    MODULE_DOWN = 9
    MODULE_GONE = 10
    MAKE_ROOM = 11


class Inbound(IntEnum):
    """Kinds of records that a module receives."""

    DELIVER = 1
    SEGMENTS_GONE = 2
    RECLAIMED = 3
    FAULTED = 4


KIND_MASK = 0xFF
DECLARATION_SHIFT, DECLARATION_MASK = 8, 0xFFFFFF
CHANNEL_SHIFT = 32
"""Parts of the first word of a delivery. Core and endpoint use them in place: a call would cost too much."""


class Delivery(NamedTuple):
    """A handle that the core delivered."""

    declaration: int
    """The module's number for the subscription."""
    channel: int
    reference: int
    sequence: int
    source: int
    offset: int
    size: int
    stamp_ns: int

    @classmethod
    def unpack(cls, record: tuple[int, ...]) -> Self | None:
        """Read an inbound record; None if it is of another kind."""
        first, *rest = record[:7]
        if first & KIND_MASK != Inbound.DELIVER:
            return None
        return cls(first >> DECLARATION_SHIFT & DECLARATION_MASK, first >> CHANNEL_SHIFT, *rest)


class Notice(NamedTuple):
    """Any other inbound record."""

    kind: Inbound
    slot: int
    incarnation: int


ANY_VERSION = 0
"""Version of a subscription whose type and topic are shell patterns: it takes messages of any version."""


class MessageHandling(IntEnum):
    """The rule for messages that come faster than a subscription handles them."""

    ALWAYS_DELIVER = 1
    """Deliver all of them in order, up to the limits of the module's queue."""
    KEEP_ONLY_NEWEST = 2
    """Deliver the newest when the module is ready for it; older ones are replaced, and counted."""
