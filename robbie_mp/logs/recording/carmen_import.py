"""Makes a log of a CARMEN log."""

from pathlib import Path

from robbie_mp.base.balance import Balance
from robbie_mp.logs.recording.carmen import CarmenLog
from robbie_mp.logs.recording.carmen_messages import nanoseconds
from robbie_mp.logs.recording.conversion import Conversion, NewChannel, converted_log
from robbie_mp.logs.recording.errors import LogUnreadable
from robbie_mp.logs.recording.format import ChannelKey, TopicNames
from robbie_mp.logs.recording.repair import Progress
from robbie_mp.messages import Message, schema_text

PARAMETERS_METADATA = "carmen_parameters"
"""Name of the metadata record with the parameters of the robot's programs."""


def import_carmen(source: Path, target: Path, balance: Balance, *, progress: Progress) -> None:
    """Write a log from a CARMEN log, on the topics of `robbie_robots.modules.devices.carmen_playback`.

    Messages are published when their lines were recorded: the first one at its sensor's time, the others
    later by the interval that the recorder noted. The stamps in the messages are the sensors' own.

    Args:
        source: the CARMEN log.
        target: the new file.
        balance: counts messages, and lines that are left out.
        progress: counts bytes.

    Raises:
        NotALog: the source is no CARMEN log.
        LogUnreadable: the source cannot be read.
        LogNotWritten: the target exists, or cannot be written.
        LeftOut: the balance allows no loss.
    """
    carmen_log = CarmenLog(source, balance)
    try:
        size = source.stat().st_size
        parameters = carmen_log.parameters
    except OSError as error:
        raise LogUnreadable(f"{source} cannot be read: {error.strerror}") from error
    with converted_log(target, source, balance) as conversion:
        topics = TopicNames()
        start_ns: int | None = None
        for logger_s, ipc_s, message, topic in carmen_log.messages():
            if start_ns is None:
                start_ns = nanoseconds(ipc_s) - nanoseconds(logger_s)
            _add(conversion, topics, message, topic, max(0, start_ns + nanoseconds(logger_s)))
            progress(carmen_log.bytes_read, size)
        if parameters:
            conversion.note(PARAMETERS_METADATA, parameters)


def _add(conversion: Conversion, topics: TopicNames, message: Message, topic: str, time_ns: int) -> None:
    kind = type(message)
    key = ChannelKey(kind.type_name, kind.version, topic, "")
    channel = NewChannel(topics.of(key), kind.type_name, schema_text(kind))
    conversion.add(channel, key.metadata(), time_ns, message.encode())
