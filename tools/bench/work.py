"""Describes what to measure: one publisher, its subscribers, and a number of messages."""

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

PROBE_BYTES = 64
"""Size of a `Probe`, which has two int64 and six float64."""
END = -(1 << 40)
"""Number of the message that ends the work. Messages with other negative numbers are the warm-up."""


@dataclass(frozen=True)
class Work:
    """One piece of work: what a publisher sends and its subscribers receive.

    Attributes:
        topic: a name that no other work on this machine has.
        folder: folder for records and other output of the processes.
        size_bytes: size of the payload. Up to `PROBE_BYTES` it is a `Probe`; larger messages have an array.
        count: number of measured messages, which are numbered from 0.
        rate_hz: rate of publishing; 0: as fast as possible.
        subscribers: number of processes that receive every message.
        warm_up: number of messages that each subscriber receives before the measured ones.
        in_place: whether arrays are filled in the published memory, rather than copied from another array.
        lossless: whether the publisher waits for slow subscribers, if the transport can do that.
        pause_s: with a count of 0, the time for which all processes wait idle.
        cpus: processors on which all processes run; (): all.
        realtime_priority: of all processes under SCHED_FIFO; 0: they run under the usual scheduler.
        stages: number of processes between publisher and subscriber. Each sends a `Probe` for each message.
    """

    topic: str
    folder: Path
    size_bytes: int = PROBE_BYTES
    count: int = 1000
    rate_hz: float = 1000.0
    subscribers: int = 1
    warm_up: int = 100
    in_place: bool = False
    lossless: bool = False
    pause_s: float = 0.0
    cpus: tuple[int, ...] = ()
    realtime_priority: int = 0
    stages: int = 0

    @property
    def has_array(self) -> bool:
        """Whether the message has an array."""
        return self.size_bytes > PROBE_BYTES

    def at(self, topic: str, folder: Path) -> "Work":
        """Return the same work with another topic and folder."""
        return replace(self, topic=topic, folder=folder)

    def hop(self, number: int) -> "Work":
        """Return the work between two processes: 0 is the publisher's, the others are those of stages."""
        if not self.stages:
            return self
        size_bytes = PROBE_BYTES if number else self.size_bytes
        return replace(self, topic=f"{self.topic}-{number}", size_bytes=size_bytes)

    def save(self, file: Path) -> None:
        """Write the work to a file, for the processes that do it."""
        file.write_text(json.dumps(asdict(self) | {"folder": str(self.folder)}))

    @classmethod
    def load(cls, file: Path) -> "Work":
        """Read a file written by `save`."""
        fields: dict[str, Any] = json.loads(file.read_text())
        return cls(**fields | {"folder": Path(fields["folder"])})
