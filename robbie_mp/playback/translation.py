"""Brings messages of a log to the versions that a run's classes have."""

import importlib
from collections.abc import Iterable
from typing import NamedTuple

from robbie_mp.messages import Message, VersionDecoder, stock_registry
from robbie_mp.messages.descriptions import TypeDescription, own_classes
from robbie_mp.recording.reader import LogChannel


class RunTypes:
    """The message types that the processes of a run have classes of.

    Args:
        own: the robot's own types, each with the file that declares it; that is imported when it is needed.
    """

    def __init__(self, own: Iterable[TypeDescription]):
        self._stock = stock_registry()
        self._own = {one.name: one for one in own if one.python_module}

    def describe(self, name: str) -> TypeDescription | None:
        """Return what is known of a type; None if nobody has a class of it."""
        return TypeDescription.of(self._stock.get(name)) if name in self._stock else self._own.get(name)

    def load(self, name: str) -> type[Message]:
        """Return the class of a type that `describe` knows.

        Raises:
            UnknownType: its file does not declare it any more.
            Exception: whatever its file raises when it is imported.
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
    """None: as they are."""

    def translate(self, data: bytes) -> bytes:
        """Return a message of the channel as it is published.

        Raises:
            VersionError: a step from one version to the next fails.
            DecodeError: the bytes are no encoding of the version they should have.
        """
        return data if self.decoder is None else self.decoder.decode(data).encode()


def translation_of(channel: LogChannel, types: RunTypes) -> Translation:
    """Return how the messages of a channel are published.

    Raises:
        VersionError: what was written cannot become what the class is: it is newer, a step is missing, or it
            has other fields under the same version.
        SchemaError: the log's schema, which that takes, is not understood.
    """
    as_they_are = Translation(channel.version, None)
    ours = types.describe(channel.type_name)
    if ours is None or (ours.version, ours.schema) == (channel.version, channel.schema):
        return as_they_are
    decoder = VersionDecoder(types.load(channel.type_name), channel.version, channel.schema)
    return as_they_are if channel.version == ours.version else Translation(ours.version, decoder)
