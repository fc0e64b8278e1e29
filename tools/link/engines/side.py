"""One side over another engine: `python -m tools.link.engines.side ENGINE FOLDER OWN OTHER SENDS`.

It sends the numbered messages that a `LinkedRobot` sends, and keeps the same journals. What users of any
engine would do is here: the newest alone waits where the newest counts, and the receiver drops what is too
old or overtaken.
"""

import importlib
import json
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

import numpy as np

from tools.journal import Journal

KEPT = {"urgent": 64, "command": 1, "state": 1, "reliable": 1000, "bulk": 1}
"""Messages of each class that may wait. The order is that of their importance."""
NEWEST_COUNTS = ("command", "state")
COMMAND_EXPIRES_S = 0.3
"""As in a link. Both hosts have the same clock here, so no engine has to know the other one's."""
BULK_BYTES, OTHER_BYTES = 200_000, 100
STEP_S = 0.005
HEAD = struct.Struct("<Qq")

OnMessage = Callable[[str, bytes], None]


class Engine(Protocol):
    """Carries messages of all classes to the other side. `ENGINE` of each module here is one.

    Args:
        own: the address of this host.
        other: that of the other one.
        sends: the classes that this side sends. The side that sends bulk listens, the other one connects.
        on_message: called in any thread with a message that has arrived, and its class.
    """

    def __init__(self, own: str, other: str, sends: list[str], on_message: OnMessage) -> None: ...

    def wait_for_room(self, topic: str) -> None:
        """Wait until a message of a class would go at once, so that the newest is chosen late."""

    def send(self, topic: str, data: bytes) -> None:
        """Send a message, or wait."""


class ArrivalJournal:
    """Writes down what arrives. Lines of its journal: G TOPIC NUMBER SENT_NS TIME."""

    def __init__(self, folder: Path):
        self._journal = Journal(folder / "listener.journal")
        self._newest: dict[str, int] = {}
        self._lock = threading.Lock()

    def take(self, topic: str, data: bytes) -> None:
        """Write a message down, unless it is too old."""
        number, sent_ns = HEAD.unpack_from(data)
        with self._lock:
            if topic in NEWEST_COUNTS and number <= self._newest.get(topic, 0):
                return
            if topic == "command" and time.monotonic_ns() - sent_ns > COMMAND_EXPIRES_S * 1e9:
                return
            self._newest[topic] = number
            self._journal.note("G", topic, number, sent_ns)


class ClassSender:
    """Sends the messages of one class, in a thread of its own."""

    def __init__(self, engine: Engine, topic: str):
        self._engine, self._topic = engine, topic
        self._waiting: deque[bytes] = deque(maxlen=KEPT[topic])
        self._has_some = threading.Semaphore(0)
        threading.Thread(target=self._send, name=topic, daemon=True).start()

    def offer(self, data: bytes) -> None:
        """Send a message as soon as the engine has room; if too many wait, the oldest is dropped."""
        is_full = len(self._waiting) == self._waiting.maxlen
        self._waiting.append(data)
        if not is_full:
            self._has_some.release()

    def _send(self) -> None:
        while True:
            self._has_some.acquire()
            self._engine.wait_for_room(self._topic)
            self._engine.send(self._topic, self._waiting.popleft())


def speak(engine: Engine, folder: Path, periods_s: Mapping[str, float]) -> None:
    """Send numbered messages until the process is killed. Lines of its journal: P TOPIC NUMBER TIME."""
    journal = Journal(folder / "speaker.journal")
    noise = np.random.default_rng(1).integers(0, 255, BULK_BYTES, np.uint8).tobytes()
    outboxes = {topic: ClassSender(engine, topic) for topic in periods_s}
    numbers = dict.fromkeys(periods_s, 0)
    due_s = dict.fromkeys(periods_s, time.monotonic())
    while True:
        now_s = time.monotonic()
        for topic, period_s in periods_s.items():
            if now_s >= due_s[topic]:
                due_s[topic] = max(now_s, due_s[topic] + period_s)
                numbers[topic] += 1
                journal.note("P", topic, numbers[topic])
                payload = noise if topic == "bulk" else noise[:OTHER_BYTES]
                outboxes[topic].offer(HEAD.pack(numbers[topic], time.monotonic_ns()) + payload)
        time.sleep(STEP_S)


def main(name: str, folder: Path, own: str, other: str, sends: str) -> None:
    """Run one side until it is killed."""
    periods_s: dict[str, float] = json.loads(sends)
    module = importlib.import_module(f"tools.link.engines.{name}")
    engine: Engine = module.ENGINE(own, other, list(periods_s), ArrivalJournal(folder).take)
    speak(engine, folder, periods_s)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), *sys.argv[3:])
