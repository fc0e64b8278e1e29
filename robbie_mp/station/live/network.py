"""What the network to one page carries, and how pictures and packets share it.

Commands count only if the page's pings are answered in time (driving/dead_man.py). So nothing that can wait
may make a queue in the network: pictures and packets start only while little else is under way to the page.
While pings are late all the same, everything else that can wait is sent more rarely.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from weakref import WeakSet

JAM_S = 0.4
"""A picture that took this long discards all earlier estimates."""
LEAST_BYTES = 1500
"""A smaller picture counts as this many bytes: the browser delays it, not the network."""
UNKNOWN_S_PER_BYTE = 8e-6
"""What a byte costs while nothing is known: 1 Mbit/s."""
OLD_S = 2.0
"""What one part of the page learned this long before another is not believed beside that."""
ESTIMATES = 8
"""Number of pictures of which the cheapest gives the cost of a byte: the others waited for the browser."""
UNDER_WAY_S = 0.1
"""Time that the network may need for all pictures and packets that are under way to a page."""
STUCK_S = 1.0
"""What has not come after this time is not waited for: a part of the page that is stuck stops no other."""
LATE_S = 0.12
"""A ping that takes longer than the fastest one by this has waited for more than one picture."""
GAPS_S = 10.0
"""How new something must be to tell what a byte costs by what came before it."""
FEWER, MORE, LEAST_SHARE = 0.8, 1.02, 0.25
"""Factors by which a late ping, and one in time, change the share; and the least one."""
FORGET = 1e-3
"""The fastest ping counts as this much slower for each second since then: the way may have become longer."""


@dataclass(eq=False)
class NetworkCost:
    """What pictures or packets cost the network, by what the page says.

    Args:
        shortest_way_s: a shorter way says no more than this.
    """

    shortest_way_s: float = 0.0
    least_s_per_byte: float = 0.0
    """What a byte costs at least."""
    _s_per_byte: deque[float] = field(default_factory=lambda: deque(maxlen=ESTIMATES))
    added_s: float = -math.inf
    """When the newest picture was added."""

    def add(self, size: int, way_s: float, *, is_full: bool = True) -> None:
        """Add a picture.

        Args:
            size: in bytes.
            way_s: time that it was on its way beyond the shortest time.
            is_full: whether it is about as large as it might be. One that is not, as of a scene that stands
                still, says nothing about larger ones, so it does not lower the cost.
        """
        self.added_s = time.monotonic()
        if way_s > JAM_S:
            self._s_per_byte.clear()
        size = max(LEAST_BYTES, size)
        known = None if is_full else self.of(1.0)
        self._s_per_byte.append(max(way_s / size, self.shortest_way_s / size if known is None else known))

    def of(self, size: float) -> float | None:
        """Return what a picture of some size costs, s; None: nothing is known yet."""
        if not self._s_per_byte:
            return None
        return size * max(self.least_s_per_byte, min(self._s_per_byte))


@dataclass(eq=False)
class Transfer:
    """A picture or packet that is sent."""

    size: int
    """In bytes."""
    cost_s: float
    sent_s: float
    """By the robot's monotonic clock."""


class PageNetwork:
    """The network to one page. Used in the page server's thread.

    Each stream asks for a turn before it sends, and gets it in the order of asking. So no stream of the page
    starves another.

    A picture that finds the network empty says little of it: some frames pass at once. One that was sent
    while another was under way comes as much later as its bytes need (Jacobson, *Congestion avoidance and
    control*, SIGCOMM 1988, the spacing of packets by the slowest link).

    Attributes:
        share: of its usual rate at which everything is sent that can wait, except for pictures.
        costs: what each follower has learned of it.
    """

    def __init__(self) -> None:
        self.share = 1.0
        self.costs: WeakSet[NetworkCost] = WeakSet()
        self._fastest_s = self._fastest_at_s = math.inf
        self._under_way: list[Transfer] = []
        self._turn, self._changed = asyncio.Lock(), asyncio.Event()
        self._came_s = -math.inf
        self._gaps: deque[tuple[float, float]] = deque(maxlen=ESTIMATES)
        """When something was sent, and what each of its bytes cost."""

    def ping_came(self, trip_s: float, now_s: float) -> None:
        """Take the quickest round trip of the last pings: one that had to wait is no slow network.

        No clock of the page is in it, which might jump.
        """
        forgotten_s = FORGET * max(0.0, now_s - self._fastest_at_s)
        self._fastest_s, self._fastest_at_s = min(trip_s, self._fastest_s + forgotten_s), now_s
        if trip_s - self._fastest_s > LATE_S:
            self.share = max(LEAST_SHARE, FEWER * self.share)
        else:
            self.share = min(1.0, MORE * self.share)

    def cost_s(self, size: float) -> float:
        """Return what a number of bytes costs it at most, s."""
        new_s = max((cost.added_s for cost in self.costs), default=0.0) - OLD_S
        known = [cost.of(size) for cost in self.costs if cost.added_s >= new_s]
        return max((one for one in known if one is not None), default=UNKNOWN_S_PER_BYTE * size)

    async def turn(self, size: float) -> Transfer:
        """Wait until a picture or packet of about this size (bytes) may be sent.

        It counts as under way at once. Tell `went` when it goes, and `came` when it has come, or does not go.
        """
        async with self._turn:
            while (wait_s := self._wait_s(self.cost_s(size))) > 0.0:
                self._changed.clear()
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._changed.wait(), wait_s)
        sent = Transfer(round(size), self.cost_s(size), time.monotonic())
        self._under_way.append(sent)
        return sent

    def _wait_s(self, cost_s: float) -> float:
        """Return how long to wait for room for something, if nothing comes until then."""
        now_s = time.monotonic()
        self._under_way = [one for one in self._under_way if one.sent_s > now_s - STUCK_S]
        if not self._under_way or cost_s + sum(one.cost_s for one in self._under_way) <= UNDER_WAY_S:
            return 0.0
        return min(one.sent_s for one in self._under_way) + STUCK_S - now_s

    def went(self, sent: Transfer, size: int) -> Transfer:
        """Note how large (bytes) a picture or packet has become that is sent now."""
        sent.size, sent.cost_s, sent.sent_s = size, self.cost_s(size), time.monotonic()
        if sent not in self._under_way:  # it took as long as if it were stuck
            self._under_way.append(sent)
        return sent

    def came(self, sent: Transfer, way_s: float | None = None) -> None:
        """Note that a picture or packet has come, or is lost with its connection.

        Args:
            sent: as `turn` has returned it.
            way_s: time that it was on its way beyond the shortest time; None: not known.
        """
        with suppress(ValueError):  # one that was stuck
            self._under_way.remove(sent)
        self._changed.set()
        if way_s is not None:
            self._learn(sent, min(way_s, GAPS_S))

    def _learn(self, sent: Transfer, way_s: float) -> None:
        """Learn from one that was sent while the one before was in the network: it came right after that."""
        came_s = sent.sent_s + way_s
        gap_s = came_s - self._came_s
        if sent.sent_s < self._came_s and gap_s > 0.0:
            self._gaps.append((sent.sent_s, gap_s / max(LEAST_BYTES, sent.size)))
        self._came_s = max(self._came_s, came_s)
        known = [cost for at_s, cost in self._gaps if at_s > sent.sent_s - GAPS_S]
        floor = min(known) if len(known) > 1 else 0.0  # the others waited for something else, too
        for cost in self.costs:
            cost.least_s_per_byte = floor
