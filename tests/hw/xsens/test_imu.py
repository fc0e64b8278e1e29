"""The driver of Xsens MTi units."""

import math
import struct

import numpy as np
import pytest

from robbie_robots.hw.xsens import xbus
from robbie_robots.hw.xsens.imu import OLD_MODE, OLD_SETTINGS, XsensImu
from robbie_robots.hw.xsens.xbus import MessageId
from tests.hw._support.line import Clock, ScriptedDevice
from tests.hw.xsens.test_xbus import LONG

OUTPUTS = xbus.output_configuration(
    [(0x1020, 0xFFFF), (0x1060, 0xFFFF), (0x2010, 100), (0x4020, 100), (0x8020, 100)]
)
NEW_UNIT = {
    xbus.message(MessageId.GO_TO_CONFIG): LONG + xbus.message(0x31),
    OUTPUTS: xbus.message(0xC1),
    xbus.message(MessageId.GO_TO_MEASUREMENT): xbus.message(0x11),
}
OLD_UNIT = {
    **NEW_UNIT,
    OUTPUTS: xbus.message(MessageId.ERROR, b"\x04"),
    xbus.output_mode(OLD_MODE): xbus.message(0xD1),
    xbus.output_settings(OLD_SETTINGS): xbus.message(0xD3),
}


class Unit:
    """A driver and its scripted unit."""

    def __init__(self, answers: dict[bytes, bytes]) -> None:
        self.clock = Clock()
        self.device = ScriptedDevice(answers)
        self.imu = XsensImu(
            "scripted",
            clock=self.clock,
            monotonic=self.clock,
            open_port=lambda url, rate: self.device,  # type: ignore[arg-type, return-value]
        )
        self.imu.poll()


def data2(ticks: int) -> bytes:
    parts = struct.pack(">HBI", 0x1060, 4, ticks)
    parts += struct.pack(">HB3f", 0x4020, 12, 1, 2, 9.75) + struct.pack(">HB3f", 0x8020, 12, 0, 0, 0.5)
    return xbus.message(MessageId.DATA2, parts)


def test_newer_unit_is_told_what_to_send_amid_its_earlier_stream() -> None:
    unit = Unit(NEW_UNIT)
    assert unit.imu.is_connected
    unit.device.send(data2(0))
    (oriented,) = unit.imu.poll()
    np.testing.assert_allclose(oriented.sample.acceleration_m_per_s2, (1, 2, 9.75))
    np.testing.assert_allclose(oriented.sample.turn_rad_per_s, (0, 0, 0.5))
    assert oriented.quaternion is None


def test_real_message_yields_an_oriented_sample_if_it_has_rates() -> None:
    unit = Unit(NEW_UNIT)
    unit.device.send(LONG)
    (oriented,) = unit.imu.poll()
    assert oriented.quaternion is not None
    np.testing.assert_allclose(oriented.quaternion, (0.99991, -0.00293, 0.0123, 0.00333), atol=1e-5)


def test_late_sample_is_stamped_by_the_units_own_clock_over_its_wrap() -> None:
    unit = Unit(NEW_UNIT)
    stamps = []
    for ticks, late_s in ((2**32 - 100, 0.0), (0, 0.005), (100, 0.0)):
        unit.clock.now_s += 0.01 + late_s
        unit.device.send(data2(ticks))
        (oriented,) = unit.imu.poll()
        unit.clock.now_s -= late_s
        stamps.append(oriented.sample.stamp_s)
    assert np.diff(stamps) == pytest.approx([0.01, 0.01], abs=2e-4)


def test_older_unit_is_asked_in_its_own_way() -> None:
    unit = Unit(OLD_UNIT)
    assert unit.imu.is_connected
    numbers = [1, 2, 9.75, 0, 0, 0.5, 7, 8, 9, 1, 0, 0, 0]
    unit.device.send(xbus.message(MessageId.DATA, struct.pack(">13fH", *numbers, 1)))
    (oriented,) = unit.imu.poll()
    assert oriented.sample.turn_rad_per_s[2] == 0.5
    assert oriented.quaternion is not None and oriented.quaternion[0] == 1
    assert oriented.sample.stamp_s == unit.clock.now_s


def test_unit_that_refuses_both_ways_is_not_connected() -> None:
    unit = Unit({**OLD_UNIT, xbus.output_mode(OLD_MODE): xbus.message(MessageId.ERROR, b"\x04")})
    assert "refuses message D0 with error 04" in unit.imu.reason


def test_message_that_cannot_be_read_is_counted() -> None:
    unit = Unit(NEW_UNIT)
    unit.device.send(xbus.message(MessageId.DATA2, b"\x40\x20\x0c"))
    assert unit.imu.poll() == []
    assert unit.imu.counters.damaged == 1


@pytest.mark.parametrize("unknown", [math.nan, math.inf])
def test_message_without_finite_rates_is_counted(unknown: float) -> None:
    unit = Unit(NEW_UNIT)
    acceleration = struct.pack(">HB3f", 0x4020, 12, 1, 2, 9.75)
    turn = struct.pack(">HB3d", 0x8023, 24, 0, unknown, 0.5)
    unit.device.send(xbus.message(MessageId.DATA2, acceleration + turn))
    assert unit.imu.poll() == []
    assert unit.imu.counters.damaged == 1
    old = Unit(OLD_UNIT)
    old.device.send(
        xbus.message(MessageId.DATA, struct.pack(">13fH", 1, 2, unknown, *[0.5] * 6, 1, 0, 0, 0, 1))
    )
    assert old.imu.poll() == []
    assert old.imu.counters.damaged == 1


def test_orientation_that_is_not_finite_is_not_told() -> None:
    unit = Unit(NEW_UNIT)
    turned = struct.pack(">HB4f", 0x2010, 16, math.nan, 0, 0, 0)
    rates = struct.pack(">HB3f", 0x4020, 12, 1, 2, 9.75) + struct.pack(">HB3f", 0x8020, 12, 0, 0, 0.5)
    unit.device.send(xbus.message(MessageId.DATA2, turned + rates))
    (oriented,) = unit.imu.poll()
    assert oriented.quaternion is None
