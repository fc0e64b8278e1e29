"""Converts a CARMEN log to a log: odometry, scans, and the position of the laser."""

from pathlib import Path

from robbie_mp.messages import Message, schema_text
from robbie_mp.recording.carmen import CarmenLog, OdometryRecord, Record
from robbie_mp.recording.carmen_messages import laser_place, odometry_message, scan_message
from robbie_mp.recording.conversion import Conversion, NewChannel, converted_log
from robbie_mp.recording.errors import LogUnreadable
from robbie_mp.recording.format import ChannelKey, TopicNames
from robbie_mp.recording.repair import Progress

ODOMETRY_TOPIC = "odom"
PLACE_TOPIC = "tf_static"


def import_carmen(source: Path, target: Path, *, skip_broken: bool, progress: Progress) -> Conversion:
    """Write a log from a CARMEN log, on the topics on which `modules.playback` publishes it.

    Messages are published when their lines were recorded: the first one at its sensor's time, the others
    later by the interval that the recorder noted. The stamps in the messages are the sensors' own.

    Args:
        source: the CARMEN log.
        target: the new file.
        skip_broken: skip lines that cannot be read, rather than raise.
        progress: counts bytes.

    Raises:
        BrokenLine: a line cannot be read.
        LogUnreadable: the source cannot be read.
        LogNotWritten: the target exists, or cannot be written.
    """
    carmen_log = CarmenLog(source, skip_broken=skip_broken)
    try:
        size = source.stat().st_size
        source.open("rb").close()
    except OSError as error:
        raise LogUnreadable(f"{source} cannot be read: {error.strerror}") from error
    with converted_log(target, source) as conversion:
        topics = TopicNames()
        start_ns: int | None = None
        for record in carmen_log:
            if start_ns is None:
                start_ns = _nanoseconds(record.ipc_time_s) - _nanoseconds(record.logger_time_s)
                time_ns = start_ns + _nanoseconds(record.logger_time_s)
                _add(conversion, topics, laser_place(carmen_log.parameters), PLACE_TOPIC, time_ns)
            time_ns = start_ns + _nanoseconds(record.logger_time_s)
            _add(conversion, topics, *_message(record), time_ns)
            progress(carmen_log.bytes_read, size)
        if carmen_log.broken_lines:
            conversion.left_out["broken lines"] = carmen_log.broken_lines
    return conversion


def _message(record: Record) -> tuple[Message, str]:
    if isinstance(record, OdometryRecord):
        return odometry_message(record), ODOMETRY_TOPIC
    return scan_message(record), ""


def _add(conversion: Conversion, topics: TopicNames, message: Message, topic: str, time_ns: int) -> None:
    kind = type(message)
    key = ChannelKey(kind.type_name, kind.version, topic, "")
    channel = NewChannel(topics.of(key), kind.type_name, schema_text(kind))
    conversion.add(channel, key.metadata(), time_ns, message.encode())


def _nanoseconds(seconds: float) -> int:
    return round(seconds * 1e6) * 1000
