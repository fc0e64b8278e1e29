"""A log of numbered commands, and of a battery's state in its first version."""

from pathlib import Path

from robbie_mp.messages import DriveCommand, message_type_from_schema
from tests.logs.recording._support.logs import START_NS, STEP_NS, LogFile

BATTERY = "played_msgs/msg/Battery"
STRANGER = "other_msgs/msg/Stranger"


def write_battery_log(path: Path, count: int, *, battery_version: int = 1) -> Path:
    """Write commands 1, 2, 3 …, 0.1 s apart; after every fifth a battery, and a type that nobody knows."""
    battery = message_type_from_schema(BATTERY, "float32 percent", battery_version)
    stranger = message_type_from_schema(STRANGER, "float32 number")
    with LogFile(path, chunk_size=1000) as log:
        for number in range(1, count + 1):
            at_ns = START_NS + (number - 1) * STEP_NS
            log.add(DriveCommand(linear_m_per_s=number), sender="pilot", time_ns=at_ns)
            if number % 5 == 0:
                log.add(battery(percent=50.0), "battery", "power", time_ns=at_ns + 1)
                log.add(stranger(number=number), "strange", "power", time_ns=at_ns + 2)
        log.add(DriveCommand(linear_m_per_s=-1), "own", "witness", time_ns=at_ns)
    return path
