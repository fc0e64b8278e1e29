"""A robot's reports to the tools of ROS: its trace as /rosout, and its figures as /diagnostics."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from robbie_mp.messages import Log, Message, ModuleProfile, SystemProfile, Time, from_dict
from robbie_mp.messages.message import fields_of
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.trace.reader import TraceFollower

LEVELS: Final = {Kind.ERROR: Log.ERROR, Kind.WARNING: Log.WARN, Kind.INFO: Log.INFO, Kind.SYSTEM: Log.DEBUG}
FATAL: Final = "CRITICAL"
"""The level of Python's loggers that is FATAL in ROS."""
MAX_LINES = 200
"""Most entries of the trace that are passed on at a time; further ones are counted."""
OK, WARN, ERROR = 0, 1, 2
STATES: Final = {"RUNNING": OK, "STOPPED": OK, "STARTING": WARN, "BACKOFF": ERROR, "FAILED": ERROR}
LOSSES: Final = {"restarts": "restarted", "lost": "messages were lost in a crash"}
"""Counters of a module that rise when it has crashed, and what that means; its health tells of the others."""
MIN_FREE: Final = 0.05
"""Ratio of free memory below which the machine's status is a warning."""
DIAGNOSTICS: Final = message_type_from_schema(
    "diagnostic_msgs/msg/DiagnosticArray",
    """std_msgs/Header header
DiagnosticStatus[] status
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: diagnostic_msgs/DiagnosticStatus
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
KeyValue[] values
================================================================================
MSG: diagnostic_msgs/KeyValue
string key
string value
""",
)


class TraceLines:
    """The new entries of a run's trace, as messages for /rosout.

    Args:
        output_directory: where the run writes its results.

    Attributes:
        skipped: entries that were not passed on because there were too many at a time.
    """

    def __init__(self, output_directory: Path):
        self._follower = TraceFollower(output_directory)
        self._follower.read_new()  # what was logged before this bridge started is old
        self.skipped = 0

    def read_new(self) -> Iterator[Log]:
        """Yield what was logged since the last call: the newest, if there is too much."""
        found = self._follower.read_new()
        self.skipped += max(0, len(found) - MAX_LINES)
        yield from map(log_line, found[-MAX_LINES:])


def log_line(entry: Entry) -> Log:
    """Return an entry of the trace as ROS's message.

    Args:
        entry: something that a process logged or printed.
    """
    file, _, line = entry.where.rpartition(":")
    is_own = entry.logger in ("", entry.module)
    return Log(
        stamp=Time.from_nanoseconds(round(entry.time_s * 1e9)),
        level=Log.FATAL if entry.level == FATAL else LEVELS[entry.kind],
        name=entry.module if is_own else f"{entry.module}.{entry.logger}",
        msg=f"{entry.text}\n{entry.traceback}".rstrip("\n"),
        file=file,
        line=int(line) if line.isdecimal() and len(line) < 9 else 0,
    )


class Diagnosis:
    """Judges a run by its figures, for /diagnostics.

    Args:
        name: what stands before the names of all statuses.
        hardware: what the statuses are about, such as the run.
    """

    def __init__(self, name: str, hardware: str):
        self._name, self._hardware = name, hardware
        self._before: dict[str, ModuleProfile] = {}

    def of(self, profile: SystemProfile) -> Message:
        """Return a diagnostic_msgs/DiagnosticArray with the state of the machine and of each module.

        Args:
            profile: the figures since the last call.
        """
        statuses = [self._machine(profile), *map(self._module, profile.modules)]
        self._before = {one.name: one for one in profile.modules}
        stamp = {"sec": profile.stamp.sec, "nanosec": profile.stamp.nanosec}
        return from_dict(DIAGNOSTICS, {"header": {"stamp": stamp}, "status": statuses})

    def _module(self, module: ModuleProfile) -> dict[str, object]:
        before = self._before.get(module.name, module)
        problems = [text for name, text in LOSSES.items() if getattr(module, name) > getattr(before, name)]
        problems += [module.health] if module.health else []
        level = max(STATES.get(module.state, WARN), WARN if problems else OK)
        values = {one.name: getattr(module, one.name) for one in fields_of(ModuleProfile)}
        message = ", ".join([module.state, *problems])
        return self._status(module.name, level, message, values)

    def _machine(self, profile: SystemProfile) -> dict[str, object]:
        memory = _ratio(profile.memory_available_bytes, profile.memory_total_bytes)
        used = profile.shared_memory_used_bytes
        shared = 1.0 - _ratio(used, profile.shared_memory_total_bytes) if used else 1.0
        problems = [
            text
            for text, free in (("memory is nearly full", memory), ("shared memory is nearly full", shared))
            if free < MIN_FREE
        ]
        values = {
            "cpu_percent": max(profile.cpu_percent, default=math.nan),
            "load_1_min": next(iter(profile.load), math.nan),
            "memory_available_bytes": profile.memory_available_bytes,
            "shared_memory_used_bytes": used,
            "routed_hz": profile.routed_hz,
            "messages_on_their_way": profile.messages_on_their_way,
        }
        return self._status("machine", WARN if problems else OK, ", ".join(problems) or "OK", values)

    def _status(self, name: str, level: int, message: str, values: dict[str, object]) -> dict[str, object]:
        return {
            "level": level,
            "name": f"{self._name}: {name}",
            "message": message,
            "hardware_id": self._hardware,
            "values": [
                {"key": key, "value": f"{value:.6g}" if isinstance(value, float) else str(value)}
                for key, value in values.items()
            ],
        }


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else 1.0
