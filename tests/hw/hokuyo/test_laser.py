"""The driver of Hokuyo's lasers understands valid data and detects invalid data."""

import math
import time
from collections.abc import Iterator
from contextlib import closing, suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.hokuyo.laser import HokuyoLaser, SentMeasurements
from robbie_robots.hw.hokuyo.scip import DamagedLine, checksum, measurement, numbers, parameters, reply_of
from tests.hw._support.fake_hokuyo import PARAMETERS, FakeHokuyo, summed, sweep

# From the first step to the last, as the parameters say.
REQUEST = "MD00440725" + "01" + "0" + "00"
BEAMS = 682
RAMP = [1000 + beam for beam in range(BEAMS)]


@pytest.fixture
def device() -> Iterator[FakeHokuyo]:
    fake = FakeHokuyo()
    yield fake
    fake.close()


def opened(
    device: FakeHokuyo, data: SentMeasurements = SentMeasurements.RANGES, merge: int = 1
) -> HokuyoLaser:
    """With a time-out that no test waits for, however busy the machine."""
    return HokuyoLaser(device.port, clock=lambda: 12.5, silence_s=60.0, data=data, merge=merge)


def refusal(device: FakeHokuyo) -> str:
    """Return why the driver does not connect."""
    with closing(opened(device)) as laser:
        assert laser.poll() == [] and not laser.is_connected
        return laser.reason


def test_numbers_and_checksums_match_the_specification() -> None:
    assert numbers(b"CB", 2).tolist() == [1234]
    assert numbers(b"1Dh").tolist() == [5432]
    assert numbers(b"m2@0", 4).tolist() == [16_000_000]
    for line in (b"AMIN:44;7", b"AMAX:725;o", b"AFRT:384;6", b"SCAN:600;e", b"DMIN:20;4", b"DMAX:5600;_"):
        text, _, told = line.partition(b";")
        assert checksum(text) == told
        assert parameters([line]) == {text[:4].decode(): text[5:].decode()}
    for text, told in ((b"00", b"P"), (b"99", b"b"), (b"02", b"R"), (b"Hokuyo", b"o"), (b"03", b"S")):
        assert checksum(text) == told


@pytest.mark.parametrize("text", [b"12", b"12\x20", b"12\x70"])
def test_characters_that_are_not_numbers_are_refused(text: bytes) -> None:
    with pytest.raises(DamagedLine):
        numbers(text)


def test_geometry_is_that_reported_by_the_laser(device: FakeHokuyo) -> None:
    device.to_send = [sweep(REQUEST, RAMP)]
    with closing(opened(device)) as laser:
        with pytest.raises(DeviceSilent, match="has not told its geometry yet"):
            _ = laser.geometry
        laser.scan()
        geometry = laser.geometry
        assert geometry.beams == BEAMS
        assert math.degrees(geometry.angle_min_rad) == pytest.approx(-119.53, abs=0.01)
        assert math.degrees(geometry.angle_max_rad) == pytest.approx(119.88, abs=0.01)
        assert (geometry.range_min_m, geometry.range_max_m, laser.period_s) == (0.02, 5.6, 0.1)
        assert laser.time_increment_s == pytest.approx(0.1 / 1024)
        assert laser.identity == {"SERI": "H0706400"}


def test_sweep_has_the_measured_ranges_and_errors_count_as_no_return(device: FakeHokuyo) -> None:
    device.to_send = [sweep(REQUEST, [0, 19, 20, 5600, 5601, *RAMP[5:]])]
    with closing(opened(device)) as laser:
        measured = laser.scan()
    # Never later than the arrival, and by half the step of the laser's clock uncertain.
    assert measured.stamp_s == 12.5
    expected = [math.inf, math.inf, 0.02, 5.6, math.inf, *(value / 1000 for value in RAMP[5:])]
    np.testing.assert_allclose(measured.ranges_m, expected, rtol=1e-6)
    assert measured.ranges_m.dtype == np.float32
    assert measured.intensities is None
    assert device.heard[:6] == ["SCIP2.0", "QT", "VV", "PP", "BM", REQUEST]


def test_intensities_arrive_with_their_ranges(device: FakeHokuyo) -> None:
    pairs = [value for beam in range(BEAMS) for value in (RAMP[beam], 9 * beam)]
    device.to_send = [sweep(REQUEST.replace("MD", "ME"), pairs)]
    with closing(opened(device, SentMeasurements.INTENSITIES)) as laser:
        measured = laser.scan()
    np.testing.assert_allclose(measured.ranges_m, np.array(RAMP) / 1000, rtol=1e-6)
    assert measured.intensities is not None
    assert measured.intensities.tolist() == [9 * beam for beam in range(BEAMS)]


def test_short_ranges_end_at_four_metres(device: FakeHokuyo) -> None:
    device.to_send = [sweep(REQUEST.replace("MD", "MS"), RAMP)]
    with closing(opened(device, SentMeasurements.SHORT_RANGES)) as laser:
        np.testing.assert_allclose(laser.scan().ranges_m, np.array(RAMP) / 1000, rtol=1e-6)
        assert laser.geometry.range_max_m == 4.095


def test_merged_steps_look_into_the_middle_of_theirs(device: FakeHokuyo) -> None:
    device.to_send = [sweep("MD0044072503000", RAMP[: 681 // 3 + 1])]
    with closing(opened(device, merge=3)) as laser:
        assert len(laser.scan().ranges_m) == laser.geometry.beams == 228
        assert laser.geometry.angle_min_rad == pytest.approx((45 - 384) * 2 * math.pi / 1024)


def test_stream_left_on_by_another_process_is_ended() -> None:
    with closing(FakeHokuyo(greeting=sweep(REQUEST, RAMP)[37:])) as device:
        device.to_send = [sweep(REQUEST, RAMP)]
        with closing(opened(device)) as laser:
            np.testing.assert_allclose(laser.scan().ranges_m, np.array(RAMP) / 1000, rtol=1e-6)


def test_damaged_sweeps_are_skipped_and_counted(device: FakeHokuyo) -> None:
    whole = sweep(REQUEST, RAMP)
    changed = whole[:500] + chr(ord(whole[500]) ^ 1) + whole[501:]
    shortened = whole[:300] + whole[310:]
    device.to_send = [changed, shortened, sweep(REQUEST, RAMP[::-1])]
    with closing(opened(device)) as laser:
        np.testing.assert_allclose(laser.scan().ranges_m, np.array(RAMP[::-1]) / 1000, rtol=1e-6)
        assert laser.counters.damaged == 2


def test_newest_of_several_sweeps_is_returned() -> None:
    with closing(FakeHokuyo(PARAMETERS | {"AMAX": "100"})) as device:
        device.to_send = [sweep("MD0044010001000", [distance] * 57) for distance in (1000, 2000, 3000)]
        with closing(opened(device)) as laser:
            sweeps, give_up_s = laser.poll(0.1), time.monotonic() + 60.0
            while len(sweeps) < 3:
                assert time.monotonic() < give_up_s
                sweeps += laser.poll(0.1)
    assert [float(one.ranges_m[0]) for one in sweeps] == [1.0, 2.0, 3.0]


def test_stopped_laser_is_lost_with_its_status_and_started_again(device: FakeHokuyo) -> None:
    device.to_send = [sweep(REQUEST, [], status="0L")]
    with closing(opened(device)) as laser:
        give_up_s = time.monotonic() + 60.0
        while not laser.counters.losses:
            assert time.monotonic() < give_up_s
            laser.poll(0.1)
        assert "stopped with status 0L (the laser does not work as it should)" in laser.reason
        device.to_send = [sweep(REQUEST, RAMP)]
        assert len(laser.scan().ranges_m) == BEAMS


@pytest.mark.parametrize(
    "parameters", [{}, PARAMETERS | {"ARES": "0"}, PARAMETERS | {"AMIN": "first"}, PARAMETERS | {"SCAN": "0"}]
)
def test_laser_without_geometry_is_refused(parameters: dict[str, str]) -> None:
    with closing(FakeHokuyo(parameters)) as device:
        assert "does not report its geometry" in refusal(device)


def test_laser_that_refuses_a_command_is_quoted() -> None:
    with closing(FakeHokuyo()) as device, closing(opened(device)) as laser:
        laser.poll()
        with pytest.raises(DeviceFault, match=r"refuses XX with status 0D \(the command is too long\)"):
            laser._answer(laser.port, "XX")


def test_missing_port_is_reported() -> None:
    with closing(HokuyoLaser("/no/such/port")) as laser:
        assert laser.poll() == []
        assert "no/such/port" in laser.reason


@pytest.mark.parametrize("status", ["9", "0000", "98"])
def test_damaged_status_of_a_sweep_does_not_stop_the_stream(device: FakeHokuyo, status: str) -> None:
    damaged = sweep(REQUEST, RAMP).replace("\n99b\n", f"\n{summed(status) if len(status) > 1 else status}\n")
    device.to_send = [damaged, sweep(REQUEST, RAMP)]
    with closing(opened(device)) as laser:
        assert len(laser.scan().ranges_m) == BEAMS
        assert (laser.counters.damaged, laser.counters.losses) == (1, 0)


@given(st.binary(max_size=300))
def test_no_reply_raises_anything_but_damaged_line(text: bytes) -> None:
    with suppress(DamagedLine):
        measurement(reply_of(text))
