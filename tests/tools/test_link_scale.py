"""A short play of the measurement of many robots at one router."""

import pytest

from tools.link_scale.__main__ import measure, row


@pytest.mark.slow
def test_robots_at_a_router_find_each_other_and_receive_states() -> None:
    figures = measure("star", robots=3, seconds=1.0, settle_s=6.0)
    assert figures.up > 0.0  # all of them, if the machine is not busy
    assert figures.received > 0.0
    assert figures.packets_per_s > 0.0
    assert row(figures).count("|") == 10
