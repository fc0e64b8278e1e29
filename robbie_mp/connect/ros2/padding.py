"""The bytes that DDS adds behind a message, so that its length is a multiple of four."""

from robbie_mp.messages import DecodeError, Message

MAX_PADDING = 3
_HEADER = b"\x00\x01\x00\x00"


def unpadded(message: Message, data: bytes) -> bytes:
    """Return the bytes of a message without padding, and without the bits that tell of it.

    Args:
        message: the decoded message.
        data: its bytes.

    Raises:
        DecodeError: there are more bytes than padding can be.
    """
    size = message.encoded_size()
    if len(data) - size > MAX_PADDING:
        raise DecodeError(f"{message.type_name}: {len(data) - size} bytes follow the message")
    return data if len(data) == size and data.startswith(_HEADER) else _HEADER + data[len(_HEADER) : size]
