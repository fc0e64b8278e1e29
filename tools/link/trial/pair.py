"""Two robots on two hosts with a bad network between them: `robot`, and the `laptop` that drives it."""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import yaml

from robbie_mp.messages import LinkState
from tools.journal import read_journal
from tools.link.trial.modules import LET_GO_FILE, RECEIVED, SENT
from tools.robot import Robot, RobotTrouble
from tools.test_network.network import Network

PORT = 7447
PERIODS_S = {"urgent": 0.5, "state": 0.1, "reliable": 0.02, "bulk": 0.06}
"""With the size of the bulk messages, about 27 Mbit/s: more than any condition carries."""
SEEN_S = {"camera": 1 / 15, "map": 1.0, "state": 0.05}
"""The periods of the messages that the operator of a pair sees."""
MODULES = "tools.link.trial.modules:"
RESTART = {"policy": "always", "max_restarts": 1_000_000, "backoff_s": 0.05, "backoff_cap_s": 0.1}


class Received:
    """A message that was received.

    Attributes:
        number: of the sender.
        sent_s: when it was sent, monotonic clock.
        at_s: when it was received.
        valid_s: for a drive command, the time for which it is obeyed.
    """

    def __init__(self, words: list[str]):
        number, sent_ns, *valid_ns, at_ns = map(int, words)
        self.number, self.sent_s, self.at_s = number, sent_ns * 1e-9, at_ns * 1e-9
        self.valid_s = valid_ns[0] * 1e-9 if valid_ns else 0.0

    @property
    def latency_s(self) -> float:
        """The time from sending to receiving."""
        return self.at_s - self.sent_s


class Pair:
    """The two runs.

    Args:
        robot: the run on the host `robot`.
        laptop: that on the host `laptop`.
        network: the network between them.
    """

    def __init__(self, robot: Robot, laptop: Robot, network: Network):
        self.robot, self.laptop, self.network = robot, laptop, network

    def received(self, topic: str) -> list[Received]:
        """Return the messages of a topic that were received, in this order."""
        run, module = (self.robot, "base") if topic == "manual" else (self.laptop, "listener")
        return [Received(line[2:]) for line in _lines(run, module) if line[:2] == [RECEIVED, topic]]

    def sent(self, topic: str) -> dict[int, float]:
        """Return the times (s) at which the messages of a topic were sent, by number."""
        run, module = (self.laptop, "pilot") if topic == "manual" else (self.robot, "speaker")
        lines = (line for line in _lines(run, module) if line[:2] == [SENT, topic])
        return {int(line[2]): int(line[3]) * 1e-9 for line in lines}

    def state(self, run: Robot) -> LinkState | None:
        """Return the last state of a robot's link; None if there is none yet."""
        file = run.output / "link_state"
        return LinkState.decode(file.read_bytes()) if file.exists() else None

    def let_go(self, now: bool) -> None:
        """Have the operator let go of the controls, or hold them again."""
        file = self.laptop.output / LET_GO_FILE
        if now:
            file.touch()
        else:
            file.unlink()

    def wait_until_linked(self, topics: Sequence[str] = ("manual", "state")) -> None:
        """Wait until new messages of these topics arrive."""
        since_s = time.monotonic()

        def has_come() -> bool:
            newest = (self.received(topic)[-1:] for topic in topics)
            return all(found and found[0].sent_s > since_s for found in newest)

        self.robot.wait_for(has_come, "nothing comes over the link")


def _lines(run: Robot, module: str) -> Iterator[list[str]]:
    return read_journal(run.output / f"{module}.journal")


@contextmanager
def linked_pair(folder: Path, network: Network) -> Iterator[Pair]:
    """Start both robots in a folder, and wait until they are linked.

    Raises:
        RobotTrouble: they do not start, or do not find each other.
    """
    sent = {topic: [f"Probe {topic}"] for topic in PERIODS_S}
    speaker = {"class": f"{MODULES}Speaker", "settings": {"periods_s": PERIODS_S}}
    with _pair(folder, network, {"send": sent, "state_hz": 100.0}, speaker, "Listener") as pair:
        yield pair


@contextmanager
def operated_pair(folder: Path, network: Network) -> Iterator[Pair]:
    """Start a robot with a camera and a map, and the laptop of its operator, as `linked_pair` does."""
    send = {"bulk": ["Image camera", "OccupancyGrid map"], "state": ["Odometry state"]}
    scout = {"class": f"{MODULES}Scout", "settings": {"periods_s": SEEN_S}}
    with _pair(folder, network, {"send": send, "jpeg_quality": 60}, scout, "Viewer") as pair:
        yield pair


@contextmanager
def _pair(
    folder: Path, network: Network, settings: dict[str, Any], speaker: dict[str, Any], listener: str
) -> Iterator[Pair]:
    robot, laptop = network.host("robot"), network.host("laptop")
    address = f"tcp/{robot.address}:{PORT}"
    link: dict[str, Any] = {"robot": "robot", "listen": [address], **settings,
                            "accept": {"laptop": ["DriveCommand manual"]}}  # fmt: skip
    _write(folder, "robot", link, {"base": {"class": f"{MODULES}Base"}, "speaker": speaker})
    link = {"robot": "laptop", "listen": [], "connect": [address],
            "send": {"command": ["DriveCommand manual"]}, "accept": {"robot": ["*"]}}  # fmt: skip
    _write(
        folder,
        "laptop",
        link,
        {"listener": {"class": f"{MODULES}{listener}"}, "pilot": {"class": f"{MODULES}Pilot"}},
    )
    with ExitStack() as started:
        runs = []
        for host in (robot, laptop):
            run = Robot(folder / host.name, folder, host.name, on_host=host.command())
            started.callback(run.close)
            runs.append(run)
        for run in runs:
            run.wait_until_running()
        pair = Pair(runs[0], runs[1], network)
        pair.wait_until_linked()
        yield pair
        for run in reversed(runs):
            if not run.is_up:
                raise RobotTrouble(f"a run has ended by itself: {run.said()[-2000:]}")
            run.stop()


def _write(folder: Path, name: str, link: dict[str, Any], modules: dict[str, Any]) -> None:
    (folder / "profiles").mkdir(exist_ok=True)
    described = {
        **modules,
        "bookkeeper": {"class": f"{MODULES}Bookkeeper"},
        "link": {"class": "robbie_mp.connect.link.module:Link", "settings": link, "restart": RESTART},
    }
    text = yaml.safe_dump({"modules": described}, sort_keys=False)
    (folder / "profiles" / f"{name}.yaml").write_text(text)
