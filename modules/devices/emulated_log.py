"""A recorded drive through emulated serial devices: a base and a laser that repeat what was recorded."""

import json
import math
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_mp import REQUIRED, Module, setting
from robbie_mp.logs.recording.carmen import CarmenLog
from robbie_mp.logs.recording.carmen_records import NO_RETURN_M, LaserRecord, OdometryRecord
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.create import EmulatedCreate
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.hw.emulation.lms2xx import BITS_PER_BYTE, TURN_S, EmulatedLms2xx
from robbie_robots.hw.emulation.recorded import RecordedBody, RecordedDrive, recorded_drive
from robbie_robots.modules.devices.carmen_playback import CarmenPlayback
from robbie_robots.modules.devices.offered_port import offered_port

BIT_RATE = 38_400
TURNS_PER_SCAN = 8
"""The line is busy with a scan of one degree between beams for more than seven turns of the mirror."""
SETTLE_S = 2.0
"""Time between the start of both streams and that of the drive, and after its end."""

Array = NDArray[np.float64]


class EmulatedLog(Module):
    """An emulated Create 2 and an emulated SICK LMS2xx that repeat a CARMEN log, in real time.

    The drivers find them at the ports `run:NAME_base` and `run:NAME_laser`, with this module's name; the
    scanner has 180 degrees by 1 and sends at 38,400 bit/s, some nine scans each second. It sees nothing in
    those that were not recorded. The drive starts when both drivers have started their streams.

    On an ordered stop the module writes `played.txt`: lines of `t ipc_time`, s, when each odometry record was
    played and its own stamp; and `played.json` with the number of scans, recorded and sent.
    """

    file: Path = setting(REQUIRED, "the log", must_exist=True)
    rate: float = setting(4.0, "speed as a multiple of real time", minimum=0.1, maximum=10.0)
    period_s: float = setting(0.1, "time between looks at the drive", minimum=0.01)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the whole log once, so that what is no log is reported before anything starts."""
        CarmenPlayback.check(settings)

    def setup(self) -> None:
        """Read the log and plug both devices in."""
        self.records = list(CarmenLog(self.file).drive())
        self.drive = drive_of(self.records, self.rate)
        self.scanner = EmulatedLms2xx(self.measure)
        self.base = EmulatedCreate(body=RecordedBody(self.drive, lambda: self.start_s))
        self.start_s = math.inf
        self.first_scan_s: float | None = None
        self.sent: set[int] = set()
        busy = Faults(bytes_per_s=BIT_RATE / BITS_PER_BYTE)
        self.lines = [
            EmulatedLine(self.base, PseudoTerminal(self.link("base"))),
            EmulatedLine(self.scanner, PseudoTerminal(self.link("laser")), busy),
        ]
        for line in self.lines:
            line.__enter__()

    def link(self, device: str) -> Path:
        """Return where a device's port is."""
        link = offered_port(self.output_directory, f"{self.name}_{device}")
        link.parent.mkdir(exist_ok=True)
        link.unlink(missing_ok=True)  # a killed predecessor has left it
        return link

    def since_start_s(self) -> float:
        """Return the time since the start of the drive; negative before it."""
        return time.monotonic() - self.start_s

    def measure(self, _number: int, angles_rad: Array) -> Array:
        """Return the ranges of the scan that has just been measured; the line's thread calls it."""
        ranges = np.full(len(angles_rad), np.inf)
        began_s = self.scanner.clock.true_s(self.scanner.scans_began_s)
        self.first_scan_s = began_s if self.first_scan_s is None else self.first_scan_s
        if math.isinf(self.start_s):
            return ranges
        number = round((began_s - self.start_s) / self.drive.sweep_period_s)
        recorded = self.drive.sweeps.get(number)
        if recorded is not None:
            self.sent.add(number)
            ranges[: len(recorded)] = recorded
            ranges[ranges >= NO_RETURN_M] = np.inf
        return ranges

    def tick(self) -> None:
        """Start the drive when both devices send, and end after it."""
        now_s = time.monotonic()
        if not self.base.is_streaming or self.first_scan_s is None:
            self.status = "waiting for the drivers"
        elif math.isinf(self.start_s):
            # With a scan, a while later: until then, the drivers find out how late frames are.
            scans = math.ceil((now_s + SETTLE_S - self.first_scan_s) / self.drive.sweep_period_s)
            self.start_s = self.first_scan_s + scans * self.drive.sweep_period_s
        else:
            share = min(1.0, max(0.0, self.since_start_s() / max(self.drive.duration_s, 1e-9)))
            self.status = f"{share:.0%} driven, {len(self.sent)} of {len(self.drive.sweeps)} scans sent"
        if self.since_start_s() > self.drive.duration_s + SETTLE_S:
            self.log.info("the log ended: %s", self.status)
            self.stop()

    def teardown(self) -> None:
        """Pull the devices out; write when what was played."""
        for line in self.lines:
            line.__exit__(None, None, None)
        if not math.isinf(self.start_s):
            start_s = self.clock.now_ns() / 1e9 - self.since_start_s()
            rows = [
                (start_s + played_s, record.ipc_time_s)
                for played_s, record in zip(self.drive.times_s, self.records, strict=True)
                if isinstance(record, OdometryRecord)
            ]
            with self.result_file("played.txt") as file:
                np.savetxt(file, np.array(rows), "%.6f")
            counts = {"scans": len(self.drive.sweeps), "sent": len(self.sent)}
            self.write_result("played.json", json.dumps(counts) + "\n")


def drive_of(records: list[OdometryRecord | LaserRecord], rate: float) -> RecordedDrive:
    """Return the drive of a log."""
    poses = np.array(
        [
            record.robot_pose
            if isinstance(record, LaserRecord)
            else (record.x_m, record.y_m, record.theta_rad)
            for record in records
        ]
    )
    sweeps = [record.ranges_m if isinstance(record, LaserRecord) else None for record in records]
    stamps_s = [record.logger_time_s for record in records]
    return recorded_drive(stamps_s, poses, sweeps, TURNS_PER_SCAN * TURN_S, rate)
