"""The benchmark `link`: messages from one robot to another, beside plain Zenoh in the same run."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from tools.bench.contender import Contender, Outcome, Trouble, last_words, outcome, work_folder
from tools.bench.messages import MEGABYTE
from tools.bench.options import Options, peer
from tools.bench.peers.zenoh_tcp import free_port
from tools.bench.robbie import LIMIT_S, MODULES, RobbieContender, scheduling_of
from tools.bench.rounds import Series, run_work
from tools.bench.work import Work

LINK = "robbie_mp.connect.link.module:Link"
RELAY = "tools.bench.relay_modules"
SETTLE_S = 3.0
"""Time from the start of the sending robot until it publishes: the links find each other meanwhile."""
STORE_BYTES = 1 << 30


class LinkedRobbie(RobbieContender):
    """Measures two robots: the publisher is in one, the subscriber in the other."""

    def __init__(self, name: str = "robbie-link", title: str = "Robbie-MP over a link") -> None:
        super().__init__(name, title)

    @property
    def how(self) -> str:
        """The set-up, in one line."""
        return "two runs with a link each, tcp, class reliable"

    @property
    def settle_s(self) -> float:
        """Time to wait before publishing."""
        return SETTLE_S

    def run(self, work: Work) -> Outcome:
        """Run both robots until everything has arrived."""
        with work_folder() as (topic, folder):
            here = replace(work.at(topic, folder), settle_s=self.settle_s)
            address = f"tcp/127.0.0.1:{free_port()}"
            modules = self.pair(here)
            subscriber = {"subscriber-0": modules["subscriber-0"], "link": self.receiving(address, here)}
            publisher = {"publisher": modules["publisher"], "link": self.sending(address, here)}
            publisher["publisher"]["class"] = f"{MODULES}:FarPublisher"
            scheduling = scheduling_of(work)
            for name in ("there", "here"):
                (folder / name).mkdir()
            with (
                self.robot(folder / "there", subscriber, scheduling) as there,
                self.robot(folder / "here", publisher, scheduling) as sender,
            ):
                sender.wait_for_end(LIMIT_S)
                if not there.is_up:
                    raise Trouble(last_words(folder / "there" / "stderr"))
            return outcome(here)

    def sending(self, address: str, work: Work) -> dict[str, Any]:
        """Return the link of the robot that publishes."""
        send = {"reliable": [f"* {work.topic}"]}
        store = {"store_bytes": STORE_BYTES, "store_messages": 1_000_000}
        return {
            "class": LINK,
            "settings": {"robot": "here", "listen": [address], "robots": ["there"], "send": send, **store},
        }

    def receiving(self, address: str, work: Work) -> dict[str, Any]:
        """Return the link of the robot that subscribes."""
        return {
            "class": LINK,
            "settings": {"robot": "there", "listen": [], "connect": [address], "accept": {"here": ["*"]}},
        }


class RelayedRobbie(LinkedRobbie):
    """Measures the least that two robots need: in place of the links, modules that put and publish."""

    def __init__(self) -> None:
        super().__init__("robbie-relay", "floor: Robbie-MP over a bare relay")

    @property
    def how(self) -> str:
        """The set-up, in one line."""
        return "two runs with a relay each: a put in one, a publication in the other, plain Zenoh over tcp"

    def sending(self, address: str, work: Work) -> dict[str, Any]:
        """Return the relay of the robot that publishes."""
        return self._relay("Sender", address, work)

    def receiving(self, address: str, work: Work) -> dict[str, Any]:
        """Return the relay of the robot that subscribes."""
        return self._relay("Receiver", address, work)

    def _relay(self, name: str, address: str, work: Work) -> dict[str, Any]:
        settings = {"address": address, "topic": work.topic, "has_array": work.has_array}
        return {"class": f"{RELAY}:{name}", "settings": settings}


def link(options: Options) -> list[dict[str, Any]]:
    """Measure 64 bytes at 200 Hz, and 1 MB flat out."""
    small = Work("", Path(), count=options.messages(1000, 300), rate_hz=200.0, warm_up=100)
    few = max(1, options.messages(1000, 300) // 10)
    large = Work("", Path(), MEGABYTE, count=few, rate_hz=0.0, warm_up=5)
    plain: list[Contender] = [peer("zenoh_tcp"), peer("zenoh_as_link"), RelayedRobbie(), LinkedRobbie()]
    results = []
    for title, kind, work, measured in (
        ("64 bytes, 200 Hz, from one robot to another", "latency", small, [RobbieContender(), *plain]),
        ("1 MB flat out, from one robot to another", "throughput", large, plain),
    ):
        series = options.chosen([Series(one) for one in measured])
        rows = run_work(series, work, options.times(5, 2), options.budget_s)
        results.append(
            {"benchmark": "link", "title": title, "kind": kind, "reference": "zenoh_tcp", "contenders": rows}
        )
    return results
