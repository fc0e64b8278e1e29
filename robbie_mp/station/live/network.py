"""What the network to one page carries, and how all that is sent to the page shares it.

Commands count only if the page's pings are answered in time (driving/dead_man.py). So nothing that can wait
may make a queue in the network: pictures and packets start only while little else is under way to the page.
While pings are late all the same, everything else that can wait is sent more rarely.
"""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import NamedTuple

JAM_S = 0.4
"""A picture that took this long discards all earlier estimates."""
LEAST_BYTES = 1500
"""A smaller picture counts as this many bytes: the browser delays it, not the network."""
MOST_GROWTH = 4
"""A network lets a few bytes pass at once, so small pictures do not say what far larger ones cost."""
ESTIMATES = 8
"""Number of pictures of which the cheapest gives the cost of a byte: the others waited for the browser."""
UNDER_WAY_S = 0.1
"""Time that the network may need for all pictures and packets that are under way to a page."""
STUCK_S = 1.0
"""A page that reports nothing for this time does not keep the others of its followers from sending."""
LATE_S = 0.12
"""A ping that is later than the fastest one by this has waited for more than one picture."""
PAIR_BYTES, GAPS_S = 2000, 10.0
"""How large something must be, and how new, to tell what a byte costs by what came before it."""
FEWER, MORE, LEAST_SHARE = 0.8, 1.02, 0.25
"""Factors by which a late ping, and one in time, change the share; and the least one."""
MAX_DRIFT = 1e-3
"""Greatest difference between the rates of the clocks of robot and page, s/s."""


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
    _sizes: deque[int] = field(default_factory=lambda: deque(maxlen=ESTIMATES))

    def add(self, size: int, way_s: float, *, is_full: bool = True) -> None:
        """Add a picture.

        Args:
            size: in bytes.
            way_s: time that it was on its way beyond the shortest time.
            is_full: whether it is about as large as it might be. One that is not, as of a scene that stands
                still, says nothing about larger ones, so it does not lower the cost.
        """
        if way_s > JAM_S:
            self._s_per_byte.clear()
        self._sizes.append(size)
        size = max(LEAST_BYTES, size)
        known = None if is_full else self.of(1.0)
        self._s_per_byte.append(max(way_s / size, self.shortest_way_s / size if known is None else known))

    def of(self, size: float) -> float | None:
        """Return what a picture of some size costs, s; None: nothing is known yet."""
        if not self._s_per_byte:
            return None
        return size * max(self.least_s_per_byte, min(self._s_per_byte))

    def is_far_from_known(self, size: int) -> bool:
        """Return whether a picture is so much larger than the last ones that its cost cannot be told."""
        return bool(self._sizes) and size > max(LEAST_BYTES, *self._sizes) * MOST_GROWTH


class UnderWay(NamedTuple):
    """A picture or packet that was sent."""

    size: int
    """In bytes."""
    cost_s: float
    sent_s: float
    """By the robot's monotonic clock."""


class PageNetwork:
    """The network to one page. Used in the page server's thread.

    A picture that finds the network empty says little of it: some frames pass at once. One that was sent
    while another was under way comes as much later as its bytes need (Jacobson, *Congestion avoidance and
    control*, SIGCOMM 1988, the spacing of packets by the slowest link).

    Attributes:
        share: of its usual rate at which everything is sent that can wait, except for pictures.
        costs: what each follower has learned of it.
    """

    def __init__(self) -> None:
        self.share = 1.0
        self.costs: list[NetworkCost] = []
        self._fastest_s, self._fastest_at_s = math.inf, 0.0
        self._under_way_s = 0.0
        self._count = 0
        self._changed_s = self._came_s = -math.inf
        self._gaps: deque[tuple[float, float]] = deque(maxlen=ESTIMATES)
        """When something was sent, and what each of its bytes cost."""

    def ping_came(self, sent_s: float, page_s: float) -> None:
        """Take when a ping was sent, by the robot's clock, and when it came, by the page's.

        The difference of the clocks is not known, but it is part of all of these times.
        """
        way_s = page_s - sent_s
        passed_s = max(0.0, sent_s - self._fastest_at_s)
        self._fastest_s = min(way_s, self._fastest_s + MAX_DRIFT * passed_s)
        self._fastest_at_s = sent_s
        if way_s - self._fastest_s > LATE_S:
            self.share = max(LEAST_SHARE, FEWER * self.share)
        else:
            self.share = min(1.0, MORE * self.share)

    def cost_s(self, size: float) -> float:
        """Return what a number of bytes costs it at most, s; 0 while nothing is known."""
        return max((cost.of(size) or 0.0 for cost in self.costs), default=0.0)

    def has_room(self, cost_s: float) -> bool:
        """Return whether a picture or packet that costs the network this time may be sent now."""
        is_free = not self._count or self._under_way_s + cost_s <= UNDER_WAY_S
        return is_free or time.monotonic() - self._changed_s > STUCK_S

    def send(self, size: int) -> UnderWay:
        """Note that a picture or packet is sent; tell `came` when it has come, or is lost."""
        sent = UnderWay(size, self.cost_s(size), time.monotonic())
        self._count += 1
        self._under_way_s += sent.cost_s
        self._changed_s = sent.sent_s
        return sent

    def came(self, sent: UnderWay, way_s: float | None = None) -> None:
        """Note that a picture or packet has come, or is lost with its connection.

        Args:
            sent: as `send` has returned it.
            way_s: time that it was on its way beyond the shortest time; None: not known.
        """
        self._count -= 1
        self._under_way_s = self._under_way_s - sent.cost_s if self._count else 0.0
        self._changed_s = time.monotonic()
        if way_s is not None:
            self._learn(sent, way_s)

    def _learn(self, sent: UnderWay, way_s: float) -> None:
        """Learn from one that was sent while the one before was in the network: it came right after that."""
        came_s = sent.sent_s + way_s
        gap_s = came_s - self._came_s
        if sent.sent_s < self._came_s and gap_s > 0.0 and sent.size >= PAIR_BYTES:
            self._gaps.append((sent.sent_s, gap_s / sent.size))
        self._came_s = max(self._came_s, came_s)
        known = [cost for at_s, cost in self._gaps if at_s > sent.sent_s - GAPS_S]
        floor = median(known) if len(known) > 1 else 0.0
        for cost in self.costs:
            cost.least_s_per_byte = floor
