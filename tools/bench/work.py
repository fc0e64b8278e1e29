"""What is to be measured: one publisher, some subscribers, a number of messages."""

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

PROBE_BYTES = 64
"""Size of a `Probe`: two int64 and six float64."""
END = -(1 << 40)
"""Number of the message that ends the work; the other negative ones warm up."""


@dataclass(frozen=True)
class Work:
    """One publisher and some subscribers.

    Attributes:
        topic: a name that no other work on this machine has.
        folder: for records and whatever the processes write.
        size_bytes: payload; up to `PROBE_BYTES` a typed message of that size, beyond it one with an array.
        count: messages measured, numbered from 0.
        rate_hz: of publishing; 0: as fast as it goes.
        subscribers: how many processes get every message.
        warm_up: messages that each subscriber gets before those that are measured.
        in_place: arrays are filled in the memory that is published, not copied from an existing array.
        lossless: the publisher shall wait for slow subscribers if it can be told to.
        settle_s: how long Robbie's publisher waits before it begins.
        pause_s: with a count of 0, how long all processes wait for messages that do not come.
        cpus: processors on which all processes run; (): all.
        realtime_priority: of all processes under SCHED_FIFO; 0: they run under the usual scheduler.
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
    settle_s: float = 0.0
    pause_s: float = 0.0
    cpus: tuple[int, ...] = ()
    realtime_priority: int = 0

    @property
    def has_array(self) -> bool:
        """Whether the message is one with an array."""
        return self.size_bytes > PROBE_BYTES

    def at(self, topic: str, folder: Path) -> "Work":
        """Return the same work elsewhere."""
        return replace(self, topic=topic, folder=folder)

    def save(self, file: Path) -> None:
        """Write it for a process that will do it."""
        file.write_text(json.dumps(asdict(self) | {"folder": str(self.folder)}))

    @classmethod
    def load(cls, file: Path) -> "Work":
        """Read what `save` has written."""
        fields: dict[str, Any] = json.loads(file.read_text())
        return cls(**fields | {"folder": Path(fields["folder"])})
