"""The modules of the two robots of a trial. They write down what they send and receive, with the time.

Both robots run on this machine, so their monotonic clocks are one, and times of the two can be compared.
"""

import time

import numpy as np

from robbie_mp import Duration, Header, Message, Module, Time, setting
from robbie_mp.messages import (
    CompressedImage,
    DriveCommand,
    Image,
    LinkState,
    MapMetaData,
    OccupancyGrid,
    Odometry,
)
from robbie_mp.messages.primitives import Array, int64, uint8, uint64
from tools.journal import Journal

RECEIVED, SENT = "G", "P"
VALID_FOR_S = 0.25
TOPICS = ("urgent", "state", "reliable", "bulk")


class Probe(Message, name="trial_msgs/msg/Probe", version=1):
    """A numbered message that says when it was sent."""

    number: uint64
    sent_ns: int64  # monotonic clock
    payload: Array[uint8]  # (N,)


class Speaker(Module):
    """Sends messages of most classes.

    Lines of its journal: P TOPIC NUMBER TIME.
    """

    period_s = 0.01
    periods_s: dict[str, float] = setting({}, "time between two messages, by topic")
    bulk_bytes: int = setting(200_000, "size of the bulk messages")

    def setup(self) -> None:
        """Prepare what is sent."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        noise = np.random.default_rng(1).integers(0, 255, self.bulk_bytes, np.uint8)
        self.payloads = {topic: noise if topic == "bulk" else noise[:100] for topic in self.periods_s}
        # A restarted process continues with greater numbers.
        self.numbers = dict.fromkeys(self.periods_s, time.monotonic_ns() // 1000)
        self.due_s = dict.fromkeys(self.periods_s, 0.0)

    def tick(self) -> None:
        """Send what is due."""
        now_s = time.monotonic()
        for topic, period_s in self.periods_s.items():
            if now_s < self.due_s[topic]:
                continue
            self.due_s[topic] = max(now_s, self.due_s[topic] + period_s)
            self.numbers[topic] += 1
            number = self.numbers[topic]
            probe = Probe(number=number, sent_ns=time.monotonic_ns(), payload=self.payloads[topic])
            self.journal.note(SENT, topic, number)
            self.publish(probe, topic=topic)


class Scout(Module):
    """The operator's view: a camera that moves, a map that grows, and the robot's position."""

    period_s = 0.01
    periods_s: dict[str, float] = setting({}, "time between two messages, by topic")

    def setup(self) -> None:
        """Draw a picture and a map."""
        self.due_s = dict.fromkeys(self.periods_s, 0.0)
        random = np.random.default_rng(1)
        ramp = np.add.outer(np.arange(480) / 4, np.arange(1280) / 6)[:, :, None]
        self.picture = np.clip(ramp + random.normal(0, 4, (480, 1280, 3)), 0, 255).astype(np.uint8)
        self.cells = np.full(400 * 400, -1, np.int8)
        self.number = 0

    def tick(self) -> None:
        """Publish what is due."""
        now_s = time.monotonic()
        for topic, period_s in self.periods_s.items():
            if now_s >= self.due_s[topic]:
                self.due_s[topic] = max(now_s, self.due_s[topic] + period_s)
                self.publish(self.make(topic), topic=topic)

    def make(self, topic: str) -> Message:
        """Return the next message of a topic."""
        self.number += 1
        header = Header(stamp=Time.from_nanoseconds(time.monotonic_ns()))
        if topic == "camera":
            left = self.number % 640
            view = np.ascontiguousarray(self.picture[:, left : left + 640]).ravel()
            return Image(header=header, height=480, width=640, encoding="rgb8", step=1920, data=view)
        if topic == "map":
            seen = np.random.default_rng(self.number).integers(0, len(self.cells), 4000)
            self.cells[seen] = 100 * (seen % 7 == 0)
            info = MapMetaData(resolution=0.05, width=400, height=400)
            return OccupancyGrid(header=header, info=info, data=self.cells)
        return Odometry(header=header)


class Viewer(Module):
    """The operator's end of the view. Lines of its journal: G TOPIC NUMBER SENT_NS TIME."""

    def setup(self) -> None:
        """Subscribe."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.subscribe(CompressedImage, self.on_message, topic="camera")
        self.subscribe(OccupancyGrid, self.on_message, topic="map")
        self.subscribe(Odometry, self.on_message, topic="state")

    def on_message(self, message: CompressedImage | OccupancyGrid | Odometry) -> None:
        """Write it down."""
        sent_ns = message.header.stamp.nanoseconds
        self.journal.note(RECEIVED, self.envelope.topic, sent_ns, sent_ns)


class Listener(Module):
    """Lines of its journal: G TOPIC NUMBER SENT_NS TIME."""

    def setup(self) -> None:
        """Subscribe."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        for topic in TOPICS:
            self.subscribe(Probe, self.on_probe, topic=topic)

    def on_probe(self, probe: Probe) -> None:
        """Write it down."""
        self.journal.note(RECEIVED, self.envelope.topic, probe.number, probe.sent_ns)


LET_GO_FILE = "let_go"


class Pilot(Module):
    """Drives, unless a file says that the operator has let go. Lines of its journal: P manual NUMBER TIME."""

    period_s = 0.05

    def setup(self) -> None:
        """Begin to count."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.number = time.monotonic_ns() // 1000

    def tick(self) -> None:
        """Send a command."""
        if (self.output_directory / LET_GO_FILE).exists():
            return
        self.number += 1
        # The link moves stamps into the robot's clock, so the frame says when it was sent.
        now = Time.from_nanoseconds(self.clock.now_ns())
        header = Header(stamp=now, frame_id=f"{self.number} {time.monotonic_ns()}")
        valid_for = Duration.from_nanoseconds(round(VALID_FOR_S * 1e9))
        self.journal.note(SENT, "manual", self.number)
        self.publish(
            DriveCommand(header=header, linear_m_per_s=0.5, valid_for=valid_for, based_on=header.stamp),
            topic="manual",
        )


class Base(Module):
    """A base that drives while a command is valid.

    Lines of its journal: G manual NUMBER SENT_NS VALID_NS TIME.
    """

    def setup(self) -> None:
        """Subscribe."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.subscribe(DriveCommand, self.on_command, topic="manual")

    def on_command(self, command: DriveCommand) -> None:
        """Write it down."""
        header, valid_ns = command.header, command.valid_for.nanoseconds
        self.journal.note(RECEIVED, "manual", *header.frame_id.split(), valid_ns)


class Bookkeeper(Module):
    """Keeps the last state of the link in a file."""

    def setup(self) -> None:
        """Subscribe."""
        self.subscribe(LinkState, self.on_state)

    def on_state(self, state: LinkState) -> None:
        """Replace the file at once, so that no reader sees half of it."""
        new = self.output_directory / "link_state.new"
        new.write_bytes(state.encode())
        new.replace(self.output_directory / "link_state")
