"""Pairs what a module and its shadow publish, and compares each pair by the rules of `robbie diff`.

Messages of a channel are paired if both have the same stamp in their header, or the same content. What has no
such counterpart after `WAIT_S` is paired with what the other published next, in order; or it is only in one.
"""

from collections import Counter, deque
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.recording.comparison import Difference, first_difference, without_stamps
from robbie_mp.logs.recording.decoding import logged_type
from robbie_mp.logs.recording.errors import NotDecodable
from robbie_mp.logs.recording.reader import LogChannel, LoggedMessage
from robbie_mp.logs.shadow.amount import MOST_FIELDS, Amount, amounts
from robbie_mp.messages import Header, Message
from robbie_mp.messages.errors import MessageError

WAIT_S = 1.0
"""So long a message waits for its counterpart."""
WAIT_NS = round(WAIT_S * 1e9)
MOST_WAITING = 512
MOST_WAITING_BYTES = 32 << 20
"""How much of one channel waits for each side; beyond either limit, the oldest waits no longer."""


class Side(IntEnum):
    """Who has published a message."""

    MODULE = 0
    SHADOW = 1


@dataclass
class ChannelResult:
    """How a channel differs between the module and its shadow.

    Attributes:
        name: the channel.
        equal: pairs that are the same, apart from stamps in headers.
        different: pairs that are not.
        only: messages without a counterpart, of each side.
        left_out: messages at the begin and the end, for which the other side was not there yet, or any more.
        first: the first pair that differs.
        amounts: how much numbers differ, by field.
    """

    name: ChannelName
    equal: int = 0
    different: int = 0
    only: list[int] = field(default_factory=lambda: [0, 0])
    left_out: int = 0
    first: Difference | None = None
    amounts: dict[str, Amount] = field(default_factory=dict)

    @property
    def is_unseen(self) -> bool:
        """Whether there were only messages at the begin and the end, so that nothing is known."""
        return self.left_out > 0 and not (self.equal or self.different or any(self.only))

    @property
    def is_equal(self) -> bool:
        """Whether both have published the same, as far as it could be compared."""
        return not (self.different or any(self.only) or self.is_unseen)


@dataclass(frozen=True)
class _Waiting:
    key: object
    logged: LoggedMessage
    plain: bytes


class ChannelPairing:
    """Pairs the messages of one channel.

    Args:
        channel: the channel, with its schema.
        begin_ns: when the shadow began.
    """

    def __init__(self, channel: LogChannel, begin_ns: int):
        self._channel = channel
        self._begin_ns = begin_ns
        self._plain = without_stamps(channel)
        self._type = _type_of(channel)
        self._waiting: tuple[deque[_Waiting], deque[_Waiting]] = (deque(), deque())
        self._keys: tuple[Counter[object], Counter[object]] = (Counter(), Counter())
        self._bytes = [0, 0]
        self._pairs = 0
        self.result = ChannelResult(ChannelName(channel.type_name, channel.version, channel.topic))

    def add(self, side: Side, time_ns: int, data: bytes) -> None:
        """Add what one of them has published."""
        plain = self._plain(data)
        one = _Waiting(self._key(data, plain), LoggedMessage(self._channel, 0, time_ns, data), plain)
        other = self._other(side)
        if self._keys[other][one.key]:
            self._settle_before(side, one.key)
            self._compare(side, one, self._take(other))
            return
        self._waiting[side].append(one)
        self._keys[side][one.key] += 1
        self._bytes[side] += len(data)
        while len(self._waiting[side]) > MOST_WAITING or (
            self._bytes[side] > MOST_WAITING_BYTES and len(self._waiting[side]) > 1
        ):
            self._settle_oldest(side)

    def expire(self, before_ns: int) -> None:
        """Settle the messages that were published before a time: they have waited long enough."""
        while (side := self._oldest()) is not None and self._time(side) < before_ns:
            self._settle_oldest(side)

    def end(self, last_ns: int) -> None:
        """Settle all: nothing comes any more. What was published in the last `WAIT_S` may be alone.

        Args:
            last_ns: when the last message was given to the shadow.
        """
        while (side := self._oldest()) is not None:
            if not self._waiting[self._other(side)] and self._time(side) >= last_ns - WAIT_NS:
                self._take(side)
                self.result.left_out += 1
            else:
                self._settle_oldest(side)

    @staticmethod
    def _other(side: Side) -> Side:
        return Side(1 - side)

    def _time(self, side: Side) -> int:
        return self._waiting[side][0].logged.time_ns

    def _oldest(self) -> Side | None:
        """Return the side whose first waiting message is the older one; None if none waits."""
        sides = [side for side in Side if self._waiting[side]]
        return min(sides, key=self._time, default=None)

    def _key(self, data: bytes, plain: bytes) -> object:
        if self._type is not None:
            try:
                header = getattr(self._type.decode(data), "header", None)
            except MessageError:
                return plain
            if isinstance(header, Message) and type(header).type_name == Header.type_name:
                stamp: Any = header
                if stamp.stamp.sec or stamp.stamp.nanosec:
                    return stamp.stamp.sec, stamp.stamp.nanosec
        return plain

    def _take(self, side: Side) -> _Waiting:
        one = self._waiting[side].popleft()
        self._keys[side][one.key] -= 1
        if not self._keys[side][one.key]:
            del self._keys[side][one.key]
        self._bytes[side] -= len(one.logged.data)
        return one

    def _settle_before(self, side: Side, key: object) -> None:
        """Settle what waits on both sides before the message of the other side that has this key."""
        other = self._other(side)
        while self._waiting[other][0].key != key:
            self._settle_oldest(other)
        while self._waiting[side]:
            self._alone(side, self._take(side))

    def _settle_oldest(self, side: Side) -> None:
        """Pair the oldest message of a side with that of the other if both are near in time."""
        one, other = self._take(side), self._other(side)
        is_near = self._waiting[other] and abs(self._time(other) - one.logged.time_ns) <= WAIT_NS // 2
        if is_near and self._waiting[other][0].key not in self._keys[side]:
            self._compare(side, one, self._take(other))
        else:
            self._alone(side, one)

    def _alone(self, side: Side, one: _Waiting) -> None:
        if not self._pairs and one.logged.time_ns < self._begin_ns + WAIT_NS:
            self.result.left_out += 1
        else:
            self.result.only[side] += 1

    def _compare(self, side: Side, one: _Waiting, counterpart: _Waiting) -> None:
        pair = (one, counterpart) if side is Side.MODULE else (counterpart, one)
        self._pairs += 1
        result = self.result
        if pair[0].plain == pair[1].plain:
            result.equal += 1
            return
        result.different += 1
        a, b = pair[0].logged, pair[1].logged
        if result.first is None:
            result.first = first_difference(a, b, self._pairs - 1, ignore_stamps=True)
        if self._type is None:
            return
        try:
            found = list(amounts(self._type.decode(a.data), self._type.decode(b.data)))
        except MessageError:
            return
        for name, difference in found:
            if name in result.amounts or len(result.amounts) < MOST_FIELDS:
                result.amounts.setdefault(name, Amount()).add(difference)


def _type_of(channel: LogChannel) -> type[Message] | None:
    try:
        return logged_type(channel)
    except (MessageError, NotDecodable):
        return None
