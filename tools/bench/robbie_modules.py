"""The modules with which Robbie is measured."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from robbie_mp import (
    DEFAULT,
    REQUIRED,
    Array,
    Message,
    Module,
    Reply,
    Request,
    float64,
    int64,
    setting,
    uint8,
)
from tools.bench.record import BEGAN_NS, ENDED_NS, SENT, STAMPS, Receipts, map_publisher
from tools.bench.work import END, Work

LOOK_EVERY_S = 0.01
FLAT_OUT_OUTSTANDING = 800
"""Maximum number of unhandled messages when publishing flat out: less than a subscriber's queue holds (1000),
and less than the ring to the core holds (1024 records, of which 128 are kept for releases)."""


class Probe(Message, name="bench_msgs/msg/Probe", version=1):
    """The small message: 64 bytes."""

    number: int64
    stamp_ns: int64  # monotonic clock
    x: float64 = DEFAULT
    y: float64 = DEFAULT
    z: float64 = DEFAULT
    roll: float64 = DEFAULT
    pitch: float64 = DEFAULT
    yaw: float64 = DEFAULT


class Picture(Message, name="bench_msgs/msg/Picture", version=1):
    """The large message."""

    number: int64
    stamp_ns: (
        int64  # monotonic clock; 0: the stamp is in the first 8 bytes of data, written when data was filled
    )
    data: Array[uint8]  # (N,)


class Answer(Reply, name="bench_msgs/srv/Ask_Response"):
    """The reply: 64 bytes."""

    number: int64
    stamp_ns: int64  # that of the request
    x: float64 = DEFAULT
    y: float64 = DEFAULT
    z: float64 = DEFAULT
    roll: float64 = DEFAULT
    pitch: float64 = DEFAULT


class Ask(Request[Answer], name="bench_msgs/srv/Ask_Request"):
    """The request: 64 bytes."""

    number: int64
    stamp_ns: int64  # monotonic clock
    x: float64 = DEFAULT
    y: float64 = DEFAULT
    z: float64 = DEFAULT
    roll: float64 = DEFAULT
    pitch: float64 = DEFAULT


class Publisher(Module):
    """Publishes the messages, waits until all have been handled, and ends."""

    work_file: Path = setting(REQUIRED, "the work, as JSON")

    def setup(self) -> None:
        """Prepare the messages."""
        self.work = work = Work.load(self.work_file)
        self.period_s = 1 / work.rate_hz if work.rate_hz else LOOK_EVERY_S
        self.record = map_publisher(work)
        self.source = np.ones(work.size_bytes, np.uint8)
        self.numbers = self.upcoming()
        self.ended = False

    def upcoming(self) -> Iterator[int]:
        """Yield the numbers to publish, and record when the measured ones begin and end."""
        for _ in range(self.work.warm_up):
            yield -1
        self.record[BEGAN_NS] = time.monotonic_ns()
        for number in range(self.work.count):
            self.record[SENT] = number + 1
            if self.work.stages:
                self.record[STAMPS + number] = time.monotonic_ns()
            yield number
        self.record[ENDED_NS] = time.monotonic_ns()
        yield END
        self.ended = True

    def tick(self) -> None:
        """Publish the next message, or at flat-out rate as many as the limit allows."""
        if self.ended:
            if not self.outstanding:
                self.stop()
            return
        if self.work.rate_hz:
            self.publish_next()
            return
        while not self.ended and self.outstanding < FLAT_OUT_OUTSTANDING:
            self.publish_next()
        self.wake_after_freed(FLAT_OUT_OUTSTANDING // 2)

    def publish_next(self) -> None:
        """Stamp and publish the next message."""
        number = next(self.numbers, None)
        if number is None:
            return
        topic = self.work.hop(0).topic
        if not self.work.has_array:
            stamp_ns = time.monotonic_ns()
            self.publish(
                Probe(number=number, stamp_ns=stamp_ns, x=1.0, y=2.0, z=3.0, roll=4.0, pitch=5.0, yaw=6.0),
                topic=topic,
            )
        elif self.work.in_place:
            with self.loan(
                Picture, topic=topic, number=number, stamp_ns=0, data=self.work.size_bytes
            ) as picture:
                stamp = picture.data.data.cast("q")  # now: it takes 20 µs when caches are cold
                np.copyto(picture.data, self.source)
                stamp[0] = time.monotonic_ns()
                stamp.release()
        else:
            self.publish(Picture(number=number, stamp_ns=time.monotonic_ns(), data=self.source), topic=topic)


class Subscriber(Module):
    """Records when it receives each message."""

    work_file: Path = setting(REQUIRED, "the work, as JSON")
    index: int = setting(0, "index of this subscriber", minimum=0)

    def setup(self) -> None:
        """Subscribe to the work's messages."""
        work = Work.load(self.work_file)
        self.handle = Receipts(work, self.index).handle
        last = work.hop(work.stages)
        if last.has_array:
            self.subscribe(Picture, self.on_picture, topic=last.topic)
        else:
            self.subscribe(Probe, self.on_probe, topic=last.topic)

    def on_probe(self, probe: Probe) -> None:
        """Record the message."""
        self.handle(probe.number, probe.stamp_ns)

    def on_picture(self, picture: Picture) -> None:
        """Record the message. Read the clock first: with cold caches, it takes 25 µs to find the stamp."""
        now_ns = time.monotonic_ns()
        stamp_ns = picture.stamp_ns or int(picture.data[:8].view(np.int64)[0])
        self.handle(picture.number, stamp_ns, now_ns)


class PipelineStage(Module):
    """Sends a small message for each one it receives."""

    work_file: Path = setting(REQUIRED, "the work, as JSON")
    index: int = setting(0, "number of stages before this one", minimum=0)

    def setup(self) -> None:
        """Subscribe to what the one before sends."""
        work = Work.load(self.work_file)
        source, self.target = work.hop(self.index), work.hop(self.index + 1)
        if source.has_array:
            self.subscribe(Picture, self.on_picture, topic=source.topic)
        else:
            self.subscribe(Probe, self.on_probe, topic=source.topic)

    def on_picture(self, picture: Picture) -> None:
        """Send a message for a picture."""
        self.pass_on(picture.number)

    def on_probe(self, probe: Probe) -> None:
        """Send a message for that of the stage before."""
        self.pass_on(probe.number)

    def pass_on(self, number: int) -> None:
        """Send a message with the same number."""
        probe = Probe(number=number, stamp_ns=time.monotonic_ns(), x=1.0, y=2.0, z=3.0, yaw=6.0)
        self.publish(probe, topic=self.target.topic)


class PipelineBase(Subscriber):
    """The subscriber behind all stages, which ends the run when it has the last message."""

    def on_probe(self, probe: Probe) -> None:
        """Record the message."""
        if self.handle(probe.number, probe.stamp_ns):
            self.stop()


class PipelineCamera(Publisher):
    """The publisher before all stages, which goes on running until the base ends the run."""

    def tick(self) -> None:
        """Publish the next picture."""
        if not self.ended:
            self.publish_next()


class Server(Module):
    """Replies with what it is asked."""

    def setup(self) -> None:
        """Serve."""
        self.serve(Ask, self.on_ask)

    def on_ask(self, ask: Ask) -> Answer:
        """Reply."""
        return Answer(number=ask.number, stamp_ns=ask.stamp_ns, x=ask.x, y=ask.y, z=ask.z)


class Client(Publisher):
    """Calls, and records when it gets each reply."""

    def setup(self) -> None:
        """Prepare the record of the replies."""
        super().setup()
        self.handle = Receipts(self.work, 0).handle
        self.waiting = 0

    def tick(self) -> None:
        """Call; end when all replies are there."""
        if not self.ended:
            super().tick()
        elif not self.waiting:
            self.stop()

    def publish_next(self) -> None:
        """Stamp and send the next request."""
        number = next(self.numbers, None)
        if number is not None and number != END:
            self.waiting += 1
            self.call(
                Ask(number=number, stamp_ns=time.monotonic_ns(), x=1.0, y=2.0, z=3.0, roll=4.0, pitch=5.0),
                self.on_answer,
            )

    def on_answer(self, answer: Answer) -> None:
        """Record the reply."""
        self.handle(answer.number, answer.stamp_ns)
        self.waiting -= 1
