"""Writes a log from messages that were recorded elsewhere, in another format."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.writer import Writer

from robbie_mp.base.balance import Balance
from robbie_mp.base.linux.private_files import make_private_file
from robbie_mp.logs.recording.errors import LogError, LogNotWritten
from robbie_mp.logs.recording.format import MESSAGE_ENCODING, PROFILE, SCHEMA_ENCODING

LIBRARY = "robbie import"
"""Not the library name of recordings: a recording may be removed to make room when the disk is full."""
IMPORT_METADATA = "robbie_import"
"""Name of the metadata record that names the source of the messages."""


class NewChannel(NamedTuple):
    """A channel as it will be in the new log."""

    topic: str
    """With a leading slash."""
    type_name: str
    schema: str
    sender: str = ""
    robot_topic: str = ""
    """The topic in the robot, if it is another one; such channels stay apart."""


class Conversion:
    """The new log. `converted_log` makes one.

    Attributes:
        balance: number of messages written, and of those that could not be read or converted, by reason.
    """

    def __init__(self, writer: Writer, balance: Balance):
        self.balance = balance
        self._writer = writer
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[NewChannel, int] = {}

    def add(self, channel: NewChannel, metadata: dict[str, str], time_ns: int, data: bytes) -> None:
        """Write a message.

        Args:
            channel: its channel.
            metadata: metadata of the channel, used with its first message.
            time_ns: when the message was published.
            data: its encoding.
        """
        if channel not in self._channels:
            self._channels[channel] = self._open(channel, metadata)
        self.balance.use()
        sequence = self.balance.used & 0xFFFFFFFF
        self._writer.add_message(self._channels[channel], time_ns, data, time_ns, sequence)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self._writer.add_metadata(name, values)

    def _open(self, channel: NewChannel, metadata: dict[str, str]) -> int:
        schema = (channel.type_name, channel.schema)
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(
                channel.type_name, SCHEMA_ENCODING, channel.schema.encode()
            )
        return self._writer.register_channel(channel.topic, MESSAGE_ENCODING, self._schemas[schema], metadata)


@contextlib.contextmanager
def converted_log(target: Path, source: Path, balance: Balance) -> Iterator[Conversion]:
    """Make a log of the messages added inside this context. If that fails, no log is left.

    Args:
        target: the new file.
        source: the source of the messages, for the log's metadata.
        balance: counts the messages.

    Raises:
        LogNotWritten: the target exists, or cannot be written.
    """
    with new_log_file(target) as file:
        writer = Writer(file)
        writer.start(PROFILE, LIBRARY)
        writer.add_metadata(IMPORT_METADATA, {"source": source.name})
        yield Conversion(writer, balance)
        writer.finish()  # type: ignore[no-untyped-call]
        file.flush()
        os.fsync(file.fileno())


@contextlib.contextmanager
def new_log_file(target: Path) -> Iterator[BinaryIO]:
    """Make a file for a log, and remove it if this context ends with an error.

    Raises:
        LogNotWritten: the target exists, or cannot be written.
    """
    try:
        file = make_private_file(target.parent.resolve() / target.name)
    except OSError as error:
        raise LogNotWritten(f"{target} cannot be written: {error.strerror}") from error
    try:
        with file:
            yield file
    except BaseException as error:
        target.unlink()
        if isinstance(error, OSError) and not isinstance(error, LogError):
            raise LogNotWritten(f"{target} cannot be written: {error.strerror}") from error
        raise
