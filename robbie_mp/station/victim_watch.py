"""What is known of victims: by number, for the map, the list and the question to the operator."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from starlette.responses import Response

from robbie_mp.messages import TimeJump, VictimFound
from robbie_mp.station.pictures import (
    answer_with,
    encode_image,
    no_picture,
    serve_pictures,
)

if TYPE_CHECKING:
    from robbie_mp.station.station import OperatorStation

MOST_VICTIMS = 256
STATES = {
    VictimFound.SUSPECTED: "suspected",
    VictimFound.ASKED: "asked",
    VictimFound.CONFIRMED: "confirmed",
    VictimFound.REJECTED: "rejected",
}


@dataclass(frozen=True)
class KnownVictim:
    """The newest about one victim."""

    found: VictimFound
    answer_until_s: float
    """The operator may answer until then, if asked; monotonic clock."""
    count: int
    """Of messages about victims until this one."""
    image_count: int
    """Of the message with which its image came."""
    heard_s: float
    """When the newest message came; monotonic clock."""
    asked_since_s: float
    """When the operator was asked first, without an answer since; monotonic clock."""

    @property
    def is_asked(self) -> bool:
        """Whether the operator is to answer."""
        return self.found.state == VictimFound.ASKED

    @property
    def age_s(self) -> float:
        """How long ago the robot last told of it."""
        return time.monotonic() - self.heard_s

    @property
    def time_left_s(self) -> float:
        """How long the operator may still answer."""
        return max(0.0, self.answer_until_s - time.monotonic())


class VictimWatch:
    """Keeps the newest message about each victim.

    Attributes:
        victims: by number; replaced and never changed, for other threads look at it.
        count: messages so far.
    """

    def __init__(self, station: OperatorStation):
        self.victims: dict[int, KnownVictim] = {}
        self.count = 0
        station.hear(VictimFound, self._on_victim)  # all of them: each is about another victim
        station.hear(TimeJump, lambda _jump: self._forget())
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
        while len(others) >= MOST_VICTIMS:
            others.pop(next(iter(others)))  # the one nothing was heard of for longest
        self.victims = {**others, found.id: known}

    def _forget(self) -> None:
        """Begin anew: time has jumped, and what was found later is not found yet."""
        self.victims = {}

    def _answer(self, number: int) -> Response:
        victim = self.victims.get(number)
        if victim is None:
            return no_picture("there is no such victim")
        return answer_with(encode_image, victim.found.image)
