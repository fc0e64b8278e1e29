"""Rates from two readings of the core's counters."""

import numpy as np
import pytest

from robbie_mp import MessageHandling
from robbie_mp.bus.observe import TOTALS
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.channels import ChannelCounters
from robbie_mp.bus.transport.tables import COLUMNS, Outcome
from robbie_mp.cli.rates import TrafficRates
from robbie_mp.messages import ModuleProfile
from robbie_mp.messages.message import fields_of
from tests.bus.core._support.simulated_run import TYPE, SimulatedRun, connected


@pytest.mark.parametrize("period_s", [0.002, 0.02, 1.0, 60.0])
def test_jitter_of_30_us_is_measured_whatever_the_period(period_s: float) -> None:
    random = np.random.default_rng(1)
    steps_ns = period_s * 1e9 + random.normal(scale=30_000, size=200)
    stamps_ns = (10**15 + np.cumsum(steps_ns)).astype(np.int64)
    run = SimulatedRun()
    publisher, channel, _ = connected(run, MessageHandling.KEEP_ONLY_NEWEST)
    publisher.publish(channel, int(stamps_ns[0]))
    run.run_core()
    counters = ChannelCounters(run.words)
    (before,) = counters.read(TYPE, 1).values()
    for stamp_ns in stamps_ns[1:]:
        publisher.publish(channel, int(stamp_ns))
        run.run_core()
        publisher.collect_freed()
    (after,) = counters.read(TYPE, 1).values()
    rates = TrafficRates.between("", before, after, 1.0)
    assert rates.interval_mean_s == pytest.approx(np.diff(stamps_ns).mean() / 1e9)
    assert rates.interval_deviation_s == pytest.approx(np.diff(stamps_ns).std() / 1e9, abs=1e-6)


def test_counters_of_a_subscription_are_one_list() -> None:
    assert COLUMNS[1:] == tuple(outcome.name.lower() for outcome in Outcome if outcome > Outcome.HELD)
    assert len(COLUMNS) == layout.SUBSCRIPTION_COUNTERS
    assert {total.name for total in TOTALS} <= {field.name for field in fields_of(ModuleProfile)}
