"""The module of Hokuyo's lasers publishes what they send, and ends when they fall silent."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from hw.hokuyo.laser import LaserSilent
from modules.devices.hokuyo import HokuyoLaserRangeFinder
from robbie_mp import ModuleHarness
from robbie_mp.messages import LaserScan
from tests.hw._support.fake_hokuyo import FakeHokuyo, sweep


@pytest.fixture
def device() -> Iterator[FakeHokuyo]:
    fake = FakeHokuyo()
    yield fake
    fake.close()


def test_sweeps_are_published_and_the_laser_is_switched_off_at_the_end(device: FakeHokuyo) -> None:
    ranges = [1000 + beam for beam in range(682)]
    device.to_send = [sweep("MD0044072501000", ranges)]
    settings = {"port": device.port, "timeout_s": 60.0}
    with ModuleHarness(HokuyoLaserRangeFinder, settings) as harness:
        harness.advance(0.0)
        (scan,) = harness.take(LaserScan)
        harness.module.laser._port.timeout = 0.1
        with pytest.raises(LaserSilent):
            harness.advance(0.1)
    np.testing.assert_allclose(scan.ranges, np.array(ranges) / 1000, rtol=1e-6)
    assert scan.angle_min == pytest.approx((44 - 384) * 2 * math.pi / 1024)
    assert scan.angle_max == pytest.approx((725 - 384) * 2 * math.pi / 1024)
    assert scan.scan_time == pytest.approx(0.1)
    assert scan.header.frame_id == "laser"
