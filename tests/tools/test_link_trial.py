"""A short play of the trial of links, and the judgement of its figures."""

import math
from pathlib import Path

from tools.link.pair import Received
from tools.link.trial import TRIALS, LinkFigures, LinkTrial, _greatest_age_s, _judge, linked_pair, run_trial
from tools.test_network.network import Network, NetworkConditions

GOOD = LinkFigures("good", 1.0, 5.0, 20.0, 30.0, 20.0, 150.0, 100.0, 0, 15.0)


def received(number: int, sent_s: float, at_s: float) -> Received:
    return Received([str(number), f"{sent_s * 1e9:.0f}", f"{at_s * 1e9:.0f}"])


def judged(**changed: float) -> list[str]:
    figures = LinkFigures(**(vars(GOOD) | {"failures": []} | changed))
    _judge(figures, TRIALS[0])
    return figures.failures


def test_broken_promises_are_named() -> None:
    assert judged() == []
    assert judged(command_p99=61.0) == ["commands: p99 above 60 ms"]
    assert judged(command_p99=math.nan) == ["commands: p99 above 60 ms"]
    assert judged(state_age_max=301.0) == ["state: older than 3 periods"]
    assert judged(reliable_missing=2) == ["reliable: 2 missing"]


def test_age_of_the_newest_counts_until_the_next_one_comes() -> None:
    found = [received(1, 10.0, 10.1), received(2, 10.2, 10.3), received(3, 10.7, 10.9)]
    assert abs(_greatest_age_s(found, 10.0, 11.0) - 0.7) < 1e-9
    assert math.isnan(_greatest_age_s(found[:1], 10.0, 11.0))


def test_short_play_over_a_bad_network_loses_nothing_uncounted(network: Network, tmp_path: Path) -> None:
    with linked_pair(tmp_path, network) as pair:
        figures = run_trial(
            pair, LinkTrial("2 % loss", NetworkConditions(20e6, loss=0.02, delay_s=0.005)), 2.0
        )
    assert not [one for one in figures.failures if "duplicates" in one or "reordered" in one]
    assert figures.commands_received > 0.5
    assert figures.reliable_missing == 0
