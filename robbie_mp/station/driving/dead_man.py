"""The dead man's switch: a command counts only if it is surely fresh when it arrives.

Page and server exchange numbered pings on the socket of the commands. They bound how far the page's clock is
ahead, however slow and unequal the two directions are, and so the greatest age that a command can have.
"""

import math
from collections import deque

from robbie_mp.connect.link.clock_offset import ClockOffset, Exchange

LIMIT_S = 0.2
"""Greatest age of a command that counts. With a round trip above it, the page does not drive."""
PING_PERIOD_S = 0.25
WINDOW_S = 1.5
"""The delay is that of the quickest ping of this time: one that had to wait is no slow network."""
ORDER_LIMIT_S = 2.0
"""Greatest age of an order that lets the robot move, such as Go on: much may have happened since."""
MAX_WAITING = 64
MAX_PAGE_S = 1e9
NS = 1_000_000_000


class DeadManSwitch:
    """Knows the greatest age of what comes from one page, and whether its network is too slow to drive.

    All times of the robot are those of its monotonic clock.

    Attributes:
        losses: how often the network became too slow. A drive from before does not go on.
        is_too_slow: whether it was at the last `look`.
    """

    def __init__(self) -> None:
        self._page_clock = ClockOffset()
        self._number = 0
        self._pinged_s = -math.inf
        self._waiting: deque[tuple[int, float]] = deque(maxlen=MAX_WAITING)
        """Number and departure of each ping without an answer."""
        self._trips: deque[tuple[float, float]] = deque(maxlen=MAX_WAITING)
        """Return and round trip of each ping, in s."""
        self._stood_still_until = 0
        """Number of the newest ping before this process, or the connection, stood still; 0: never."""
        self._answered = 0
        self.losses = 0
        self.is_too_slow = False

    def ping(self, now_s: float) -> int:
        """Return the number of a ping that is sent to the page now."""
        if self._stands_still(now_s):
            self._stood_still_until = self._number
        self._number, self._pinged_s = self._number + 1, now_s
        self._waiting.append((self._number, now_s))
        return self._number

    def _stands_still(self, now_s: float) -> bool:
        """Return whether no ping has been sent for long."""
        return self._number > 0 and now_s - self._pinged_s > ORDER_LIMIT_S

    def is_prompt(self, now_s: float) -> bool:
        """Return whether an order that arrives now is surely not older than `ORDER_LIMIT_S`.

        It may have waited for a slow network, or for this process, which may have been stopped.
        """
        has_answered = self._answered > self._stood_still_until or not self._stood_still_until
        return has_answered and not self._stands_still(now_s) and self.delay_s(now_s) <= ORDER_LIMIT_S

    def pong(self, number: int, page_s: float, now_s: float) -> bool:
        """Take the page's answer to a ping; False: it was not asked for, and is ignored.

        Args:
            number: of the ping.
            page_s: when the page got the ping, and answered it, on its monotonic clock.
            now_s: the present time.
        """
        sent = next((one for one in self._waiting if one[0] == number), None)
        if sent is None or not abs(page_s) <= MAX_PAGE_S:
            return False
        self._waiting.remove(sent)
        self._answered = max(self._answered, number)
        page_ns = round(page_s * NS)
        self._page_clock.add(Exchange(round(sent[1] * NS), page_ns, page_ns, round(now_s * NS)))
        self._trips.append((now_s, now_s - sent[1]))
        return True

    def age_s(self, sent_s: float, now_s: float) -> float:
        """Return the greatest age that a command can have; infinite before the first answer to a ping.

        Args:
            sent_s: when the page sent it, on the page's monotonic clock.
            now_s: the present time.
        """
        if not abs(sent_s) <= MAX_PAGE_S:
            return math.inf
        ages = self._page_clock.age_ns(round(sent_s * NS), round(now_s * NS))
        return math.inf if ages is None else ages[1] / NS

    def trip_s(self, now_s: float) -> float | None:
        """Return the round trip now; None while it is not known, as when no ping could be sent."""
        recent = (trip_s for returned_s, trip_s in self._trips if now_s - returned_s <= WINDOW_S)
        return min(recent, default=None)

    def delay_s(self, now_s: float) -> float:
        """Return the round trip now, or how long the first ping without an answer has waited."""
        if (trip_s := self.trip_s(now_s)) is not None:
            return trip_s
        return now_s - self._waiting[0][1] if self._waiting else 0.0

    def look(self, now_s: float) -> None:
        """Look whether the network is too slow. Call it several times a second."""
        was_too_slow, self.is_too_slow = self.is_too_slow, self.delay_s(now_s) > LIMIT_S
        self.losses += self.is_too_slow and not was_too_slow
