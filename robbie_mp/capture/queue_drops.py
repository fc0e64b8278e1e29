"""Messages that the core dropped because a recorder's queue was full, told by channel."""

from collections.abc import Callable, Iterable, Mapping

from robbie_mp.recording.format import ChannelKey
from robbie_mp.transport.tables import ChannelName


class QueueDrops:
    """Compares what has passed through each channel with what came.

    How many are missing altogether the core's books say exactly. Of which channels, the difference tells; but
    what still waits is in it too. So the share of a channel is exact once nothing waits any more, and near it
    before.

    Args:
        total: says how many messages the core has dropped altogether.
        passed: says how many messages have passed through each channel that is subscribed to.
        missed_before: what an earlier process of this recorder has accounted for.
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
        """Messages accounted for by now."""
        return self._missed

    def look(self, received: Mapping[ChannelName, int]) -> dict[ChannelName, int]:
        """Return how many messages have gone missing since the last call.

        Args:
            received: how many came since the beginning, of each channel.
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
    """Return the channel of a log to which missing messages belong: their sender is known if there is one."""
    senders = {key.sender for key in seen if key[:3] == name}
    return ChannelKey(*name, senders.pop() if len(senders) == 1 else "")


def share_out(total: int, weights: Mapping[ChannelName, int]) -> dict[ChannelName, int]:
    """Share a number out by weights, in whole numbers whose sum it is; nothing without any weight."""
    shares: dict[ChannelName, int] = {}
    left, weight_left = total, sum(weights.values())
    for name, weight in weights.items():
        if weight:
            shares[name] = round(left * weight / weight_left)
            left -= shares[name]
            weight_left -= weight
    return {name: share for name, share in shares.items() if share}
