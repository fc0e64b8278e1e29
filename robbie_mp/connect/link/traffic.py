"""The classes of traffic over a link, and what each promises."""

from enum import IntEnum
from typing import NamedTuple


class TrafficClass(IntEnum):
    """How messages of a channel cross the link. The lower the number, the earlier they go."""

    URGENT = 0
    """In order, repeated until acknowledged, before everything else: the emergency stop."""
    COMMAND = 1
    """At once or never: the newest only, and dropped when it is older than it may be."""
    STATE = 2
    """The newest only, at a limited rate. What the network loses is counted, and the newest sent again."""
    RELIABLE = 3
    """In order, and sent again after a break, from a store of limited size."""
    BULK = 4
    """Large messages: the newest of each channel, compressed, sent when nothing else waits."""


class Manners(NamedTuple):
    """How a class treats its messages."""

    is_resent: bool
    """Whether what is lost is sent again; then the receiver takes it in order, else what it gets."""
    keeps_only_newest: bool
    """Whether a message that waits is replaced by a newer one of its channel."""
    waits_for_room: bool
    """Whether it waits while as much of its class is under way as the network carries."""
    goes_as_datagrams: bool
    """Whether it goes past the stream in which the network repeats what it loses, while all else waits."""


MANNERS = {
    TrafficClass.URGENT: Manners(
        is_resent=True, keeps_only_newest=False, waits_for_room=False, goes_as_datagrams=True
    ),
    TrafficClass.COMMAND: Manners(
        is_resent=False, keeps_only_newest=True, waits_for_room=False, goes_as_datagrams=True
    ),
    TrafficClass.STATE: Manners(
        is_resent=False, keeps_only_newest=True, waits_for_room=True, goes_as_datagrams=True
    ),
    TrafficClass.RELIABLE: Manners(
        is_resent=True, keeps_only_newest=False, waits_for_room=True, goes_as_datagrams=False
    ),
    TrafficClass.BULK: Manners(
        is_resent=True, keeps_only_newest=True, waits_for_room=True, goes_as_datagrams=False
    ),
}

CLASSES = tuple(TrafficClass)
