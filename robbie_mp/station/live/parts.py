"""The newest state of everything that pages draw, in parts, each encoded once for all pages.

A page gets a packet with the changed parts, and the next packet when it has drawn that one. So nothing queues
up for a page with a slow link or browser: it gets fewer packets, each with the newest state.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass

PACKET_BYTES = 1 << 16
"""Size at which a packet is full. A packet has at least one part of any size."""
SMALL_BYTES = 1 << 12
"""Parts up to this size are sent before all others."""
PACKETS_AHEAD = 2
"""Maximum number of packets in flight to a page, so that it does not wait for round trips."""
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
    """

    def __init__(self, live: LiveParts, groups: frozenset[str]):
        self.groups = groups
        self._live = live
        self._prefixes = tuple(f"{group}/" for group in groups)
        self._has: dict[str, tuple[int, int]] = {}
        """For each part, the version and the number of the packet that were last sent."""
        self._sent = self._drawn = 0
        self._is_gone = False
        self._loop = asyncio.get_running_loop()
        self._changed = asyncio.Event()
        self._drawn_s = self._loop.time()
        live.join(self)

    def wake(self, group: str) -> None:
        """Wake the follower because a group has changed. Any thread may call this."""
        if group in self.groups:
            self._loop.call_soon_threadsafe(self._changed.set)

    def hear(self, _said: str) -> None:
        """Record that the page has drawn one more packet."""
        self._drawn = min(self._sent, self._drawn + 1)
        self._drawn_s = self._loop.time()
        self._changed.set()

    def go(self) -> None:
        """Stop sending."""
        self._is_gone = True
        self._live.leave(self)
        self._changed.set()

    async def next(self) -> bytes | None:
        """Wait for changes and return the next packet; None if there will be none."""
        while not self._is_gone:
            self._changed.clear()
            behind = self._sent - self._drawn
            if behind < PACKETS_AHEAD and (packet := self.packet()) is not None:
                if not behind:
                    self._drawn_s = self._loop.time()
                return packet
            left_s = self._drawn_s + DRAWING_LIMIT_S - self._loop.time() if behind else None
            try:
                await asyncio.wait_for(self._changed.wait(), left_s)
            except asyncio.TimeoutError:
                break
        return None

    def packet(self) -> bytes | None:
        """Return a packet with changed parts, up to its maximum size; None if nothing has changed."""
        parts = self._live.parts
        nothing = (0, 0)
        changed = [
            (name, part)
            for name, part in parts.items()
            if name.startswith(self._prefixes) and self._has.get(name, nothing)[0] != part.number
        ]
        if not changed:
            return None
        # Small parts first, then those sent longest ago, so that each is sent in time. Of parts never sent,
        # the most recently changed come first, so the large map does not delay moving parts.
        changed.sort(
            key=lambda one: (
                len(one[1].data) > SMALL_BYTES,
                self._has.get(one[0], nothing)[1],
                -one[1].number,
            )
        )
        self._sent += 1
        chosen: list[tuple[str, Part]] = []
        size = 0
        for name, part in changed:
            if chosen and size + len(part.data) > PACKET_BYTES:
                break
            size += len(part.data)
            chosen.append((name, part))
        # Without parts that no longer exist.
        self._has = {name: had for name, had in self._has.items() if name in parts}
        self._has |= {name: (part.number, self._sent) for name, part in chosen}
        return packed({name: part.data for name, part in chosen})


def packed(parts: Mapping[str, bytes]) -> bytes:
    """Return a packet with parts.

    It is the length of its head (uint32, little endian), the head (JSON: name and number of bytes of each
    part), and the parts.
    """
    head = json.dumps([[name, len(data)] for name, data in parts.items()]).encode()
    return b"".join((struct.pack("<I", len(head)), head, *parts.values()))
