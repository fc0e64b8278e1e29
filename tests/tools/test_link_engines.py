"""The other engines of the trial of links carry messages of all classes."""

from pathlib import Path

import pytest

from tools.link.trial import COMMAND, GOOD, PERIODS_S, engine_pair
from tools.test_network.network import Network


@pytest.mark.parametrize(
    ("engine", "library"),
    [
        ("link_alone", "zenoh"),
        ("plain_zenoh", "zenoh"),
        ("tcp", "socket"),
        ("dds", "cyclonedds"),
    ],
)
def test_each_engine_carries_all_classes_over_a_good_network(
    engine: str, library: str, network: Network, tmp_path: Path
) -> None:
    pytest.importorskip(library)
    with engine_pair(tmp_path, network, engine) as pair:
        network.set(GOOD)
        pair.laptop.wait_until_heard(list(PERIODS_S))
        pair.robot.wait_until_heard([COMMAND])
