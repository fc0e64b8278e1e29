"""The newest state of everything that pages draw, in parts, each encoded once for all pages.

A page gets a packet with the changed parts, and the next packet when it has drawn that one. So nothing queues
up for a page with a slow link or browser: it gets fewer packets, each with the newest state. With each packet
drawn, the page says how long it was on its way, as with pictures (video.py). Packets leave most of a slow
network to them, and to what the operator orders.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import struct
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass

from robbie_mp.station.live.network import NetworkCost, PageNetwork, Transfer
from robbie_mp.station.web.page_json import from_page

PACKET_BYTES = 1 << 16
"""Size at which a packet is full. A packet has at least one part of any size."""
SENT = "sent_s"
"""The part of each packet that tells when it was sent, s by the robot's monotonic clock."""
SMALL_BYTES = 1 << 12
"""Parts up to this size are sent before all others."""
PACKETS_AHEAD = 2
"""Maximum number of packets in flight to a page, so that it does not wait for round trips."""
COST_LIMIT_S = 0.05
"""Time that the network may need for a packet; it has at least one part."""
PROMPT_S = 0.03
"""A packet that takes no longer than this beyond the shortest time has not waited for the network."""
USED_SHARE = 0.2
"""Packets use this share of the network's time at most, and are late for no more."""
LONGEST_WAIT_S = 1.0
"""Longest time between two packets, whatever they cost."""
NOTHING = (0, 0)
"""The version, and the number of the packet, of a part that was never sent."""
MAX_TEXT = 100
DRAWING_LIMIT_S = 30.0
"""A page that has drawn nothing for this time is disconnected."""


@dataclass(frozen=True)
class Part:
    """One part of the drawing."""

    number: int
    """Number that increases with each change of the data."""
    data: bytes


class LiveParts:
    """All parts by name; `map/tile/3/4`, for example, is in the group `map`. One thread writes them."""

    def __init__(self) -> None:
        self.parts: Mapping[str, Part] = {}
        self._numbers = itertools.count(1)
        self._followers: tuple[Follower, ...] = ()

    def put(self, group: str, parts: Mapping[str, bytes]) -> None:
        """Replace the parts of a group; unchanged parts are not sent again."""
        before = self.parts
        found: dict[str, Part] = {}
        for name, data in parts.items():
            known = before.get(f"{group}/{name}")
            is_same = known is not None and known.data == data
            found[f"{group}/{name}"] = known if known and is_same else Part(next(self._numbers), data)
        others = {name: part for name, part in before.items() if not name.startswith(f"{group}/")}
        self.parts = others | found  # a new dict, because the page server reads the old one meanwhile
        for follower in self._followers:
            follower.wake(group)

    def is_wanted(self, group: str) -> bool:
        """Whether any page follows a group. Otherwise you need not put its parts."""
        return any(group in follower.groups for follower in self._followers)

    def join(self, follower: Follower) -> None:
        """Add a follower; like `leave`, called in the page server's thread."""
        self._followers = (*self._followers, follower)

    def leave(self, follower: Follower) -> None:
        """Remove a follower."""
        self._followers = tuple(one for one in self._followers if one is not follower)


class Follower:
    """Tracks which parts one page has, and chooses the next ones. Only `wake` may be called in other threads.

    Args:
        live: the parts.
        groups: the groups to follow.
        network: that of the page, which its pictures and packets share.
    """

    def __init__(self, live: LiveParts, groups: frozenset[str], network: PageNetwork):
        self.groups = groups
        self._live = live
        self._prefixes = tuple(f"{group}/" for group in groups)
        self._has: dict[str, tuple[int, int]] = {}
        """For each part, the version and the number of the packet that were last sent."""
        self._sent = self._drawn = 0
        self._network, self._cost = network, NetworkCost()
        network.costs.add(self._cost)
        self._flying: deque[Transfer] = deque()
        """The packets that the page has not yet drawn."""
        self._size = 0
        """Of the last packet, bytes."""
        self._late_s = 0.0
        """How late the last packet was, because the network is slow."""
        self._free_s = -math.inf
        """From when on the network has room for the next packet."""
        self._is_gone = False
        self._loop = asyncio.get_running_loop()
        self._changed = asyncio.Event()
        self._drawn_s = self._loop.time()
        live.join(self)

    def wake(self, group: str) -> None:
        """Wake the follower because a group has changed. Any thread may call this."""
        if group in self.groups:
            self._loop.call_soon_threadsafe(self._changed.set)

    def hear(self, said: str) -> None:
        """Record that the page has drawn one more packet, and how long that was on its way."""
        if self._flying:
            sent, way_s = self._flying.popleft(), way_of(said)
            self._network.came(sent, way_s)
            if way_s is not None:
                self._cost.add(sent.size, way_s)
                self._late_s = max(0.0, way_s - PROMPT_S)
                self._wait_for(self._late_s)
        self._drawn = min(self._sent, self._drawn + 1)
        self._drawn_s = self._loop.time()
        self._changed.set()

    def _wait_for(self, cost_s: float) -> None:
        """Leave the network to others, after it was used for some time."""
        wait_s = min(LONGEST_WAIT_S, cost_s / (USED_SHARE * self._network.share))
        self._free_s = max(self._free_s, self._loop.time() + wait_s)

    def go(self) -> None:
        """Stop sending."""
        self._is_gone = True
        while self._flying:
            self._network.came(self._flying.popleft())
        self._live.leave(self)
        self._changed.set()

    async def next(self) -> bytes | None:
        """Wait for changes and return the next packet; None if there will be none."""
        while not self._is_gone:
            self._changed.clear()
            behind, now_s = self._sent - self._drawn, self._loop.time()
            wait_s, ahead = self._free_s - now_s, 1 if self._late_s else PACKETS_AHEAD
            if wait_s <= 0.0 and behind < ahead and any(self._changed_parts(self._live.parts)):
                sent = await self._network.turn(self._size)
                if not self._is_gone and (packet := self.packet()) is not None:
                    if not behind:
                        self._drawn_s = self._loop.time()
                    self._size = len(packet)
                    self._flying.append(self._network.went(sent, self._size))
                    self._wait_for(sent.cost_s)
                    return packet
                self._network.came(sent)
                continue
            left_s = self._drawn_s + DRAWING_LIMIT_S - now_s if behind else math.inf
            if left_s <= 0.0:
                break
            limit_s = min(left_s, wait_s) if wait_s > 0.0 else left_s
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._changed.wait(), limit_s if limit_s < math.inf else None)
        return None

    def _changed_parts(self, parts: Mapping[str, Part]) -> Iterator[tuple[str, Part]]:
        for name, part in parts.items():
            if name.startswith(self._prefixes) and self._has.get(name, NOTHING)[0] != part.number:
                yield name, part

    def packet(self) -> bytes | None:
        """Return a packet with changed parts, up to its maximum size; None if nothing has changed."""
        parts = self._live.parts
        changed = [*self._changed_parts(parts)]
        if not changed:
            return None
        # Small parts first, then those sent longest ago, so that each is sent in time. Of parts never sent,
        # the most recently changed come first, so the large map does not delay moving parts.
        changed.sort(
            key=lambda one: (
                len(one[1].data) > SMALL_BYTES,
                self._has.get(one[0], NOTHING)[1],
                -one[1].number,
            )
        )
        self._sent += 1
        chosen: list[tuple[str, Part]] = []
        size = 0
        for name, part in changed:
            grown = size + len(part.data)
            if chosen and (grown > PACKET_BYTES or self._network.cost_s(grown) > COST_LIMIT_S):
                break
            size += len(part.data)
            chosen.append((name, part))
        # Without parts that no longer exist.
        self._has = {name: had for name, had in self._has.items() if name in parts}
        self._has |= {name: (part.number, self._sent) for name, part in chosen}
        sent_s = json.dumps(time.monotonic()).encode()
        return packed({SENT: sent_s, **{name: part.data for name, part in chosen}})


def way_of(said: str) -> float | None:
    """Return how long a packet was on its way by what the page says, s; None if it does not know."""
    try:
        told = from_page(said) if len(said) <= MAX_TEXT else None
    except ValueError:
        return None
    way_s = told.get("way_s") if isinstance(told, dict) else None
    return float(way_s) if isinstance(way_s, int | float) else None


def packed(parts: Mapping[str, bytes]) -> bytes:
    """Return a packet with parts.

    It is the length of its head (uint32, little endian), the head (JSON: name and number of bytes of each
    part), and the parts.
    """
    head = json.dumps([[name, len(data)] for name, data in parts.items()]).encode()
    return b"".join((struct.pack("<I", len(head)), head, *parts.values()))
