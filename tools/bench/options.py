"""What the command line says, and who is measured."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from tools.bench.contender import PeerContender
from tools.bench.robbie import RobbieContender
from tools.bench.rounds import Series
from tools.bench.worker import load_peer

PEERS = ("iceoryx2", "ecal", "lcm", "zeromq", "zenoh", "cyclonedds", "dora", "rospy", "queue")
QUICK_BUDGET_S = 22.0
IN_PLACE = "in place"
WATCHED = "robbie-top"


@dataclass(frozen=True)
class Options:
    """How to measure.

    Attributes:
        quick: fewer messages and rounds; below 30 s for each benchmark.
        rounds: instead of the benchmark's own number of rounds; 0: its own.
        count: instead of the benchmark's own number of messages; 0: its own.
        modules: instead of the largest number of modules or subscribers; 0: the benchmark's own.
        seconds: instead of the time for which processor time is measured; 0: the benchmark's own.
        only: names of those measured; () for all.
        with_top: measure Robbie with `robbie top` looking at it as well.
        variants: profiles of further Robbies by name, as `core` and `module` keys.
    """

    quick: bool = False
    rounds: int = 0
    count: int = 0
    modules: int = 0
    seconds: float = 0.0
    only: tuple[str, ...] = ()
    with_top: bool = False
    variants: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def budget_s(self) -> float | None:
        """After what time nothing more is started."""
        return QUICK_BUDGET_S if self.quick else None

    def messages(self, usual: int, quick: int) -> int:
        """How many messages in each round."""
        return self.count or (quick if self.quick else usual)

    def times(self, usual: int, quick: int) -> int:
        """How many rounds."""
        return self.rounds or (quick if self.quick else usual)

    def window_s(self, usual: float, quick: float) -> float:
        """How long to measure processor time."""
        return self.seconds or (quick if self.quick else usual)

    def chosen(self, series: list[Series]) -> list[Series]:
        """Leave out those that the command line did not ask for."""
        return [one for one in series if not self.only or one.contender.name in self.only]

    def robbies(self) -> list[RobbieContender]:
        """Robbie, and what the command line adds to it."""
        found = [RobbieContender()]
        if self.with_top:
            found.append(RobbieContender(WATCHED, "Robbie-MP watched by robbie top", with_top=True))
        for name, profile in self.variants.items():
            core, module = profile.get("core"), profile.get("module")
            found.append(RobbieContender(name, f"Robbie-MP {name}", core, module))
        return found


def peer(name: str) -> PeerContender:
    """Return a floor or peer by the name of its file."""
    return PeerContender(name, load_peer(name))


def peers() -> list[PeerContender]:
    """Return all peers, without the floors."""
    return [peer(name) for name in PEERS]


def read_variant(text: str) -> tuple[str, dict[str, Any]]:
    """Read NAME=FILE.yaml."""
    name, _, file = text.partition("=")
    return name, yaml.safe_load(Path(file).read_text())
