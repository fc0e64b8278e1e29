"""Counts, by channel, the messages that the core dropped because a recorder's queue was full."""

from collections.abc import Callable, Iterable, Mapping

from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.recording.format import ChannelKey


class QueueDrops:
    """Compares the messages routed through each channel with those that the recorder received.

    The core's counters give the total number of missing messages exactly. The difference shows which channels
    they belong to, but it also includes messages that still wait. So the share of a channel is exact once no
    message waits, and approximate before that.

    Args:
        total: returns how many messages the core has dropped in total.
        passed: returns how many messages have passed through each channel that is subscribed to.
        missed_before: messages that an earlier process of this recorder has accounted for.
    """

    def __init__(
        self,
        total: Callable[[], int],
        passed: Callable[[], Mapping[ChannelName, int]],
        missed_before: int = 0,
    ):
        self._total = total
        self._passed = passed
        self._missed = missed_before
        self._passed_before = passed()
        self._told: dict[ChannelName, int] = {}

    @property
    def missed(self) -> int:
        """Messages accounted for so far."""
        return self._missed

    def look(self, received: Mapping[ChannelName, int]) -> dict[ChannelName, int]:
        """Return how many messages are missing since the last call, by channel.

        Args:
            received: how many messages of each channel the recorder has received since the beginning.
        """
        new = self._total() - self._missed
        if new <= 0:
            return {}
        gaps = {
            name: passed - self._passed_before.get(name, 0) - received.get(name, 0) - self._told.get(name, 0)
            for name, passed in self._passed().items()
        }
        shares = share_out(
            new, {name: gap for name, gap in gaps.items() if gap > 0} or dict.fromkeys(gaps, 1)
        )
        self._missed += sum(shares.values())
        for name, share in shares.items():
            self._told[name] = self._told.get(name, 0) + share
        return shares


def key_of_missing(name: ChannelName, seen: Iterable[ChannelKey]) -> ChannelKey:
    """Return the log's channel to which missing messages belong; it names the sender if there is only one."""
    senders = {key.sender for key in seen if key[:3] == name}
    return ChannelKey(*name, senders.pop() if len(senders) == 1 else "")


def share_out(total: int, weights: Mapping[ChannelName, int]) -> dict[ChannelName, int]:
    """Divide a total in proportion to weights, in whole numbers that add up to it; {} without any weight."""
    shares: dict[ChannelName, int] = {}
    left, weight_left = total, sum(weights.values())
    for name, weight in weights.items():
        if weight:
            shares[name] = round(left * weight / weight_left)
            left -= shares[name]
            weight_left -= weight
    return {name: share for name, share in shares.items() if share}
