"""Two sides of a link, robots or programs with another engine, which exchange messages of all classes."""

import json
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from robbie_mp.connect.link.keys import Keys
from robbie_mp.messages import LinkState
from tools.journal import read_journal
from tools.link.modules import PAUSE_FILE, STATE_FILE
from tools.robot import COMMAND, LIMIT_S, OFTEN, POLL_S, REPOSITORY, Robot, RobotTrouble, write_profile
from tools.test_network.network import Host

MODULES = "tools.link.modules:"
OURS, ROUTER, NO_UDP_WAY = "robbie", "router", "no_udp"
WAYS = (OURS, ROUTER, "tls", NO_UDP_WAY)
"""How links reach each other: over TCP and UDP, through a router of Zenoh, encrypted, and without UDP."""
NO_UDP = ("INPUT", "-p", "udp", "-j", "DROP")
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


class LinkSide(ABC):
    """One side of a link, which writes down what it sends and receives."""

    @property
    @abstractmethod
    def folders(self) -> Sequence[Path]:
        """Where its journals are, of all its lives."""

    @abstractmethod
    def wait_until_heard(self, topics: Sequence[str]) -> None:
        """Wait until new messages of these topics arrive."""

    def received(self, topic: str) -> list[Received]:
        """Return the messages of a topic that it received, in this order, in all its lives."""
        return [Received(line[2:]) for line in self._lines("listener") if line[1] == topic]

    def sent(self, topic: str) -> dict[int, float]:
        """Return the times (s) at which it sent the messages of a topic, by number."""
        return {int(line[2]): int(line[3]) * 1e-9 for line in self._lines("speaker") if line[1] == topic}

    def hears(self, topics: Sequence[str], since_s: float) -> bool:
        """Return whether messages of all these topics have arrived that were sent later."""
        newest = (self.received(topic)[-1:] for topic in topics)
        return all(found and found[0].sent_s > since_s for found in newest)

    def _lines(self, module: str) -> Iterator[list[str]]:
        for folder in self.folders:
            yield from read_journal(folder / f"{module}.journal")


class LinkedRobot(LinkSide):
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
    def folders(self) -> Sequence[Path]:
        """Where its journals are, of all its lives."""
        return [life.output for life in self.lives]

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

    def state(self) -> LinkState | None:
        """Return the last state of its link in its present life; None if there is none yet."""
        file = self.run.output / STATE_FILE
        return LinkState.decode(file.read_bytes()) if file.exists() else None

    def wait_until_heard(self, topics: Sequence[str]) -> None:
        """Wait until new messages of these topics arrive."""
        since_s = time.monotonic()
        self.run.wait_for(lambda: self.hears(topics, since_s), "nothing comes over the link", 120.0)


class EngineSide(LinkSide):
    """A process that exchanges the same messages over another engine, without a robot around it.

    Args:
        folder: for its journals and its output.
        engine: a module of `tools.link.engines`.
        own: its host.
        other: the host of the other side.
        sends: for each topic that it sends, the time between two messages.
    """

    def __init__(self, folder: Path, engine: str, own: Host, other: Host, sends: Mapping[str, float]):
        self._folder = folder / own.name
        self._folder.mkdir()
        with (self._folder / "output").open("w") as output:
            self._process = own.popen(
                *(sys.executable, "-m", "tools.link.engines.side", engine, str(self._folder)),
                *(own.address, other.address, json.dumps(dict(sends))),
                cwd=REPOSITORY,
                stdout=output,
                stderr=output,
            )

    @property
    def folders(self) -> Sequence[Path]:
        """Where its journals are."""
        return [self._folder]

    def check(self) -> None:
        """Check that it runs.

        Raises:
            RobotTrouble: it has ended.
        """
        if self._process.poll() is not None:
            raise RobotTrouble(f"it has ended: {(self._folder / 'output').read_text()[-2000:]}")

    def wait_until_heard(self, topics: Sequence[str]) -> None:
        """Wait until new messages of these topics arrive."""
        since_s = time.monotonic()
        while not self.hears(topics, since_s):
            self.check()
            if time.monotonic() - since_s > LIMIT_S:
                raise RobotTrouble(f"nothing comes: {(self._folder / 'output').read_text()[-2000:]}")
            time.sleep(POLL_S)

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait()


def start_router(address: str, on_host: Sequence[str] = ()) -> "subprocess.Popen[bytes]":
    """Start a router of Zenoh that listens at an address; `on_host` as for `LinkedRobot`."""
    command = [*on_host, sys.executable, "-m", "tools.link.router", address]
    return subprocess.Popen(command, cwd=REPOSITORY)


def settings_of(way: str, folder: Path, names: Sequence[str], host: str, port: int) -> list[dict[str, Any]]:
    """Return the settings with which the links of two robots reach each other.

    Args:
        way: one of `WAYS`.
        folder: for their keys.
        names: of the robots; the first one listens, if no router does.
        host: address of the one that listens.
        port: on which it listens.
    """
    address = [f"{'tls' if way == 'tls' else 'tcp'}/{host}:{port}"]
    if way == ROUTER:
        return [{"mode": "client", "listen": [], "connect": address}] * 2
    settings: list[dict[str, Any]] = [{"listen": address}, {"listen": [], "connect": address}]
    if way == "tls":
        keys = [Keys(folder / f"keys-{name}") for name in names]
        for name, own in zip(names, keys, strict=True):
            own.make(name)
        keys[0].trust(keys[1].own().file)
        keys[1].trust(keys[0].own().file)
        settings = [one | {"keys": str(own.folder)} for one, own in zip(settings, keys, strict=True)]
    return settings


@contextmanager
def without_udp(*hosts: Host) -> Iterator[None]:
    """Have the hosts of a test network receive no UDP, as behind a firewall."""
    with ExitStack() as blocked:
        for host in hosts:
            subprocess.run(host.command("iptables", "-A", *NO_UDP), check=True)
            blocked.callback(subprocess.run, host.command("iptables", "-D", *NO_UDP), check=True)
        yield
