"""What a module's code gets to know besides messages, recorded in its history so that it can be replayed."""

import json
import struct
import threading
from collections.abc import Callable
from typing import Any

from robbie_mp.bus.transport.history import Event, Reading
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.module.calls.peers import Peers, Server
from robbie_mp.module.clock import Clock, follows_machine

_DOUBLE = struct.Struct("<d")
Append = Callable[..., None]


def bits_of(number: float) -> int:
    """Return the bits of a double as a word."""
    return int.from_bytes(_DOUBLE.pack(number), "little")


def number_of(bits: int) -> float:
    """Return the double that a word holds."""
    number: float = _DOUBLE.unpack(bits.to_bytes(8, "little"))[0]
    return number


class RecordedClock:
    """A clock whose answers to the module's main thread are recorded.

    Args:
        clock: the clock.
        append: adds to the module's history.
    """

    def __init__(self, clock: Clock, append: Append):
        self._clock = clock
        self._append = append
        self._thread = threading.get_ident()
        self.follows_machine = follows_machine(clock)

    def __getattr__(self, name: str) -> Any:
        """Return whatever else the clock has."""
        return getattr(self._clock, name)

    def _record(self, reading: Reading, value: int) -> None:
        if threading.get_ident() == self._thread:
            self._append(Event.CLOCK, 0, reading, value)

    def now_ns(self) -> int:
        """See `Clock`."""
        now_ns = self._clock.now_ns()
        self._record(Reading.NOW_NS, now_ns)
        return now_ns

    def monotonic_ns(self) -> int:
        """See `Clock`."""
        now_ns = self._clock.monotonic_ns()
        self._record(Reading.MONOTONIC_NS, now_ns)
        return now_ns

    @property
    def jumps(self) -> int:
        """See `Clock`."""
        jumps = self._clock.jumps
        if not self.follows_machine:
            self._record(Reading.JUMPS, jumps)
        return jumps

    def at(self, machine_ns: int) -> int:
        """See `Clock`."""
        then_ns = self._clock.at(machine_ns)
        if not self.follows_machine:
            self._record(Reading.AT, then_ns)
        return then_ns

    def machine_s_until(self, monotonic_ns: int) -> float:
        """See `Clock`."""
        left_s = self._clock.machine_s_until(monotonic_ns)
        self._record(Reading.MACHINE_S_UNTIL, bits_of(left_s))
        return left_s


class RecordedPeers:
    """The other modules, whose answers are recorded; see `Peers`.

    Args:
        peers: the other modules.
        append: adds to the module's history.
    """

    def __init__(self, peers: Peers, append: Append):
        self._peers = peers
        self._append = append
        self.can_serve = peers.can_serve
        self.name = peers.name
        self.incarnation = peers.incarnation

    def _record(self, question: str, answer: Any) -> Any:
        self._append(Event.ANSWER, 0, 0, 0, 0, 0, json.dumps([question, answer]).encode())
        return answer

    def now_ns(self) -> int:
        """See `Peers`."""
        now_ns = self._peers.now_ns()
        self._append(Event.CLOCK, 0, Reading.MACHINE_NS, now_ns)
        return now_ns

    def find_server(self, service: ChannelName) -> Server | None:
        """See `Peers`."""
        server = self._peers.find_server(service)
        self._record("find_server", server)
        return server

    def serves(self, server: Server) -> bool:
        """See `Peers`."""
        answer: bool = self._record("serves", self._peers.serves(server))
        return answer

    def is_same(self, server: Server, incarnation: int) -> bool:
        """See `Peers`."""
        answer: bool = self._record("is_same", self._peers.is_same(server, incarnation))
        return answer

    def incarnation_of(self, server: Server) -> int:
        """See `Peers`."""
        answer: int = self._record("incarnation_of", self._peers.incarnation_of(server))
        return answer

    def end_of(self, server: Server) -> str:
        """See `Peers`."""
        answer: str = self._record("end_of", self._peers.end_of(server))
        return answer

    def rival(self, service: ChannelName) -> str | None:
        """See `Peers`."""
        answer: str | None = self._record("rival", self._peers.rival(service))
        return answer
