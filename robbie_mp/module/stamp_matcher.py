"""Finds the messages of several topics that belong together by their stamps.

A *set* has one message of each topic, and its *span* is the time between its earliest and latest stamp. Sets
do not cross, and no message is in two sets. As long as no topic has more messages waiting than allowed, the
sets depend on the stamps alone, and not on how the messages of different topics interleave.

The next set is found in two steps. First, the oldest message of a topic is left over if it is more than the
tolerance before the oldest of another topic, until this holds for none. Now the oldest messages of all topics
form a set. The latest of them is the *pivot*. Second, the set with the smallest span is chosen among those
that contain the pivot; of equal ones, the earliest. Messages before it are left over. A set is delivered as
soon as no message that is still to come could make a better one.

The idea of the pivot is that of `ApproximateTime` in ROS's message_filters
(http://wiki.ros.org/message_filters/ApproximateTime). Unlike there, messages too old for the tolerance
neither wait nor delay others, a full queue does not discard a set that is complete, and everything left over
is counted.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

MAX_LATE_NS = 1_000_000_000
"""A stamp that is earlier than its predecessor by more than this means that the clock of the stamps was set
back, as by a jump of a log that is played or by a simulation that begins again."""


@dataclass
class MatchCounts:
    """Counts of the messages of one topic by their fate; `received` is the sum of all others."""

    received: int = 0
    matched: int = 0
    """Delivered in a set."""
    unmatched: int = 0
    """Left over: no partner within the tolerance, or others were nearer to the partners."""
    crowded_out: int = 0
    """Left over: the oldest of too many that waited for another topic."""
    late: int = 0
    """Left over: the stamp was earlier than that of the message before it on the same topic."""
    forgotten: int = 0
    """Left over: waited when the clock was set back."""
    waiting: int = 0

    @property
    def left_over(self) -> int:
        """Messages that were in no set and never will be."""
        return self.unmatched + self.crowded_out + self.late + self.forgotten


class StampMatcher:
    """Finds sets in the messages of several topics.

    Args:
        topics: number of topics.
        deliver: called with each set: one message of each topic.
        tolerance_ns: greatest span of a set; 0: all stamps are the same.
        max_waiting: most messages of a topic that wait; beyond it, the oldest is left over.
        min_periods_ns: for each topic, a time that its messages are always apart, at least; 0 if unknown.
            Sets are found earlier if it is known.

    Attributes:
        counts: what became of the messages of each topic.
        nearest_ns: the smallest span by which a message missed the tolerance since the last set; None: none.
    """

    def __init__(
        self,
        topics: int,
        deliver: Callable[..., object],
        tolerance_ns: int,
        max_waiting: int,
        min_periods_ns: Sequence[int],
    ):
        self._deliver = deliver
        self._tolerance_ns = tolerance_ns
        self._max_waiting = max_waiting
        self._min_periods_ns = min_periods_ns
        self._queues: list[deque[tuple[int, Any]]] = [deque() for _ in range(topics)]
        self._newest_ns: list[int | None] = [None] * topics
        """The stamp of the last message of each topic."""
        self._counts = [MatchCounts() for _ in range(topics)]
        self.nearest_ns: int | None = None

    @property
    def counts(self) -> list[MatchCounts]:
        """The counts of each topic so far."""
        for count, queue in zip(self._counts, self._queues, strict=True):
            count.waiting = len(queue)
        return self._counts

    def add(self, topic: int, stamp_ns: int, message: object) -> None:
        """Take a message, and deliver the sets that are now certain.

        Args:
            topic: number of the message's topic.
            stamp_ns: when it was measured.
            message: the message.
        """
        count, queue, newest_ns = self._counts[topic], self._queues[topic], self._newest_ns[topic]
        count.received += 1
        if newest_ns is not None and stamp_ns < newest_ns:
            if newest_ns - stamp_ns <= MAX_LATE_NS:
                count.late += 1
                return
            self.forget()
        if len(queue) >= self._max_waiting:
            self._make_room(topic)
        queue.append((stamp_ns, message))
        self._newest_ns[topic] = stamp_ns
        while self._deliver_next():
            pass

    def forget(self) -> None:
        """Leave over everything that waits; the next stamps may be earlier than the last ones."""
        for topic, queue in enumerate(self._queues):
            self._counts[topic].forgotten += len(queue)
            queue.clear()
            self._newest_ns[topic] = None
        self.nearest_ns = None

    def _make_room(self, topic: int) -> None:
        """Deliver the best set so far, though a better one might come; if there is none, leave one over."""
        if all(self._queues):
            self._take(self._best()[0])
        else:
            self._queues[topic].popleft()
            self._counts[topic].crowded_out += 1

    def _deliver_next(self) -> bool:
        """Deliver a set, if it is certain that it is the next one."""
        self._drop_hopeless()
        if not all(self._queues):
            return False
        places, is_certain = self._best()
        if is_certain:
            self._take(places)
        return is_certain

    def _drop_hopeless(self) -> None:
        """Leave over messages that are too early for another topic, whatever still comes."""
        while True:
            # All further messages of a topic have at least this stamp.
            earliest = [
                queue[0][0] if queue else newest_ns
                for queue, newest_ns in zip(self._queues, self._newest_ns, strict=True)
            ]
            latest_ns = max((stamp_ns for stamp_ns in earliest if stamp_ns is not None), default=0)
            hopeless = [
                topic
                for topic, queue in enumerate(self._queues)
                if queue and latest_ns - queue[0][0] > self._tolerance_ns
            ]
            if not hopeless:
                return
            for topic in hopeless:
                missed_by_ns = latest_ns - self._queues[topic].popleft()[0]
                self._counts[topic].unmatched += 1
                if self.nearest_ns is None or missed_by_ns < self.nearest_ns:
                    self.nearest_ns = missed_by_ns

    def _best(self) -> tuple[list[int], bool]:
        """Return the places in the queues of the best set so far, and whether no better one can come."""
        oldest_ns = [queue[0][0] for queue in self._queues]
        pivot_ns = max(oldest_ns)
        if min(oldest_ns) == pivot_ns:
            return [0] * len(oldest_ns), True
        stamps_ns = [[stamp_ns for stamp_ns, _ in queue] for queue in self._queues]
        best = self._narrowest(pivot_ns, stamps_ns)
        # A topic that has not reached the pivot may still send a message that is nearer to it.
        is_certain = True
        for stamps, min_period_ns in zip(stamps_ns, self._min_periods_ns, strict=True):
            if stamps[-1] < pivot_ns:
                stamps.append(max(pivot_ns, stamps[-1] + min_period_ns))
                is_certain = False
        return best, is_certain or self._narrowest(pivot_ns, stamps_ns) == best

    def _narrowest(self, pivot_ns: int, stamps_ns: Sequence[Sequence[int]]) -> list[int]:
        """Return the places of the set with the smallest span among those that contain the pivot.

        For each possible earliest stamp, the best set has the first message of each topic from there on.
        """
        best: list[int] = []
        smallest_ns: int | None = None
        for start_ns in sorted({stamp_ns for stamps in stamps_ns for stamp_ns in stamps}):
            if start_ns > pivot_ns:
                break
            places = [_first_from(start_ns, stamps) for stamps in stamps_ns]
            if any(place == len(stamps) for stamps, place in zip(stamps_ns, places, strict=True)):
                break
            chosen = [stamps[place] for stamps, place in zip(stamps_ns, places, strict=True)]
            span_ns = max(chosen) - min(chosen)
            if smallest_ns is None or span_ns < smallest_ns:
                best, smallest_ns = places, span_ns
        return best

    def _take(self, places: Sequence[int]) -> None:
        """Deliver a set, and leave over what is before it."""
        messages = []
        for queue, count, place in zip(self._queues, self._counts, places, strict=True):
            for _ in range(place):
                queue.popleft()
            count.unmatched += place
            count.matched += 1
            messages.append(queue.popleft()[1])
        self.nearest_ns = None
        self._deliver(*messages)


def _first_from(start_ns: int, stamps_ns: Sequence[int]) -> int:
    return next((place for place, stamp_ns in enumerate(stamps_ns) if stamp_ns >= start_ns), len(stamps_ns))
