"""Emulated SICK scanners answer as their maker's manuals say, and the drivers understand them."""

from contextlib import closing

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.hw.emulation.cola import LMS_111, EmulatedSickScanner
from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice
from robbie_robots.hw.emulation.lms2xx import EmulatedLms2xx, checksum
from robbie_robots.hw.emulation.stepped_line import SteppedLine, SteppedTime
from robbie_robots.hw.pluggable_laser import PluggableLaser
from robbie_robots.hw.sick.cola import Dialect
from robbie_robots.hw.sick.cola_laser import SickColaLaser
from robbie_robots.hw.sick.lms2xx import SickLms2xx

Array = NDArray[np.float64]

# Of real time, of which a busy machine may take any amount.
LIMIT_S = 60.0


def wall(_number: int, angles: Array) -> Array:
    """Return 3 m straight ahead, more to the left, and nothing on the far right."""
    return np.where(angles < -0.8, np.inf, 3 + angles)


def heard(device: EmulatedDevice, data: bytes) -> bytes:
    """Return what the device answers."""
    device.receive(data)
    return b"".join(device.taken())


@pytest.mark.parametrize(
    "telegram",
    [
        "02 00 01 00 31 15 12",
        "02 00 02 00 20 24 34 08",
        "02 00 02 00 20 40 50 08",
        "02 00 05 00 3B 64 00 19 00 E7 72",
        "02 80 03 00 A0 00 10 16 0A",
    ],
)
def test_telegrams_of_the_manual_have_their_checksum(telegram: str) -> None:
    data = bytes.fromhex(telegram)
    assert checksum(data[:-2]) == int.from_bytes(data[-2:], "little")


def test_scanner_answers_as_in_the_manual_and_refuses_the_rest() -> None:
    scanner = EmulatedLms2xx(wall)
    assert heard(scanner, bytes.fromhex("02 00 02 00 20 25 35 08")) == bytes.fromhex(
        "06 02 80 03 00 A0 00 10 16 0A"
    )
    assert heard(scanner, bytes.fromhex("02 00 02 00 20 25 35 09")) == b"\x15"
    # The manual: 100 degrees by 0.25, and nothing so fine over 180.
    assert heard(scanner, bytes.fromhex("02 00 05 00 3B 64 00 19 00 E7 72"))[5:11].hex() == "bb0164001900"
    fine = bytes.fromhex("02 00 05 00 3B B4 00 19 00")
    assert heard(scanner, fine + checksum(fine).to_bytes(2, "little"))[6] == 0
    one = heard(scanner, bytes.fromhex("02 00 02 00 30 01 31 18"))
    assert one[1:4] == b"\x02\x80" + bytes([(3 + 2 * 401 + 1) & 0xFF])


def test_scanner_takes_a_new_rate_after_its_answer() -> None:
    clock = SteppedTime()
    scanner = EmulatedLms2xx(wall, EmulatedClock(monotonic=clock))
    heard(scanner, bytes.fromhex("02 00 02 00 20 48 58 08"))
    scanner.step()
    assert scanner.bit_rate == 9_600
    clock.now_s += 0.01
    scanner.step()
    assert scanner.bit_rate == 500_000


def connected(
    device: EmulatedDevice, laser: PluggableLaser, clock: SteppedTime
) -> tuple[SteppedLine, PluggableLaser]:
    line = SteppedLine(device, clock)
    laser._open_port = line.opened
    return line, laser


@pytest.mark.parametrize(("field_deg", "resolution_deg"), [(180, 0.5), (180, 1.0), (100, 0.25), (100, 1.0)])
@pytest.mark.parametrize("bit_rate", [38_400, 500_000])
def test_driver_reads_what_an_lms2xx_measures(field_deg: int, resolution_deg: float, bit_rate: int) -> None:
    clock = SteppedTime()
    laser: PluggableLaser = SickLms2xx(
        "simulated",
        clock=clock,
        bit_rate=bit_rate,
        field_deg=field_deg,
        resolution_deg=resolution_deg,
        silence_s=LIMIT_S,
    )
    _, laser = connected(EmulatedLms2xx(wall, EmulatedClock(monotonic=clock)), laser, clock)
    with closing(laser):
        sweep = laser.scan()
        expected = wall(0, laser.geometry.angles_rad())
        np.testing.assert_allclose(sweep.ranges_m, expected, atol=0.0051)
        assert len(expected) == field_deg / resolution_deg + 1


@pytest.mark.parametrize("dialect", Dialect)
@pytest.mark.parametrize("intensities", [True, False])
def test_driver_reads_what_an_lms1xx_measures(dialect: Dialect, intensities: bool) -> None:
    clock, angles = SteppedTime(), LMS_111.angles_rad()
    device = EmulatedSickScanner(
        lambda _: wall(0, angles), LMS_111, dialect is Dialect.A, EmulatedClock(monotonic=clock)
    )
    laser: PluggableLaser = SickColaLaser(
        "simulated", clock=clock, dialect=dialect, intensities=intensities, silence_s=LIMIT_S
    )
    _, laser = connected(device, laser, clock)
    with closing(laser):
        sweep = laser.scan()
        np.testing.assert_allclose(sweep.ranges_m, wall(0, angles), atol=0.0006)
        np.testing.assert_allclose(laser.geometry.angles_rad(), angles, atol=1e-6)
        assert laser.period_s == pytest.approx(0.02)
        if intensities:
            assert (
                sweep.intensities is not None
                and sweep.intensities.tolist() == np.where(angles < -0.8, 0, 150).tolist()
            )
        else:
            assert sweep.intensities is None


def test_scanner_refuses_to_be_configured_without_a_password() -> None:
    device = EmulatedSickScanner(lambda _: np.ones(541), LMS_111, is_text=True)
    configure = b"\x02sWN LMDscandatacfg 01 00 1 1 0 00 00 0 0 0 0 +1\x03"
    assert heard(device, configure).startswith(b"\x02sFA")
    assert heard(device, b"\x02sMN SetAccessMode 03 F4724744\x03") == b"\x02sAN SetAccessMode 1\x03"
    assert heard(device, configure) == b"\x02sWA LMDscandatacfg\x03"
