"""The options of the command line, and the contenders that they choose."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from tools.bench.contender import PeerContender
from tools.bench.robbie import RobbieContender
from tools.bench.rounds import Series, Watched, unwatched
from tools.bench.worker import load_peer

PEERS = ("iceoryx2", "lcm", "zeromq", "zenoh", "cyclonedds", "rclpy", "dora")
QUICK_BUDGET_S = 22.0
IN_PLACE = "in place"


@dataclass(frozen=True)
class Options:
    """The options of a measurement. 0 leaves a number at the default of each benchmark.

    Attributes:
        quick: use fewer messages and rounds, so that each benchmark takes less than 30 s.
        rounds: number of rounds.
        count: number of messages in each round.
        modules: maximum number of modules or subscribers.
        seconds: time for which processor time is measured.
        only: names of the contenders to measure; () for all.
        watched: calls what measures; see `QuietMachine`.
        variants: further variants of Robbie by name: the keys `core`, `module` and `black_box` of profiles.
    """

    quick: bool = False
    rounds: int = 0
    count: int = 0
    modules: int = 0
    seconds: float = 0.0
    only: tuple[str, ...] = ()
    watched: Watched = unwatched
    variants: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def budget_s(self) -> float | None:
        """Time after which no further contender is started; None: no limit."""
        return QUICK_BUDGET_S if self.quick else None

    def messages(self, usual: int, quick: int) -> int:
        """Return the number of messages in each round."""
        return self.count or (quick if self.quick else usual)

    def times(self, usual: int, quick: int) -> int:
        """Return the number of rounds."""
        return self.rounds or (quick if self.quick else usual)

    def window_s(self, usual: float, quick: float) -> float:
        """Return the time for which to measure processor time."""
        return self.seconds or (quick if self.quick else usual)

    def chosen(self, series: list[Series]) -> list[Series]:
        """Return the series that the command line asks for."""
        return [one for one in series if not self.only or one.contender.name in self.only]

    def robbies(self) -> list[RobbieContender]:
        """Return Robbie and the variants of it that the command line asks for."""
        found = [RobbieContender()]
        for name, profile in self.variants.items():
            found.append(RobbieContender(name, f"Robbie-MP {name}", **profile))
        return found


def peer(name: str) -> PeerContender:
    """Return the floor or peer that a file of this name describes."""
    return PeerContender(name, load_peer(name))


def peers() -> list[PeerContender]:
    """Return all peers. Floors are not among them."""
    return [peer(name) for name in PEERS]


def read_variant(text: str) -> tuple[str, dict[str, Any]]:
    """Read NAME=FILE.yaml."""
    name, _, file = text.partition("=")
    return name, yaml.safe_load(Path(file).read_text())
