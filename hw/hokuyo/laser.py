"""Hokuyo's laser range finders on a serial port or USB, such as the URG-04LX and the UTM-30LX."""

import math
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import serial

from hw.hokuyo.scip import DamagedLine, LaserFault, numbers, parameters, without_checksum
from hw.laser import LaserGeometry, LaserRangeFinder, LaserSweep
from hw.pose import ORIGIN, Pose

BIT_RATE = 115_200
# Lines of an earlier stream that may precede the answer to QT: a few sweeps of the largest laser.
MAX_OLD_LINES = 2_000
# Consecutive sweeps that may be damaged, for example by lost bytes.
MAX_DAMAGED_SWEEPS = 5
# Status of a command that the laser accepted.
GOOD = b"00"


class LaserSilent(TimeoutError):
    """The laser has sent nothing for too long."""


class HokuyoLaser(LaserRangeFinder):
    """A laser that streams sweeps over its whole field of view.

    Args:
        port: name of the port, such as "/dev/ttyACM0".
        clock: returns the time in s.
        timeout_s: time after which a laser that sends nothing counts as silent; must exceed its scan time.
        mount: the laser's pose in the robot's frame.

    Raises:
        LaserSilent: nothing answers on the port.
        LaserFault: the answer is not that of a Hokuyo laser.
        OSError: the port cannot be opened.
    """

    def __init__(
        self, port: str, clock: Callable[[], float], timeout_s: float = 1.0, mount: Pose = ORIGIN
    ) -> None:
        self._clock = clock
        self._port = serial.Serial(port, BIT_RATE, timeout=timeout_s, write_timeout=timeout_s, exclusive=True)
        try:
            # The oldest lasers must be switched to SCIP 2.0 first. An earlier stream may still be running.
            self._port.write(b"SCIP2.0\n")
            self._answer("QT")
            told = parameters(self._answer("PP"))
            self._geometry, self.period_s = _geometry(told, mount), 60.0 / int(told["SCAN"])
            # No merging of steps, no skipped sweeps, endless.
            self._request = f"MD{int(told['AMIN']):04d}{int(told['AMAX']):04d}01000"
            self._answer(self._request)
        except (KeyError, ValueError, ZeroDivisionError) as error:
            self._port.close()
            raise LaserFault(f"the laser does not report its geometry: {error!r}") from error
        except BaseException:
            self._port.close()
            raise

    @property
    def geometry(self) -> LaserGeometry:
        """Return the laser's mounting pose and beam directions."""
        return self._geometry

    def scan(self) -> LaserSweep:
        """Wait for the next sweep and return it, or the newest of several. Skip damaged sweeps.

        Ranges below the laser's minimum and measurement errors are also +inf, because the laser does not
        distinguish them.

        Raises:
            LaserSilent: no sweep arrived in time.
            LaserFault: the laser has stopped, or several sweeps in a row were damaged.
        """
        sweep = self._undamaged()
        # Three characters per beam: another whole sweep has arrived.
        while self._port.in_waiting > 3 * self._geometry.beams:
            sweep = self._undamaged()
        return sweep

    def close(self) -> None:
        """Switch the laser off if it still answers, and close the port."""
        with suppress(OSError):
            self._port.write(b"QT\n")
        self._port.close()

    def _undamaged(self) -> LaserSweep:
        for _ in range(MAX_DAMAGED_SWEEPS):
            with suppress(DamagedLine):
                return self._sweep()
        raise LaserFault(f"{MAX_DAMAGED_SWEEPS} sweeps in a row were damaged in transmission")

    def _sweep(self) -> LaserSweep:
        """Read a sweep: echo, status, time stamp of the laser's clock, data, an empty line."""
        self._skip_to(self._request)
        stamp_s = self._clock()
        status = without_checksum(self._line())
        if status != b"99":
            raise LaserFault(f"the laser has stopped with status {status.decode('ascii', 'replace')}")
        lines = [without_checksum(line) for line in iter(self._line, b"")]
        millimetres = numbers(b"".join(lines[1:]))
        if len(millimetres) != self._geometry.beams:
            raise DamagedLine(f"a sweep of {len(millimetres)} beams instead of {self._geometry.beams}")
        ranges = (millimetres / 1000.0).astype(np.float32)
        least, most = self._geometry.range_min_m, self._geometry.range_max_m
        ranges[(ranges < np.float32(least)) | (ranges > np.float32(most))] = np.inf
        return LaserSweep(stamp_s, ranges)

    def _answer(self, command: str) -> list[bytes]:
        """Send a command and return the lines of the answer after its status."""
        self._port.write(command.encode() + b"\n")
        self._skip_to(command)
        status = without_checksum(self._line())
        if status != GOOD:
            raise LaserFault(f"the laser refuses {command} with status {status.decode('ascii', 'replace')}")
        return list(iter(self._line, b""))

    def _skip_to(self, echo: str) -> None:
        """Read up to the echo of a command, skipping the rest of a damaged sweep or an earlier stream."""
        for _ in range(MAX_OLD_LINES):
            if self._line() == echo.encode():
                return
        raise LaserFault(f"no answer to {echo} in {MAX_OLD_LINES} lines: does this laser speak SCIP 2.0?")

    def _line(self) -> bytes:
        line: bytes = self._port.read_until(b"\n")
        if not line.endswith(b"\n"):
            raise LaserSilent(f"the laser at {self._port.port} has sent nothing for {self._port.timeout:g} s")
        return line[:-1]


def _geometry(told: dict[str, str], mount: Pose) -> LaserGeometry:
    """Return the geometry given by a laser's parameters; its steps count counter-clockwise."""
    step_rad = 2 * math.pi / int(told["ARES"])
    first, last = int(told["AMIN"]), int(told["AMAX"])
    return LaserGeometry(
        angle_min_rad=(first - int(told["AFRT"])) * step_rad,
        angle_increment_rad=step_rad,
        beams=last - first + 1,
        range_min_m=int(told["DMIN"]) / 1000.0,
        range_max_m=int(told["DMAX"]) / 1000.0,
        mount=mount,
    )
