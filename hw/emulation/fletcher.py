"""The 8-bit Fletcher checksum (RFC 1145), which MIP and UBX share."""


def fletcher(data: bytes) -> bytes:
    """Return the two checksum bytes."""
    first = second = 0
    for byte in data:
        first = first + byte & 0xFF
        second = second + first & 0xFF
    return bytes([first, second])
