"""The station's knowledge about each victim, for the map, the table, the question and a log's events."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from starlette.responses import Response

from robbie_mp.messages import TimeJump
from robbie_mp.station.map.marks import MapMark, MarkPicture
from robbie_mp.station.watch.pictures import answer_with, encode_image, no_picture, serve_pictures
from robbie_robots.modules.rescue.messages import VictimFound

if TYPE_CHECKING:
    from collections.abc import Callable

    from robbie_mp.station.watch.latest import MessageSource

MAX_VICTIMS = 256
COLOURS = {
    VictimFound.SUSPECTED: "#ef6c00",
    VictimFound.ASKED: "#fdd835",
    VictimFound.CONFIRMED: "#00897b",
    VictimFound.REJECTED: "#424242",
}
"""Colours on the map and in the 3-D view, by state."""
SHOWN = {VictimFound.ASKED, VictimFound.CONFIRMED}
"""States in which the 3-D view shows a picture. Before, a better one comes with almost every image."""
STATES = {
    VictimFound.SUSPECTED: "suspected",
    VictimFound.ASKED: "asked",
    VictimFound.CONFIRMED: "confirmed",
    VictimFound.REJECTED: "rejected",
}


@dataclass(frozen=True)
class KnownVictim:
    """The newest message about one victim, and when it arrived."""

    found: VictimFound
    answer_until_s: float
    """Time until which the operator can answer; monotonic clock."""
    count: int
    """Number of the message among all messages about victims."""
    image_count: int
    """Number of the message with which the image arrived."""
    heard_s: float
    """Time when the newest message arrived; monotonic clock."""
    asked_since_s: float
    """Time when the robot first asked the operator; monotonic clock."""

    @property
    def is_asked(self) -> bool:
        """Whether the robot waits for the operator's answer."""
        return self.found.state == VictimFound.ASKED

    @property
    def age_s(self) -> float:
        """Time since the newest message."""
        return time.monotonic() - self.heard_s

    @property
    def time_left_s(self) -> float:
        """Time left to answer."""
        return max(0.0, self.answer_until_s - time.monotonic())


class VictimWatch:
    """Keeps the newest message about each victim.

    Attributes:
        victims: victims by number. The dict is replaced and never changed, because other threads read it.
        count: number of messages so far.
    """

    def __init__(self, messages: MessageSource):
        self.victims: dict[int, KnownVictim] = {}
        self.count = 0
        messages.hear(VictimFound, self._on_victim)  # all messages, because each may be about another victim
        messages.hear(TimeJump, lambda _jump: self._forget())
        serve_pictures("/pictures/victim/{number}", self._answer)

    def _on_victim(self, message: VictimFound) -> None:
        self.count += 1
        # A copy: kept messages would fill their publisher's memory.
        found = VictimFound.decode(message.encode())
        now_s = time.monotonic()
        before = self.victims.get(found.id)
        since_s = before.asked_since_s if before is not None and before.is_asked else now_s
        is_same = before is not None and np.array_equal(before.found.image.data, found.image.data)
        image_count = before.image_count if before is not None and is_same else self.count
        until_s = now_s + found.answer_within_s
        known = KnownVictim(found, until_s, self.count, image_count, now_s, since_s)
        others = {number: victim for number, victim in self.victims.items() if number != found.id}
        while len(others) >= MAX_VICTIMS:
            others.pop(next(iter(others)))  # the victim without news for the longest time
        self.victims = {**others, found.id: known}

    def marks(self) -> list[MapMark]:
        """Return the marks of all victims on the map."""
        return [mark_of(known) for known in self.victims.values()]

    def _forget(self) -> None:
        """Forget all victims: after a jump back in time, they have not been found yet."""
        self.victims = {}

    def _answer(self, number: int) -> Response:
        victim = self.victims.get(number)
        if victim is None:
            return no_picture("there is no such victim")
        return answer_with(encode_image, victim.found.image)


def mark_of(known: KnownVictim) -> MapMark:
    """Return the mark of one victim; with its picture, if the robot is so sure that it has asked."""
    found = known.found
    position = found.pose.position
    colour = COLOURS.get(found.state, COLOURS[VictimFound.SUSPECTED])
    picture = None
    if found.state in SHOWN and found.image.width:
        address = f"/pictures/victim/{found.id}?{known.image_count}"
        shape = found.image.height / found.image.width
        picture = MarkPicture(address, round(found.pose.orientation.yaw, 2), shape)
    return MapMark(found.name, colour, position.x, position.y, position.z, picture, "person")


def victim_changes() -> Callable[[VictimFound], str | None]:
    """Return a function that describes a victim in a log if its state has changed, else returns None."""
    states: dict[int, int] = {}

    def describe(victim: VictimFound) -> str | None:
        if states.get(victim.id) == victim.state:
            return None
        states[victim.id] = victim.state
        return f"{victim.name or victim.id} {STATES.get(victim.state, victim.state)}"

    return describe
