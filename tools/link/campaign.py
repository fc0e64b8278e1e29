"""Kills the links of two robots at random, and judges what arrived.

    python -m tools.link.campaign --kills 200 --seed 1 [--robots] [--router] [--json]
    python -m tools.link.campaign --kills 40 --over "2 % loss" --way tls

Robot `red` sends messages of each class, robot `blue` receives them. At random moments a link is killed; with
`--router`, also the router of Zenoh between them; with `--robots`, also whole robots. With `--over`, they are
on two hosts, with a network of the trial between them; that needs root.
"""

import argparse
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from robbie_mp.messages import LinkChannel, LinkState
from tools.link.pair import (
    NO_UDP_WAY,
    OURS,
    ROUTER,
    WAYS,
    LinkedRobot,
    settings_of,
    start_router,
    without_udp,
)
from tools.link.trial import TRIALS
from tools.robot import free_port
from tools.test_network.network import Network

CLASSES = ("command", "state", "reliable", "bulk", "urgent")
PERIOD_S, BULK_BYTES = 0.02, 20_000
TITLES = [one.title for one in TRIALS if one.then is None and not one.cut_s]

ROBOT_SHARE = 0.1
"""Share of the kills that kill a whole robot."""
ROUTER_SHARE = 0.2
"""And one that kills the router, if there is one."""
FLOW_SHARE = 0.5
"""Share of the kills after which messages must flow again; the others may hit what is just starting."""
MAX_PAUSE_S = 1.0
DEATH_MESSAGES = 100
"""Messages of each topic that a killed receiver may have taken, but not yet given to its modules: 2 s."""


@dataclass
class CampaignReport:
    """The result of a campaign."""

    links_killed: int = 0
    robots_killed: int = 0
    routers_killed: int = 0
    duration_s: float = 0.0
    sent: dict[str, int] = field(default_factory=dict)
    received: dict[str, int] = field(default_factory=dict)
    not_taken: dict[str, int] = field(default_factory=dict)
    """Messages that red's core could not give to the link, because it was dead for too long."""
    counts: dict[str, str] = field(default_factory=dict)
    violations: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        lines = [
            f"{self.links_killed} links, {self.robots_killed} robots and {self.routers_killed} routers "
            f"killed in {self.duration_s:.0f} s",
            *(
                f"{one}: {self.counts.get(one, '-')}; not taken: {self.not_taken.get(one, 0)}"
                for one in CLASSES
            ),
            f"{len(self.violations)} violations",
            *self.violations,
        ]
        return "\n".join(lines)


@dataclass(frozen=True)
class Epoch:
    """One life of the robot that sends.

    Attributes:
        first: the numbers of its messages begin here.
        last: and end here.
        counts: sent, received and not received of each topic, as its link last told them.
        links_killed: in this life.
        receivers_killed: in this life.
    """

    first: int
    last: int
    counts: Mapping[str, tuple[int, int, int]]
    links_killed: int
    receivers_killed: int


class Campaign:
    """Two robots whose links, and whole runs, are killed at random.

    Args:
        folder: an empty folder.
        seed: of the moments and the victims.
        kills_robots: whether whole robots are killed, too.
        way: how the links reach each other, one of `WAYS`; a router is killed, too.
        network: has the hosts `red` and `blue`; None: all runs on this one.
    """

    def __init__(
        self,
        folder: Path,
        seed: int,
        *,
        kills_robots: bool = False,
        way: str = OURS,
        network: Network | None = None,
    ):
        host, on_blue = "127.0.0.1", list[str]()
        self._on_red = list[str]()
        if network is not None:
            red, blue = network.host("red"), network.host("blue")
            host, self._on_red, on_blue = red.address, red.command(), blue.command()
        port = free_port()
        self._address = f"tcp/{host}:{port}"
        self._router: subprocess.Popen[bytes] | None = None
        self._has_router, self._kills_robots = way == ROUTER, kills_robots
        self._random = random.Random(seed)
        ways = settings_of(way, folder, ("red", "blue"), host, port)
        common: dict[str, Any] = {"state_hz": 1000.0, "accept": {"*": ["*"]}}
        send = {one: [f"Probe {one}"] for one in CLASSES}
        link = {**common, **ways[0], "robots": ["blue"], "send": send, "command_expires_s": 2.0}
        sends, more = dict.fromkeys(CLASSES, PERIOD_S), {"bulk_bytes": BULK_BYTES}
        self.red = LinkedRobot(folder, "red", link, sends, (), more=more, on_host=self._on_red)
        self.blue = LinkedRobot(folder, "blue", common | ways[1], {}, CLASSES, on_host=on_blue)
        self.report = CampaignReport()
        self._epochs: list[Epoch] = []
        """Those of the sender's lives that are over."""
        self._first = 1
        self._links_killed = self._receivers_killed = 0
        """In the sender's present life."""

    def play(self, kills: int) -> CampaignReport:
        """Play the campaign.

        Args:
            kills: how many.
        """
        began_s, report = time.monotonic(), self.report
        try:
            self._start_router()
            for robot in (self.red, self.blue):
                robot.start()
            self.blue.wait_until_heard(["urgent"])
            while report.links_killed + report.robots_killed + report.routers_killed < kills:
                self._kill()
                if self._random.random() < FLOW_SHARE:
                    self.blue.wait_until_heard(["urgent"])
                time.sleep(self._random.uniform(0.0, MAX_PAUSE_S))
            self.blue.wait_until_heard(["urgent"])
            self._come_to_rest()
        finally:
            self._stop()
        report.duration_s = time.monotonic() - began_s
        self._judge()
        return report

    def _start_router(self) -> None:
        if self._has_router:
            self._kill_router()
            self._router = start_router(self._address, self._on_red)

    def _kill_router(self) -> None:
        if self._router is not None:
            self._router.kill()
            self._router.wait()

    def _stop(self) -> None:
        for robot in (self.red, self.blue):
            if robot.lives:
                if robot.run.is_up:
                    robot.run.stop()
                robot.close()
        self._kill_router()

    def _kill(self) -> None:
        report = self.report
        if self._has_router and self._random.random() < ROUTER_SHARE:
            self._start_router()
            report.routers_killed += 1
            return
        robot = self._random.choice([self.red, self.blue])
        if self._kills_robots and self._random.random() < ROBOT_SHARE:
            robot.kill()
            if robot is self.red:
                self._close_epoch()
            else:
                self._receivers_killed += 1
            robot.start()
            report.robots_killed += 1
        elif (robot.run.observer or robot.run.attach()) and self._kill_link(robot):
            report.links_killed += 1
            self._links_killed += 1

    def _kill_link(self, robot: LinkedRobot) -> bool:
        pid = robot.run.figures()["link"].pid
        return bool(pid) and robot.run.send(pid, signal.SIGKILL)

    def _close_epoch(self) -> None:
        """Keep the counts of the sender, which has been killed: its next life begins with new ones."""
        last = max(max(self.red.sent(one), default=0) for one in CLASSES)
        state = self.red.state()
        counts = counts_of(state) if state is not None else {}
        self._epochs.append(Epoch(self._first, last, counts, self._links_killed, self._receivers_killed))
        self._first, self._links_killed, self._receivers_killed = last + 1, 0, 0

    def _come_to_rest(self) -> None:
        """Have red send nothing more, and wait until nothing is under way."""
        self.red.pause()
        last: LinkState | None = None

        def is_at_rest() -> bool:
            nonlocal last
            before, last = last, self.red.state()
            time.sleep(1.5)
            return (
                before is not None
                and last is not None
                and before.stamp != last.stamp
                and before.channels == last.channels
                and all(one.under_way == 0 for one in last.channels)
                and len({one.topic for one in last.channels} & set(CLASSES)) == len(CLASSES)
            )

        self.red.run.wait_for(is_at_rest, "messages are still under way", 120.0)
        counts = self.red.run.figures()["link"].subscriptions
        self.report.not_taken = {one.topic: one.dropped + one.lost for one in counts}

    def _judge(self) -> None:
        state = self.red.state()
        assert state is not None
        sent = {one: list(self.red.sent(one)) for one in CLASSES}
        received = {one: [each.number for each in self.blue.received(one)] for one in CLASSES}
        self.report.sent = {one: len(numbers) for one, numbers in sent.items()}
        self.report.received = {one: len(numbers) for one, numbers in received.items()}
        self.report.counts = {one.topic: describe(one) for one in state.channels if one.topic in CLASSES}
        self.report.violations = judge(sent, received, {}, {}, 0)
        for epoch in self._epochs:
            self.report.violations += judge_closed(sent, received, epoch)
        self.report.violations += judge(
            since(sent, self._first),
            since(received, self._first),
            counts_of(state),
            self.report.not_taken,
            self._links_killed,
            self._receivers_killed * DEATH_MESSAGES,
        )


def counts_of(state: LinkState) -> dict[str, tuple[int, int, int]]:
    """Return sent, received and not received of each topic."""
    return {
        one.topic: (one.sent, one.received, one.replaced + one.dropped + one.lost)
        for one in state.channels
        if one.is_sent
    }


def describe(channel: LinkChannel) -> str:
    """Return the counts of a channel as text."""
    return (
        f"sent {channel.sent} = received {channel.received} + replaced {channel.replaced} + dropped "
        f"{channel.dropped} + lost {channel.lost} + under way {channel.under_way}"
    )


def judge(
    sent: Mapping[str, Sequence[int]],
    received: Mapping[str, Sequence[int]],
    counts: Mapping[str, tuple[int, int, int]],
    not_taken: Mapping[str, int],
    kills: int,
    excused: int = 0,
) -> list[str]:
    """Return what was violated.

    A link that is killed between taking a message from the bus and counting it leaves one message that the
    core counts as lost in its handler; one that is killed between publishing and counting leaves one that was
    received and not counted. So each kill makes a topic's counts uncertain by at most one message.

    Args:
        sent: numbers that red published, by topic.
        received: numbers that blue received.
        counts: sent, received and not received by the counts of red's link; empty: they are not judged.
        not_taken: messages that red's core could not give to the link, by the core's own count.
        kills: links that were killed.
        excused: messages of each topic that killed receivers may have taken with them.
    """
    violations: list[str] = []
    for topic, numbers in received.items():
        if len(set(numbers)) != len(numbers):
            violations.append(f"{topic}: {len(numbers) - len(set(numbers))} duplicates")
        if list(numbers) != sorted(numbers):
            violations.append(f"{topic}: not in order")
        if not set(numbers) <= set(sent[topic]):
            violations.append(f"{topic}: received what was never sent")
        if topic not in counts:
            continue
        counted, arrived, missing = counts[topic]
        if counted != arrived + missing:
            violations.append(f"{topic}: {counted} sent, but {arrived} + {missing} accounted for")
        if not -kills <= arrived - len(numbers) <= kills + excused:
            violations.append(f"{topic}: {len(numbers)} received, but {arrived} in the counts")
        counted_missing = missing + not_taken.get(topic, 0)
        if len(sent[topic]) - len(numbers) > counted_missing + 2 * kills + excused:
            violations.append(
                f"{topic}: {len(sent[topic]) - len(numbers)} missing, but {counted_missing} counted"
            )
    return violations


def since(journals: Mapping[str, Sequence[int]], first: int, last: int | None = None) -> dict[str, list[int]]:
    """Return the numbers of each topic from one to another, both included."""
    return {
        topic: [one for one in numbers if first <= one and (last is None or one <= last)]
        for topic, numbers in journals.items()
    }


def judge_closed(
    sent: Mapping[str, Sequence[int]], received: Mapping[str, Sequence[int]], epoch: Epoch
) -> list[str]:
    """Return where more is missing of a killed sender's messages than its last counts explain.

    What it sent after it last told its counts, and what was under way then, is in doubt: nobody counts it.

    Args:
        sent: numbers that red published, by topic, in all its lives.
        received: numbers that blue received.
        epoch: the life of the sender that is judged.
    """
    violations: list[str] = []
    all_sent, all_received = (since(one, epoch.first, epoch.last) for one in (sent, received))
    for topic, (counted, arrived, missing) in epoch.counts.items():
        if topic not in all_sent:
            continue
        gone = len(all_sent[topic]) - len(all_received[topic])
        untold = max(0, len(all_sent[topic]) - counted)
        under_way = counted - arrived - missing
        excused = 2 * epoch.links_killed + DEATH_MESSAGES * epoch.receivers_killed
        if gone > missing + untold + under_way + excused:
            violations.append(
                f"{topic}, {epoch.first} to {epoch.last}: {gone} missing, but {missing} counted, {under_way} "
                f"under way, and {untold} sent since the counts were told"
            )
    return violations


@contextmanager
def bad_network(title: str, way: str) -> Iterator[Network]:
    """Make a network of the trial between `red` and `blue`."""
    (trial,) = (one for one in TRIALS if one.title == title)
    with Network("red", "blue") as network, ExitStack() as changes:
        network.set(trial.conditions)
        if way == NO_UDP_WAY:
            changes.enter_context(without_udp(network.host("red"), network.host("blue")))
        if trial.flapping_s is not None:
            changes.enter_context(network.flapping(*trial.flapping_s))
        yield network


def main() -> int:
    """Play a campaign, print its report; return 1 if something was violated."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.link.campaign",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robots", action="store_true", help="kill whole robots, too")
    parser.add_argument("--router", action="store_true", help="link through a router, and kill it, too")
    parser.add_argument("--way", choices=WAYS, default=OURS, help="how the links reach each other")
    parser.add_argument("--over", metavar="TITLE", choices=TITLES, help="a network of the trial between them")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    way = ROUTER if arguments.router else arguments.way
    if way == NO_UDP_WAY and arguments.over is None:
        parser.error("only a network of the trial can carry no UDP: use --over")
    with ExitStack() as started:
        folder = Path(started.enter_context(tempfile.TemporaryDirectory(prefix="link-campaign-")))
        network = started.enter_context(bad_network(arguments.over, way)) if arguments.over else None
        campaign = Campaign(folder, arguments.seed, kills_robots=arguments.robots, way=way, network=network)
        report = campaign.play(arguments.kills)
    print(json.dumps(asdict(report), indent=2) if arguments.json else report)
    return 1 if report.violations else 0


if __name__ == "__main__":
    sys.exit(main())
