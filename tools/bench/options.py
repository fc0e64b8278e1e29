"""What the command line says, and who is measured."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from tools.bench.contender import Contender, PeerContender
from tools.bench.robbie import RobbieContender
from tools.bench.worker import load_peer

FLOORS = ("floor", "memcpy")
PEERS = ("iceoryx2", "ecal", "lcm", "zeromq", "zenoh", "cyclonedds", "dora", "rospy", "queue")


@dataclass(frozen=True)
class Options:
    """How to measure.

    Attributes:
        quick: fewer messages and rounds; below 30 s for each benchmark.
        rounds: instead of the benchmark's own number of rounds; 0: its own.
        count: instead of the benchmark's own number of messages; 0: its own.
        only: names of those measured; () for all.
        with_top: measure Robbie with `robbie top` looking at it as well.
        variants: profiles of further Robbies by name, as `core` and `module` keys.
    """

    quick: bool = False
    rounds: int = 0
    count: int = 0
    only: tuple[str, ...] = ()
    with_top: bool = False
    variants: dict[str, dict[str, Any]] = field(default_factory=dict)

    def robbies(self) -> list[RobbieContender]:
        """Robbie, and what the command line adds to it."""
        found = [RobbieContender()]
        if self.with_top:
            found.append(RobbieContender("robbie-top", "Robbie-MP watched by robbie top", with_top=True))
        for name, profile in self.variants.items():
            core, module = profile.get("core"), profile.get("module")
            found.append(RobbieContender(name, f"Robbie-MP {name}", core, module))
        return found

    def contenders(self, *groups: str) -> list[Contender]:
        """Return who is measured.

        Args:
            groups: 'robbie', 'others' or the name of a floor or peer.
        """
        found: list[Contender] = []
        for group in groups:
            if group == "robbie":
                found += self.robbies()
            else:
                names = PEERS if group == "others" else (group,)
                found += [PeerContender(name, load_peer(name)) for name in names]
        return [one for one in found if not self.only or one.name in self.only]


def read_variant(text: str) -> tuple[str, dict[str, Any]]:
    """Read NAME=FILE.yaml."""
    name, _, file = text.partition("=")
    return name, yaml.safe_load(Path(file).read_text())
