"""The module of Hokuyo's lasers publishes what they send, and tells when they are away."""

import math
import time
from collections.abc import Iterator

import numpy as np
import pytest

from robbie_mp import ModuleHarness
from robbie_mp.messages import DeviceState, LaserScan
from robbie_robots.modules.devices.hokuyo import HokuyoLaserRangeFinder
from tests.hw._support.fake_hokuyo import FakeHokuyo, sweep


@pytest.fixture
def device() -> Iterator[FakeHokuyo]:
    fake = FakeHokuyo()
    yield fake
    fake.close()


def test_sweeps_are_published_and_the_laser_is_switched_off_at_the_end(device: FakeHokuyo) -> None:
    ranges = [1000 + beam for beam in range(682)]
    device.to_send = [sweep("MD0044072501000", ranges)]
    settings = {"port": device.port, "silence_s": 60.0, "period_s": 0.1}
    with ModuleHarness(HokuyoLaserRangeFinder, settings) as harness:
        scans, give_up_s = harness.take(LaserScan), time.monotonic() + 60.0
        while not scans:
            assert time.monotonic() < give_up_s
            harness.advance(0.1)
            scans = harness.take(LaserScan)
        assert [state.state for state in harness.take(DeviceState)][:1] == ["CONNECTED"]
    (scan,) = scans
    np.testing.assert_allclose(scan.ranges, np.array(ranges) / 1000, rtol=1e-6)
    assert scan.angle_min == pytest.approx((44 - 384) * 2 * math.pi / 1024)
    assert scan.angle_max == pytest.approx((725 - 384) * 2 * math.pi / 1024)
    assert scan.scan_time == pytest.approx(0.1)
    assert scan.header.frame_id == "laser"
    while device.heard[-1] != "QT":
        assert time.monotonic() < give_up_s


def test_missing_laser_is_told_and_nothing_is_published() -> None:
    with ModuleHarness(HokuyoLaserRangeFinder, {"port": "/no/such/port", "period_s": 0.1}) as harness:
        harness.advance(0.1)
        (state,) = harness.take(DeviceState)
        assert (state.state, state.port) == ("DISCONNECTED", "/no/such/port")
        assert "cannot open the port /no/such/port" in state.reason
        assert harness.take(LaserScan) == []
