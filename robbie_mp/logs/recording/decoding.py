"""Decodes messages of a log: as they were written, or as this program's present classes."""

from robbie_mp.logs.recording.errors import NotDecodable
from robbie_mp.logs.recording.format import MESSAGE_ENCODING
from robbie_mp.logs.recording.reader import LogChannel, LoggedMessage, version_of_foreign
from robbie_mp.messages import Message, TypeRegistry, message_type_from_schema, stock_registry
from robbie_mp.messages.versions import VersionDecoder


def logged_type(channel: LogChannel) -> type[Message]:
    """Return the message type of a channel as it was when the log was written.

    Raises:
        NotDecodable: its messages are not CDR, or the log has no schema for them.
        SchemaError: the schema is not understood.
    """
    if channel.encoding != MESSAGE_ENCODING:
        raise NotDecodable(
            f"messages of topic {channel.topic!r} are encoded as {channel.encoding!r}; "
            f"only {MESSAGE_ENCODING!r} can be read"
        )
    if channel.schema is None:
        raise NotDecodable(
            f"the log has no schema (ros2msg) of {channel.type_name or 'the type'} of topic {channel.topic!r}"
        )
    return message_type_from_schema(channel.type_name, channel.schema, channel.version)


class LogDecoder:
    """Decodes messages of a log to this program's classes, and upgrades older versions.

    For an unknown type it makes a class from the schema in the log.

    Args:
        types: the types that the program knows; by default the stock types.
    """

    def __init__(self, types: TypeRegistry | None = None):
        self._types = stock_registry() if types is None else types
        self._decoders: dict[LogChannel, VersionDecoder[Message]] = {}

    def decode(self, logged: LoggedMessage) -> Message:
        """Return the message.

        Raises:
            VersionError: it is newer than the class, or an upgrade step to our version is missing or fails.
            DecodeError: its bytes do not encode its type.
            NotDecodable, SchemaError: as `logged_type`.
        """
        decoder = self._decoders.get(logged.channel)
        if decoder is None:
            decoder = self._decoders[logged.channel] = self._decoder(logged.channel)
        return decoder.decode(logged.data)

    def _decoder(self, channel: LogChannel) -> VersionDecoder[Message]:
        written = logged_type(channel)
        if channel.type_name not in self._types:
            return VersionDecoder(written, channel.version, channel.schema)
        ours = self._types.get(channel.type_name)
        version = version_of_foreign(ours, channel.schema) if channel.is_foreign else channel.version
        return VersionDecoder(ours, version, channel.schema)
