"""The driver of Hokuyo's lasers understands valid data and detects invalid data."""

import math
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from hw.hokuyo.laser import HokuyoLaser, LaserSilent
from hw.hokuyo.scip import DamagedLine, LaserFault, checksum, numbers, parameters
from tests.hw._support.fake_hokuyo import PARAMETERS, FakeHokuyo, sweep

# From the first step to the last, as the parameters say.
REQUEST = "MD00440725" + "01" + "0" + "00"
BEAMS = 682
RAMP = [1000 + beam for beam in range(BEAMS)]


@pytest.fixture
def device() -> Iterator[FakeHokuyo]:
    fake = FakeHokuyo()
    yield fake
    fake.close()


def opened(device: FakeHokuyo) -> HokuyoLaser:
    """With a time-out that no test waits for, however busy the machine."""
    return HokuyoLaser(device.port, lambda: 12.5, timeout_s=60.0)


def test_numbers_and_checksums_match_the_specification() -> None:
    assert numbers(b"1Dh").tolist() == [5432]
    for line in (b"AMIN:44;7", b"AMAX:725;o", b"AFRT:384;6", b"SCAN:600;e", b"DMIN:20;4", b"DMAX:5600;_"):
        text, _, told = line.partition(b";")
        assert checksum(text) == told
        assert parameters([line]) == {text[:4].decode(): text[5:].decode()}
    assert checksum(b"00") == b"P" and checksum(b"99") == b"b"


@pytest.mark.parametrize("text", [b"12", b"12\x20", b"12\x70"])
def test_characters_that_are_not_numbers_are_refused(text: bytes) -> None:
    with pytest.raises(DamagedLine):
        numbers(text)


def test_geometry_is_that_reported_by_the_laser(device: FakeHokuyo) -> None:
    laser = opened(device)
    geometry = laser.geometry
    assert geometry.beams == BEAMS
    assert math.degrees(geometry.angle_min_rad) == pytest.approx(-119.53, abs=0.01)
    assert math.degrees(geometry.angle_max_rad) == pytest.approx(119.88, abs=0.01)
    assert (geometry.range_min_m, geometry.range_max_m, laser.period_s) == (0.02, 5.6, 0.1)
    laser.close()


def test_sweep_has_the_measured_ranges_and_errors_count_as_no_return(device: FakeHokuyo) -> None:
    device.to_send = [sweep(REQUEST, [0, 19, 20, 5600, 5601, *RAMP[5:]])]
    laser = opened(device)
    measured = laser.scan()
    assert measured.stamp_s == 12.5
    expected = [math.inf, math.inf, 0.02, 5.6, math.inf, *(value / 1000 for value in RAMP[5:])]
    np.testing.assert_allclose(measured.ranges_m, expected, rtol=1e-6)
    assert measured.ranges_m.dtype == np.float32
    assert device.heard == ["SCIP2.0", "QT", "PP", REQUEST]
    laser.close()


def test_stream_left_on_by_another_process_is_ended() -> None:
    with closing(FakeHokuyo(greeting=sweep(REQUEST, RAMP)[37:])) as device:
        device.to_send = [sweep(REQUEST, RAMP)]
        laser = opened(device)
        np.testing.assert_allclose(laser.scan().ranges_m, np.array(RAMP) / 1000, rtol=1e-6)
        laser.close()


def test_damaged_sweeps_are_skipped(device: FakeHokuyo) -> None:
    whole = sweep(REQUEST, RAMP)
    changed = whole[:500] + chr(ord(whole[500]) ^ 1) + whole[501:]
    shortened = whole[:300] + whole[310:]
    device.to_send = [changed, shortened, sweep(REQUEST, RAMP[::-1])]
    laser = opened(device)
    np.testing.assert_allclose(laser.scan().ranges_m, np.array(RAMP[::-1]) / 1000, rtol=1e-6)
    laser.close()


def test_newest_of_several_sweeps_is_returned() -> None:
    with closing(FakeHokuyo(PARAMETERS | {"AMAX": "100"})) as device:
        device.to_send = [sweep("MD0044010001000", [distance] * 57) for distance in (1000, 2000, 3000)]
        laser = opened(device)
        waiting, give_up_s = sum(map(len, device.to_send)), time.monotonic() + 60.0
        while laser._port.in_waiting < waiting:
            assert time.monotonic() < give_up_s
        assert set(laser.scan().ranges_m) == {3.0}
        laser.close()


def test_laser_that_sends_only_damaged_data_is_faulty(device: FakeHokuyo) -> None:
    device.to_send = [sweep(REQUEST, RAMP[:-1])] * 5
    laser = opened(device)
    with pytest.raises(LaserFault, match="5 sweeps in a row were damaged"):
        laser.scan()
    laser.close()


def test_stopped_laser_is_reported_with_its_status(device: FakeHokuyo) -> None:
    device.to_send = [sweep(REQUEST, [], status="51")]
    laser = opened(device)
    with pytest.raises(LaserFault, match="stopped with status 51"):
        laser.scan()
    laser.close()


def test_silent_laser_is_detected(device: FakeHokuyo) -> None:
    laser = opened(device)
    laser._port.timeout = 0.1
    with pytest.raises(LaserSilent, match=r"sent nothing for 0\.1 s"):
        laser.scan()
    laser.close()


@pytest.mark.parametrize(
    "parameters", [{}, PARAMETERS | {"ARES": "0"}, PARAMETERS | {"AMIN": "first"}, PARAMETERS | {"SCAN": "0"}]
)
def test_laser_without_geometry_is_refused(parameters: dict[str, str]) -> None:
    with closing(FakeHokuyo(parameters)) as device, pytest.raises(LaserFault, match="geometry"):
        opened(device)


def test_missing_port_is_reported() -> None:
    with pytest.raises(OSError, match="no/such/port"):
        HokuyoLaser("/no/such/port", lambda: 0.0)
