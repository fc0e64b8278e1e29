"""Two linked robots, which exchange numbered messages of all classes."""

import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robbie_mp.messages import LinkState
from tools.journal import read_journal
from tools.link.modules import PAUSE_FILE, STATE_FILE
from tools.robot import COMMAND, OFTEN, REPOSITORY, Robot, write_profile

MODULES = "tools.link.modules:"
LINK = "robbie_mp.connect.link.module:Link"


class Received:
    """A message that was received.

    Attributes:
        number: of the sender.
        sent_s: when it was sent, monotonic clock.
        at_s: when it was received.
    """

    def __init__(self, words: Sequence[str]):
        self.number, sent_ns, at_ns = map(int, words)
        self.sent_s, self.at_s = sent_ns * 1e-9, at_ns * 1e-9

    @property
    def latency_s(self) -> float:
        """The time from sending to receiving."""
        return self.at_s - self.sent_s


class LinkedRobot:
    """A robot with a link, which speaks and listens. It may be killed and started again.

    Args:
        folder: workspace of both robots.
        name: of the robot, and of its profile.
        link: settings of its link.
        sends: for each topic that it sends, the time between two messages.
        hears: the topics that it listens to.
        more: further settings of its speaker.
        on_host: the beginning of a command that runs it on another host of a test network.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        link: Mapping[str, Any],
        sends: Mapping[str, float],
        hears: Sequence[str],
        *,
        more: Mapping[str, Any] | None = None,
        on_host: Sequence[str] = (),
    ):
        self._folder, self.name, self._on_host = folder, name, on_host
        self.lives: list[Robot] = []
        speaker = {"periods_s": dict(sends), **(more or {})}
        modules = {
            "listener": {"class": f"{MODULES}Listener", "settings": {"topics": list(hears)}},
            "speaker": {"class": f"{MODULES}Speaker", "settings": speaker},
            "bookkeeper": {"class": f"{MODULES}Bookkeeper"},
            "link": {"class": LINK, "settings": {"robot": name, **link}, "restart": OFTEN},
        }
        write_profile(folder, {"modules": modules}, name)

    @property
    def run(self) -> Robot:
        """Its present run."""
        return self.lives[-1]

    def start(self) -> None:
        """Start a run."""
        own = self._folder / f"{self.name}-{len(self.lives)}"
        self.lives.append(Robot(own, self._folder, self.name, on_host=self._on_host))

    def kill(self) -> None:
        """Kill its supervisor, and with it all its processes."""
        self.run.supervisor.kill()
        self.run.supervisor.wait()
        self.close()
        subprocess.run([*COMMAND, "clean"], env=self.run.environment, capture_output=True, check=False)

    def close(self) -> None:
        """End its present run."""
        self.run.close()

    def pause(self) -> None:
        """Have it send nothing more."""
        (self.run.output / PAUSE_FILE).touch()

    def received(self, topic: str) -> list[Received]:
        """Return the messages of a topic that it received, in this order, in all its lives."""
        return [Received(line[2:]) for line in self._lines("listener") if line[1] == topic]

    def sent(self, topic: str) -> dict[int, float]:
        """Return the times (s) at which it sent the messages of a topic, by number."""
        return {int(line[2]): int(line[3]) * 1e-9 for line in self._lines("speaker") if line[1] == topic}

    def state(self) -> LinkState | None:
        """Return the last state of its link in its present life; None if there is none yet."""
        file = self.run.output / STATE_FILE
        return LinkState.decode(file.read_bytes()) if file.exists() else None

    def wait_until_heard(self, topics: Sequence[str]) -> None:
        """Wait until new messages of these topics arrive."""
        since_s = time.monotonic()

        def has_come() -> bool:
            newest = (self.received(topic)[-1:] for topic in topics)
            return all(found and found[0].sent_s > since_s for found in newest)

        self.run.wait_for(has_come, "nothing comes over the link", 120.0)

    def _lines(self, module: str) -> Iterator[list[str]]:
        for life in self.lives:
            yield from read_journal(life.output / f"{module}.journal")


def start_router(address: str) -> "subprocess.Popen[bytes]":
    """Start a router of Zenoh that listens at an address."""
    return subprocess.Popen([sys.executable, "-m", "tools.link.router", address], cwd=REPOSITORY)
