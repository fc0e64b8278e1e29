"""Which nodes of ROS 2 the bridge deals with: those whose full names match one of its patterns.

The middleware knows endpoints. Which node an endpoint belongs to, the node says itself, a little before or
after its first message. So what comes from an endpoint of which nothing was said yet waits for a moment.
"""

import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Final, NamedTuple

EVERY: Final = "*"
MAX_KNOWN: Final = 16_384
"""Most endpoints of nodes that match."""
MAX_OTHERS: Final = 1024
"""Most endpoints of other nodes whose names are remembered, for the trace; the oldest goes first."""
MAX_WAITING: Final = 64
"""Most messages and requests that wait until their node is known."""
MAX_OF_ONE: Final = 16
"""Most of them from one participant."""
ALL_SENDERS: Final = 4
"""All that waits has at most this many times the bytes that a participant may have there."""
PREFIX_BYTES: Final = 12
"""An endpoint of DDS is known by its participant and its number there; one of Zenoh only by itself."""
NAME_WAIT_S: Final = 2.0
"""How long they wait."""
LATCHED_WAIT_S: Final = 60.0
"""How long a latched message waits. It comes only once, and on a busy machine names come late."""
NAMELESS: Final = "a node that does not tell its name"


class _Waiting(NamedTuple):
    """What came from an endpoint whose node is not known yet."""

    sender: bytes
    what: str
    size: int
    deliver: Callable[[], None]
    until_s: float

    @property
    def owner(self) -> bytes:
        """The participant of the endpoint."""
        return self.sender[:PREFIX_BYTES]


class Admission:
    """Decides which nodes the bridge deals with; all of it may be called in any thread.

    Args:
        patterns: shell patterns of full names, as `/slam/*`.
        max_bytes: most bytes of one participant that wait until their node is known.

    Attributes:
        is_open: whether all nodes match.
        refused: messages and endpoints of other nodes.
        unnamed: descriptions of them, for the module to name in its log; the oldest go first.
        version: changes when further endpoints match.
    """

    def __init__(self, patterns: Sequence[str], max_bytes: int):
        self._patterns, self._max_bytes = tuple(patterns), max_bytes
        self.is_open = EVERY in patterns
        self.refused = self.version = 0
        self.unnamed: deque[str] = deque(maxlen=32)
        self._known: dict[bytes, str] = {}
        self._of: dict[bytes, set[bytes]] = {}
        """The admitted endpoints that each participant or session has announced."""
        self._tellers: Counter[bytes] = Counter()
        """How many participants or sessions have announced each of them."""
        self._others: OrderedDict[bytes, str] = OrderedDict()
        self._waiting: deque[_Waiting] = deque()
        self._prefixes: tuple[int, frozenset[bytes]] = (0, frozenset())
        """The participants of `_known`, and the version at which they were looked up."""
        self._lock = threading.RLock()

    def tell(self, owner: bytes, nodes: Mapping[bytes, str]) -> bool:
        """Take what a participant or session says of its nodes, instead of what it has said before.

        Args:
            owner: the participant or session.
            nodes: the full name of the node of each of its endpoints.

        Returns:
            Whether one of them matches.
        """
        with self._lock:
            matching = {one: name for one, name in nodes.items() if self._matches(name)}
            before = self._of.pop(owner, set())
            self._forget(before - matching.keys())
            new = [one for one in matching if one not in self._known][: MAX_KNOWN - len(self._known)]
            kept = {*new, *(matching.keys() & self._known.keys())}
            self._tellers.update(kept - before)
            self._known |= {one: matching[one] for one in kept}
            self.version += bool(new)
            if kept:
                self._of[owner] = kept
            for one, name in nodes.items():
                self._others.pop(one, None)
                if one not in self._known:
                    self._note_other(one, name)
            self._look_at_waiting()
        return bool(matching)

    def forget(self, owner: bytes) -> None:
        """Drop the endpoints that a participant or session has announced."""
        with self._lock:
            self._forget(self._of.pop(owner, set()))

    @property
    def others(self) -> int:
        """How many other nodes were seen."""
        with self._lock:
            return len(set(self._others.values()))

    def admits(self, endpoint: bytes) -> bool:
        """Return whether an endpoint is known to belong to a node that matches."""
        return self.is_open or endpoint in self._known

    def admits_one_of(self, participant: bytes) -> bool:
        """Return whether a participant of DDS is known to have a node that matches."""
        if self.is_open:
            return True
        with self._lock:
            if self._prefixes[0] != self.version:
                self._prefixes = self.version, frozenset(one[: len(participant)] for one in self._known)
            return participant in self._prefixes[1]

    def take(
        self, sender: bytes, what: str, size: int, deliver: Callable[[], None], is_latched: bool = False
    ) -> None:
        """Deliver what an endpoint has sent, now or when its node is known; or refuse it.

        Args:
            sender: the endpoint.
            what: says in an error what it has sent.
            size: its size in bytes.
            deliver: called at most once, in any thread.
            is_latched: whether it is a latched message, which its sender sends once.
        """
        if self.is_open:
            deliver()
            return
        with self._lock:
            if sender in self._known:
                deliver()
                return
            until_s = time.monotonic() + (LATCHED_WAIT_S if is_latched else NAME_WAIT_S)
            one = _Waiting(sender, what, size, deliver, until_s)
            if sender in self._others or not self._make_room(one):
                self.refuse(sender, what)
            else:
                self._waiting.append(one)

    def refuse(self, sender: bytes, what: str) -> None:
        """Count what another node has sent."""
        with self._lock:
            self.refused += 1
            self.unnamed.append(f"{what} of {self._others.get(sender, NAMELESS)} is refused: see `nodes`")

    def look_after(self) -> None:
        """Refuse what has waited for too long; called a few times in a second."""
        if self._waiting:
            with self._lock:
                self._look_at_waiting()

    def _matches(self, name: str) -> bool:
        return any(fnmatchcase(name, one) for one in self._patterns)

    def _note_other(self, endpoint: bytes, name: str) -> None:
        self._others[endpoint] = name
        if len(self._others) > MAX_OTHERS:
            self._others.popitem(last=False)

    def _forget(self, endpoints: Iterable[bytes]) -> None:
        for one in endpoints:
            self._tellers[one] -= 1
            if not self._tellers[one]:
                del self._tellers[one], self._known[one]

    def _make_room(self, new: _Waiting) -> bool:
        """Whether something more may wait; if too much does, who has most of it there loses its oldest.

        So no participant can keep the others out.
        """
        shares: dict[bytes, list[_Waiting]] = {}
        for one in (*self._waiting, new):
            shares.setdefault(one.owner, []).append(one)
        own = shares[new.owner]
        if self._share(own) > 1.0:
            return False
        while self._is_too_much([one for some in shares.values() for one in some]):
            most = max(shares.values(), key=self._share)
            if self._share(most) <= self._share(own):
                return False
            oldest = most.pop(0)
            self._waiting.remove(oldest)
            self.refuse(oldest.sender, oldest.what)
        return True

    def _is_too_much(self, some: Sequence[_Waiting]) -> bool:
        return len(some) > MAX_WAITING or sum(one.size for one in some) > ALL_SENDERS * self._max_bytes

    def _share(self, some: Sequence[_Waiting]) -> float:
        """Return how much of what a participant may have waiting this is."""
        return max(len(some) / MAX_OF_ONE, sum(one.size for one in some) / max(1, self._max_bytes))

    def _look_at_waiting(self) -> None:
        now_s = time.monotonic()
        for _ in range(len(self._waiting)):
            one = self._waiting.popleft()
            if one.sender in self._known:
                one.deliver()
            elif one.sender not in self._others and now_s < one.until_s:
                self._waiting.append(one)
            else:
                if one.sender not in self._others:
                    self._note_other(one.sender, NAMELESS)
                self.refuse(one.sender, one.what)
