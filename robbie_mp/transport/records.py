"""What the records of the rings mean.

Outbound, from a module to the core (seven words each):

    ADVERTISE    declaration                                      a channel, described in the out segment
    SUBSCRIBE    declaration                                      likewise a subscription
    READY                                                         setup is over, messages may come
    PUBLISH      declaration, source, offset, bytes, stamp_ns, block
    DONE         reference, sequence                              handled, but an array of it is still held
    RELEASE      reference, sequence                              handled (if not DONE before) and let go
    WAIT_FREED   blocks                                           wake me when so many of mine were ever freed
    MAKE_ROOM    messages, bytes, before_ns                       drop my oldest that only wait, down to these

and, from the supervisor only:

    MODULE_UP    slot, incarnation
    MODULE_DOWN  slot, incarnation, whether it ended cleanly
    MODULE_GONE  slot                                             it will not come back

Inbound, from the core to a module: the first word is kind | declaration << 8 | channel << 32.

    DELIVER      reference, sequence, source, offset, bytes, stamp_ns
    SEGMENTS_GONE  slot, incarnation                            nothing refers to its data segments any more

and, to the supervisor only:

    RECLAIMED    slot, incarnation                                the next incarnation may start
    FAULTED      slot, incarnation, what                          it broke the protocol
"""

from enum import IntEnum


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


ANY_VERSION = 0
"""Version of a subscription whose type and topic are shell patterns: it takes messages of any version."""


class MessageHandling(IntEnum):
    """What a subscription wants when messages come faster than it handles them."""

    ALWAYS_DELIVER = 1
    """All of them in order, up to the module's queue limits."""
    KEEP_ONLY_NEWEST = 2
    """The newest at the moment the module is ready for it; older ones are replaced, and counted."""
