"""The modules of two linked robots. They write down what they send and receive, with the time.

Both robots run on this machine, so their monotonic clocks are one, and times of the two can be compared.
"""

import time

import numpy as np

from robbie_mp import Message, Module, setting
from robbie_mp.messages import LinkState
from robbie_mp.messages.primitives import Array, int64, uint8, uint64
from tools.journal import Journal

PAUSE_FILE = "pause"
STATE_FILE = "link_state"


class Probe(Message, name="link_msgs/msg/Probe", version=1):
    """A numbered message that says when it was sent."""

    number: uint64
    sent_ns: int64  # monotonic clock
    payload: Array[uint8]  # (N,)


class Speaker(Module):
    """Sends numbered messages, until a file tells it to pause. Lines of its journal: P TOPIC NUMBER TIME."""

    period_s = 0.01
    periods_s: dict[str, float] = setting({}, "time between two messages, by topic")
    bulk_bytes: int = setting(200_000, "size of the messages with topic `bulk`")

    def setup(self) -> None:
        """Prepare what is sent."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        noise = np.random.default_rng(1).integers(0, 255, self.bulk_bytes, np.uint8)
        self.payloads = {topic: noise if topic == "bulk" else noise[:100] for topic in self.periods_s}
        # A restarted process, and a restarted robot, continue with greater numbers.
        self.numbers = dict.fromkeys(self.periods_s, time.monotonic_ns() // 1000)
        self.due_s = dict.fromkeys(self.periods_s, 0.0)

    def tick(self) -> None:
        """Send what is due."""
        if (self.output_directory / PAUSE_FILE).exists():
            return
        now_s = time.monotonic()
        for topic, period_s in self.periods_s.items():
            if now_s >= self.due_s[topic]:
                self.due_s[topic] = max(now_s, self.due_s[topic] + period_s)
                self.send(topic)

    def send(self, topic: str) -> None:
        """Send the next number; note it first, so that no number is used twice if the robot is killed."""
        self.numbers[topic] += 1
        number = self.numbers[topic]
        self.journal.note("P", topic, number)
        probe = Probe(number=number, sent_ns=time.monotonic_ns(), payload=self.payloads[topic])
        self.publish(probe, topic=topic)


class Listener(Module):
    """Lines of its journal: G TOPIC NUMBER SENT_NS TIME."""

    topics: list[str] = setting([], "what it listens to")

    def setup(self) -> None:
        """Subscribe."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        for topic in self.topics:
            self.subscribe(Probe, self.on_probe, topic=topic)

    def on_probe(self, probe: Probe) -> None:
        """Write it down."""
        self.journal.note("G", self.envelope.topic, probe.number, probe.sent_ns)


class Bookkeeper(Module):
    """Keeps the last state of the link in a file."""

    def setup(self) -> None:
        """Subscribe."""
        self.subscribe(LinkState, self.on_state)

    def on_state(self, state: LinkState) -> None:
        """Replace the file at once, so that no reader sees half of it."""
        new = self.output_directory / f"{STATE_FILE}.new"
        new.write_bytes(state.encode())
        new.replace(self.output_directory / STATE_FILE)
