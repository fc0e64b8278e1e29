"""The driver of MicroStrain units with MIP, on the emulated unit."""

import math
import struct

import numpy as np
import pytest

from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.emulation import mip as unit
from robbie_robots.hw.emulation.device import EmulatedClock
from robbie_robots.hw.emulation.mip import EVERYTHING, EmulatedMip
from robbie_robots.hw.microstrain import mip
from robbie_robots.hw.microstrain.imu import MicroStrainImu, with_z_up
from robbie_robots.hw.microstrain.mip import SensorField
from tests.hw._support.captures import CAPTURES, needs_captures
from tests.hw._support.line import Clock
from tests.hw._support.scripted_port import ScriptedPort


class Driven:
    """The driver with an emulated unit, whose bytes arrive as soon as it sends them."""

    def __init__(self, fields: frozenset[int] = EVERYTHING, base_hz: int = 1000, rate_hz: int = 100) -> None:
        self.clock = Clock()
        self.unit = EmulatedMip(EmulatedClock(monotonic=self.clock), fields=fields, base_hz=base_hz)
        self.port = ScriptedPort(self._answer)
        self.imu = MicroStrainImu(
            "scripted", rate_hz, clock=self.clock, monotonic=self.clock, open_port=self._opened
        )

    def _opened(self, url: str, bit_rate: int) -> Port:
        return self.port.opened(url, bit_rate)

    def _answer(self, data: bytes, _bit_rate: int) -> bytes:
        self.unit.receive(data)
        return self.sent()

    def sent(self) -> bytes:
        self.unit.step()
        return b"".join(self.unit.taken())

    def after(self, passed_s: float) -> bytes:
        """Return what the unit sends by itself in a time."""
        self.clock.now_s += passed_s
        return self.sent()


def test_unit_is_told_what_to_send_and_its_axes_are_turned_up() -> None:
    driven = Driven()
    driven.unit.motion.acceleration = (0.1, 0.2, -1.0)
    driven.unit.motion.turn = (0.1, 0.2, 0.3)
    driven.imu.poll()
    assert driven.imu.is_connected and driven.imu.fields == (
        SensorField.ACCELERATION,
        SensorField.TURN_RATE,
        SensorField.QUATERNION,
        SensorField.REFERENCE_TIME,
    )
    (oriented,) = driven.imu._take(driven.after(0.0101))
    np.testing.assert_allclose(
        oriented.sample.acceleration_m_per_s2, (0.980665, -1.96133, 9.80665), rtol=1e-6
    )
    np.testing.assert_allclose(oriented.sample.turn_rad_per_s, (0.1, -0.2, -0.3), rtol=1e-6)
    assert oriented.quaternion is not None
    np.testing.assert_allclose(oriented.quaternion, (math.sqrt(0.5), 0, 0, math.sqrt(0.5)))


@pytest.mark.parametrize(("base_hz", "rate_hz", "samples"), [(1000, 100, 10), (500, 100, 10), (500, 400, 50)])
def test_unit_divides_its_own_rate(base_hz: int, rate_hz: int, samples: int) -> None:
    driven = Driven(base_hz=base_hz, rate_hz=rate_hz)
    driven.imu.poll()
    assert len(driven.imu._take(driven.after(0.1001))) == samples


def test_late_sample_is_stamped_by_the_units_own_clock() -> None:
    for fields in (EVERYTHING, EVERYTHING - {unit.INTERNAL_TIME}):
        driven = Driven(fields)
        driven.imu.poll()
        stamps = []
        for late_s in (0.0, 0.005, 0.0):
            data = driven.after(0.0101)
            driven.clock.now_s += late_s
            stamps += [oriented.sample.stamp_s for oriented in driven.imu._take(data)]
            driven.clock.now_s -= late_s
        assert np.diff(stamps) == pytest.approx([0.01, 0.01], abs=1e-4)


def test_model_without_orientation_and_clock_still_measures() -> None:
    driven = Driven(frozenset({unit.ACCELERATION, unit.TURN}))
    driven.imu.poll()
    (oriented,) = driven.imu._take(driven.after(0.0101))
    assert oriented.quaternion is None
    assert oriented.sample.stamp_s == driven.clock.now_s


def test_unit_that_refuses_is_told_as_the_reason() -> None:
    driven = Driven(frozenset({unit.ACCELERATION}))
    driven.imu.poll()
    assert not driven.imu.is_connected
    assert driven.imu.reason == "the unit at scripted refuses command 0C 08 with error 3"


def test_field_of_another_length_is_counted_as_damage() -> None:
    driven = Driven()
    driven.imu.poll()
    wrong = mip.packet(0x80, [mip.MipField(SensorField.ACCELERATION, struct.pack(">f", 1.0))])
    assert driven.imu._take(wrong) == []
    assert driven.imu.counters.damaged == 1


def test_orientation_is_converted_both_ways() -> None:
    for quaternion in ((0.5, 0.1, -0.7, 0.5), (0.0, 1.0, 0.0, 0.0)):
        given = np.array(quaternion)
        np.testing.assert_allclose(with_z_up(with_z_up(given)), given, atol=1e-12)
    # Nose up by 30 degrees, to the east: about REP 103's y, which points left, that is a negative turn.
    half = math.radians(15)
    east, up = (math.sqrt(0.5), 0, 0, math.sqrt(0.5)), (math.cos(half), 0, math.sin(half), 0)
    nose_up = (east[0] * up[0], -east[3] * up[2], east[0] * up[2], east[3] * up[0])
    converted = with_z_up(nose_up)
    np.testing.assert_allclose(converted * np.sign(converted[0]), (up[0], 0, -up[2], 0), atol=1e-12)


@needs_captures
def test_real_units_samples_are_read_with_gravity_along_z() -> None:
    data = (CAPTURES / "mip" / "mip_data_first_120000_bytes.bin").read_bytes()
    driven = Driven()
    driven.imu.poll()
    samples = driven.imu._take(data)
    assert len(samples) == 1510
    np.testing.assert_allclose(samples[0].sample.acceleration_m_per_s2, (0.171, 0.065, 9.666), atol=0.001)


def test_numbers_that_are_not_finite_are_left_out_and_counted_if_the_sample_needs_them() -> None:
    driven = Driven()
    driven.imu.poll()

    def sample(turn: float, w: float, week_s: float) -> bytes:
        return mip.packet(
            0x80,
            [
                mip.MipField(SensorField.ACCELERATION, struct.pack(">3f", 0.0, 0.0, -1.0)),
                mip.MipField(SensorField.TURN_RATE, struct.pack(">3f", turn, 0.0, 0.0)),
                mip.MipField(SensorField.QUATERNION, struct.pack(">4f", w, 0.0, 0.0, 0.0)),
                mip.MipField(SensorField.GPS_TIME, struct.pack(">dHH", week_s, 0, 0)),
            ],
        )

    assert driven.imu._take(sample(math.nan, 1.0, 5.0)) == []
    assert driven.imu.counters.damaged == 1
    for week_s in (5.0, math.nan, math.inf, 1e308):
        (oriented,) = driven.imu._take(sample(0.5, math.nan, week_s))
        assert oriented.quaternion is None and oriented.sample.stamp_s == driven.clock.now_s
    assert driven.imu.counters.damaged == 1
