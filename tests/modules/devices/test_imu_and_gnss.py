"""The modules of IMUs and receivers publish what these tell, and that they are away."""

import os
import tty
from collections.abc import Iterator

import pytest

from robbie_mp import ModuleHarness
from robbie_mp.messages import DeviceState, Imu, NavSatFix, NavSatStatus
from robbie_robots.modules.devices.gnss import NmeaReceiverModule
from robbie_robots.modules.devices.xsens import XsensModule
from tests.hw.gnss.test_receiver import gga
from tests.hw.xsens.test_imu import NEW_UNIT, Unit
from tests.hw.xsens.test_xbus import LONG


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    device, host = os.openpty()
    tty.setraw(host)
    yield device, os.ttyname(host)
    os.close(device)
    os.close(host)


def test_position_is_published_with_its_status_and_spread(line: tuple[int, str]) -> None:
    device, path = line
    with ModuleHarness(NmeaReceiverModule, {"port": path}) as harness:
        harness.advance(0.01)
        os.write(device, gga(1) + gga(0))
        harness.advance(0.01)
        fix, none = harness.take(NavSatFix)
    assert fix.status.status == NavSatStatus.STATUS_FIX
    assert none.status.status == NavSatStatus.STATUS_NO_FIX
    assert fix.latitude == pytest.approx(-19.4840833, abs=1e-7)
    assert fix.position_covariance[0] == 36.0


def test_sample_is_published_with_the_orientation() -> None:
    with ModuleHarness(XsensModule, {"port": "scripted"}) as harness:
        unit = Unit(NEW_UNIT)
        harness.module.device = unit.imu
        unit.device.send(LONG)
        harness.advance(0.01)
        (imu,) = harness.take(Imu)
        assert harness.take(DeviceState)[-1].state == "CONNECTED"
    assert imu.orientation.w == pytest.approx(0.99991, abs=1e-5)
    assert imu.linear_acceleration.z == pytest.approx(9.8601, abs=1e-4)
    assert imu.header.frame_id == "imu"
