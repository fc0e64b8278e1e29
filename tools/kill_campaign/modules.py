"""The module class of the campaign's robot. Its settings choose its part."""

import math
import random
import time
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp import MessageHandling, Module, setting
from tools.journal import Journal
from tools.kill_campaign.message import Noise, Numbered, checksum, is_whole

PAUSE_FILE = "pause"
HOARD_FILE = "hoard"
QUIET = "paused, 0 outstanding"
"""The status of a paused module when no process holds or awaits its messages any more."""


class Participant(Module):
    """Publishes on the topic of its own name, journals what it handles, or both.

    The module stops publishing and releases all arrays while the output directory contains a file `pause`. A
    hoarder keeps arrays only while the directory contains a file `hoard`.
    """

    period_s: float = setting(0.05, "time between ticks", minimum=0.001)
    burst: int = setting(0, "messages published each tick", minimum=0)
    smallest_bytes: int = setting(64, "smallest message", minimum=64)
    largest_bytes: int = setting(4096, "largest message", minimum=64)
    loans: bool = setting(False, "write messages in place")
    outstanding_limit: int = setting(4000, "publish nothing while this number of messages is unhandled")
    topics: list[str] = setting([], "name of the module whose messages to handle; '': all modules")
    newest: bool = setting(False, "keep only the newest message")
    handle_s: float = setting(0.0, "duration of a handler")
    relay_every: int = setting(0, "publish one message after this number of handled ones; 0: none", minimum=0)
    hold: int = setting(0, "number of arrays kept after their handler", minimum=0)
    hoards: bool = setting(False, "keep all arrays while there is a file `hoard`, else none")

    def setup(self) -> None:
        """Start a new incarnation and journal it."""
        self.life = (self.restored or 0) + 1
        self.checkpoint(self.life)
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.journal.note("S", self.life)
        self.noise = Noise(self.largest_bytes)
        self.random = random.Random(f"{self.name} {self.life}")
        self.number = 0
        self.handled = 0
        self.held: deque[NDArray[np.uint8]] = deque()
        handling = MessageHandling.KEEP_ONLY_NEWEST if self.newest else MessageHandling.ALWAYS_DELIVER
        for topic in self.topics:
            self.subscribe(Numbered, self.on_message, handling, topic=topic)

    @property
    def is_paused(self) -> bool:
        """Whether the campaign has paused the module."""
        return (self.output_directory / PAUSE_FILE).exists()

    @property
    def may_hold(self) -> bool:
        """Whether the module keeps arrays now."""
        return not self.is_paused and (not self.hoards or (self.output_directory / HOARD_FILE).exists())

    def tick(self) -> None:
        """Publish a burst, unless paused."""
        if self.is_paused:
            self.held.clear()
            self.status = f"paused, {self.outstanding} outstanding"
            return
        self.status = f"incarnation {self.life}, {self.number} published, {self.handled} handled"
        if self.hoards and not self.may_hold:
            self.held.clear()
        elif self.held and not self.hoards and self.random.random() < 0.2:
            self.held.popleft()
        for _ in range(self.burst):
            if self.outstanding < self.outstanding_limit:
                self.send()

    def on_message(self, message: Numbered) -> None:
        """Journal a message, and act as the settings say."""
        envelope = self.envelope
        whole = int(is_whole(message) and envelope.sender == envelope.topic == message.publisher)
        self.journal.note(
            "E",
            envelope.sequence,
            envelope.sender,
            message.incarnation,
            message.number,
            whole,
            envelope.published_ns,
        )
        self.handled += 1
        if self.handle_s:
            time.sleep(self.handle_s)
        if self.hold and self.may_hold:
            self.held.append(message.payload)
            if len(self.held) > self.hold:
                self.held.popleft()
        if self.relay_every and self.handled % self.relay_every == 0 and not self.is_paused:
            self.send()
        # The message in memory must not have changed while the handler ran.
        self.journal.note("L", envelope.sequence, int(is_whole(message)))

    def send(self) -> None:
        """Publish the next number, and journal it before and after."""
        number, self.number = self.number, self.number + 1
        low, high = math.log(self.smallest_bytes), math.log(self.largest_bytes)
        size = max(0, round(math.exp(self.random.uniform(low, high))) - 64)
        payload = self.noise.payload(self.life, number, size)
        fields: dict[str, Any] = {
            "publisher": self.name,
            "incarnation": self.life,
            "number": number,
            "checksum": checksum(self.name, self.life, number, payload),
        }
        self.journal.note("I", number)
        accepted = True
        if self.loans:  # never refused, because this part stays far below its limits; the verdict checks it
            with self.loan(Numbered, topic=self.name, **fields, payload=size) as message:
                message.payload[:] = payload
                del message
        else:
            accepted = self.publish(Numbered(**fields, payload=payload), topic=self.name)
        self.journal.note("A" if accepted else "R", number)
