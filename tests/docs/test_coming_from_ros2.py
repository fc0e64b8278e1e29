"""The module in docs/coming-from-ros2.md works as described, and every command has an answer."""

import re
from typing import Any

import numpy as np
import pytest

from robbie_mp import ModuleHarness
from robbie_mp.messages import LaserScan, TwistStamped
from tests.docs._support.pages import ROOT, block

ROWS = [
    [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
    for line in (ROOT / "docs/commands-compared.md").read_text().splitlines()
    if line.startswith("| `") and "| here |" not in line
]


def test_module_stops_before_an_obstacle() -> None:
    names: dict[str, Any] = {"__name__": __name__}
    exec(block("docs/coming-from-ros2.md", "stopper"), names)
    with ModuleHarness(names["Stopper"]) as harness:
        harness.send(LaserScan(range_max=9.0, ranges=np.array([3.0], np.float32)), topic="scan")
        assert not harness.take(TwistStamped)
        harness.send(LaserScan(range_max=9.0, ranges=np.array([0.3], np.float32)), topic="scan")
        assert len(harness.take(TwistStamped)) == 1


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_every_row_answers(row: list[str]) -> None:
    theirs, answer, ours = row
    assert theirs
    assert answer in ("yes", "no", "another way", "not needed")
    assert ours or theirs == "`control …` (ros2_control)"


def test_rows_are_those_of_both_programs() -> None:
    assert len(ROWS) > 60
