"""What logs that others wrote leave unsaid."""

from robbie_mp.messages import Message, message_type_from_schema
from robbie_mp.messages.errors import MessageError
from robbie_mp.messages.schema import layout


def version_of_foreign(ours: type[Message], schema: str) -> int:
    """Say which version of a type a ros2msg text is: that of our class if both lay out alike, else 1."""
    try:
        same = layout(message_type_from_schema(ours.type_name, schema)) == layout(ours)
    except MessageError:
        return 1
    return ours.version if same else 1
