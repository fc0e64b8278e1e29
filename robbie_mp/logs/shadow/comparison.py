"""Compares all that a module and its shadow publish, channel by channel."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from robbie_mp.bus.transport.histogram import Distribution
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.recording.reader import LogChannel
from robbie_mp.logs.shadow.pairing import WAIT_NS, ChannelPairing, ChannelResult, Side

MOST_CHANNELS = 1000
"""Of further channels, messages are only counted."""


class Comparison:
    """Compares as messages come.

    Args:
        begin_ns: when the shadow began.
        schema_of: returns the ros2msg text of a type and version; None if it is not known.
    """

    def __init__(self, begin_ns: int, schema_of: Callable[[str, int], str | None]):
        self._begin_ns = begin_ns
        self._schema_of = schema_of
        self._channels: dict[ChannelName, ChannelPairing] = {}
        self.beyond = 0

    def add(self, side: Side, name: ChannelName, time_ns: int, data: bytes) -> None:
        """Add what the module or the shadow has published.

        Args:
            side: which of them.
            name: the channel.
            time_ns: when, by the clock of the module.
            data: the encoded message.
        """
        if (pairing := self._channels.get(name)) is None:
            if len(self._channels) >= MOST_CHANNELS:
                self.beyond += 1
                return
            schema = self._schema_of(name.type_name, name.version)
            channel = LogChannel(0, name.type_name, name.version, name.topic, "", schema)
            pairing = self._channels[name] = ChannelPairing(channel, self._begin_ns)
        pairing.add(side, time_ns, data)

    def expire(self, now_ns: int) -> None:
        """Let nothing wait longer than `WAIT_S`.

        Args:
            now_ns: up to here, both have published all that they will.
        """
        for pairing in self._channels.values():
            pairing.expire(now_ns - WAIT_NS)

    def end(self, last_ns: int) -> list[ChannelResult]:
        """Return what was found; see `ChannelPairing.end`."""
        for pairing in self._channels.values():
            pairing.end(last_ns)
        return [pairing.result for pairing in self._channels.values()]


@dataclass(frozen=True)
class ShadowReport:
    """What has become of a shadow.

    Attributes:
        channels: how its publications differ from the module's.
        handled: messages that it has handled.
        lost: messages that it did not get: its queue was full, or the run dropped them for this tool.
        replaced: messages that a newer one replaced, where only the newest is wanted.
        unhandled: messages that it had not handled at the end.
        calls: calls that it made, which nobody answered.
        module_times: times of the module for one message; None: they are not known.
        shadow_times: those of the shadow.
        end: how the shadow ended before its time; '' if it did not.
        from_checkpoint: whether it began with a checkpoint of the module.
    """

    channels: list[ChannelResult]
    handled: int
    lost: int
    replaced: int
    unhandled: int
    calls: int
    module_times: Distribution | None
    shadow_times: Distribution
    end: str
    from_checkpoint: bool

    @property
    def is_equal(self) -> bool:
        """Whether the shadow has lived, has handled something, and has published the same as the module."""
        return bool(self.handled) and not self.end and all(channel.is_equal for channel in self.channels)

    def as_data(self) -> dict[str, Any]:
        """Return it as plain data, for JSON."""
        data = {name: value for name, value in vars(self).items() if name != "channels"}
        for name in ("module_times", "shadow_times"):
            data[name] = data[name] and asdict(data[name])
        return {"equal": self.is_equal, **data, "channels": [_channel_data(one) for one in self.channels]}


def _channel_data(one: ChannelResult) -> dict[str, Any]:
    return {
        "topic": one.name.topic,
        "type": one.name.type_name,
        "equal": one.equal,
        "different": one.different,
        "only_in_module": one.only[Side.MODULE],
        "only_in_shadow": one.only[Side.SHADOW],
        "left_out": one.left_out,
        "first_difference": one.first and asdict(one.first),
        "amounts": {
            name: {"messages": amount.messages, "mean": amount.mean, "largest": amount.largest}
            for name, amount in one.amounts.items()
        },
    }


def distribution_of(times_ns: "np.typing.ArrayLike") -> Distribution:
    """Return the statistics of times in ns."""
    times = np.asarray(times_ns, np.float64) / 1e9
    if not times.size:
        return Distribution()
    p50_s, p99_s = np.percentile(times, [50, 99])
    return Distribution(times.size, float(times.mean()), float(p50_s), float(p99_s), float(times.max()))
