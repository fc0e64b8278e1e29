"""Fills in what logs from other programs do not state."""

from robbie_mp.messages import Message, message_type_from_schema
from robbie_mp.messages.errors import MessageError
from robbie_mp.messages.schema import layout


def version_of_foreign(ours: type[Message], schema: str) -> int:
    """Return the version of a type with a ros2msg text: our class's if both have the same layout, else 1."""
    try:
        same = layout(message_type_from_schema(ours.type_name, schema)) == layout(ours)
    except MessageError:
        return 1
    return ours.version if same else 1
