"""Messages that the core dropped because a recorder's queue was full, told by channel."""

from collections.abc import Callable, Mapping

from robbie_mp.books import BookReader
from robbie_mp.transport.endpoint import ChannelName


class QueueDrops:
    """Compares what has passed through each channel with what came.

    How many are missing altogether the core's books say exactly. Of which channels, the difference tells; but
    what still waits is in it too. So the share of a channel is exact once nothing waits any more, and near it
    before.

    Args:
        books: of the recorder's subscriptions.
        is_subscribed: whether messages of a channel come here.
        missed_before: what an earlier process of this recorder has accounted for.
    """

    def __init__(self, books: BookReader, is_subscribed: Callable[[ChannelName], bool], missed_before: int):
        self._books = books
        self._is_subscribed = is_subscribed
        self._missed = missed_before
        self._passed_before = books.channels()
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
        new = self._books.missed() - self._missed
        if new <= 0:
            return {}
        gaps = {
            name: passed - self._passed_before.get(name, 0) - received.get(name, 0) - self._told.get(name, 0)
            for name, passed in self._books.channels().items()
            if self._is_subscribed(name)
        }
        shares = share_out(
            new, {name: gap for name, gap in gaps.items() if gap > 0} or dict.fromkeys(gaps, 1)
        )
        self._missed += sum(shares.values())
        for name, share in shares.items():
            self._told[name] = self._told.get(name, 0) + share
        return shares


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
