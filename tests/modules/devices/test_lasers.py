"""The modules of lasers publish sweeps and the device's state, and run on while it is away."""

from pathlib import Path

import numpy as np
import pytest

from robbie_mp import ModuleHarness
from robbie_mp.messages import DeviceState, LaserScan
from robbie_robots.hw.laser import DeviceSweep
from robbie_robots.modules.devices.pluggable import FOUND_WITHIN_S
from robbie_robots.modules.devices.pluggable_laser import PluggableLaserModule
from robbie_robots.modules.devices.rplidar import RpLidarRangeFinder
from robbie_robots.modules.devices.sick_cola import SickColaRangeFinder
from robbie_robots.modules.devices.sick_lms2xx import SickLms2xxRangeFinder


@pytest.mark.slow
@pytest.mark.parametrize("kind", [RpLidarRangeFinder, SickLms2xxRangeFinder])
def test_missing_laser_is_told_each_second_and_nothing_is_published(
    kind: type[PluggableLaserModule], tmp_path: Path
) -> None:
    with ModuleHarness(kind, {"port": str(tmp_path / "laser"), "period_s": 0.1}) as harness:
        for _ in range(12):
            harness.advance(0.1)
        states = harness.take(DeviceState)
        assert 1 <= len(states) <= 3
        assert {state.state for state in states} == {"DISCONNECTED"}
        assert "cannot open the port" in states[-1].reason
        assert harness.take(LaserScan) == []
        assert harness.module.status.startswith("DISCONNECTED: cannot open the port")
        assert not harness.module.degraded, "it may still be found"
        harness.advance(FOUND_WITHIN_S)
        assert harness.module.degraded.startswith("the device is disconnected: cannot open the port")


def test_sweep_is_published_with_its_stamp_and_intensities() -> None:
    with ModuleHarness(SickLms2xxRangeFinder, {"port": "/no/such/port", "frame_id": "rear"}) as harness:
        sweep = DeviceSweep(12.25, np.ones(361, np.float32), np.full(361, 7, np.float32))
        harness.module.on_value(sweep)
        (scan,) = harness.take(LaserScan)
    assert scan.header.stamp.nanoseconds == 12_250_000_000
    assert scan.header.frame_id == "rear"
    assert (len(scan.ranges), len(scan.intensities)) == (361, 361)
    assert scan.scan_time == pytest.approx(8 * 2 / 75)


def test_laser_on_a_network_is_named_by_its_address() -> None:
    with ModuleHarness(
        SickColaRangeFinder, {"port": "socket://127.0.0.1:1", "dialect": "A", "period_s": 0.1}
    ) as harness:
        harness.advance(0.1)
        (state,) = harness.take(DeviceState)
    assert (state.port, state.state) == ("socket://127.0.0.1:1", "DISCONNECTED")
