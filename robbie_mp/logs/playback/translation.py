"""Upgrades messages of a log to the versions of a run's classes."""

import importlib
from collections.abc import Iterable
from typing import NamedTuple

from robbie_mp.logs.recording.reader import LogChannel
from robbie_mp.messages import Message, VersionDecoder, stock_registry
from robbie_mp.messages.descriptions import TypeDescription, own_classes


class RunTypes:
    """The message types for which the processes of a run have classes.

    Args:
        own: the robot's own types, each with the file that declares it; the file is imported when needed.
    """

    def __init__(self, own: Iterable[TypeDescription]):
        self._stock = stock_registry()
        self._own = {one.name: one for one in own if one.python_module}

    def describe(self, name: str) -> TypeDescription | None:
        """Return the description of a type, or None if no process has a class for it."""
        return TypeDescription.of(self._stock.get(name)) if name in self._stock else self._own.get(name)

    def load(self, name: str) -> type[Message]:
        """Return the class of a type that `describe` knows.

        Raises:
            UnknownType: the file no longer declares the type.
            Exception: any exception that the file raises when it is imported.
        """
        if name in self._own and name not in self._stock:
            importlib.import_module(self._own[name].python_module)
            declared = {one.type_name: one for one in own_classes()}
            if name in declared:
                return declared[name]
        return self._stock.get(name)


class Translation(NamedTuple):
    """How messages of a channel are published."""

    version: int
    decoder: VersionDecoder[Message] | None
    """None: messages are published unchanged."""

    def translate(self, data: bytes) -> bytes:
        """Return a message of the channel in the form in which it is published.

        Raises:
            VersionError: a step from one version to the next fails.
            DecodeError: the bytes do not encode the expected version.
        """
        return data if self.decoder is None else self.decoder.decode(data).encode()


def translation_of(channel: LogChannel, types: RunTypes) -> Translation:
    """Return how the messages of a channel are published.

    Raises:
        VersionError: the recorded version cannot be upgraded to the class: it is newer, a step is missing, or
            it has other fields under the same version number.
        SchemaError: the upgrade needs the log's schema, which is not understood.
    """
    as_they_are = Translation(channel.version, None)
    ours = types.describe(channel.type_name)
    if ours is None or (ours.version, ours.schema) == (channel.version, channel.schema):
        return as_they_are
    message_type = types.load(channel.type_name)  # which may have gone back to an older version
    decoder = VersionDecoder(message_type, channel.version, channel.schema)
    is_ours = channel.version == message_type.version
    return as_they_are if is_ours else Translation(message_type.version, decoder)
