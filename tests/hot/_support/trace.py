"""Traces of the test build: every store in turn, by Python or by C."""

import struct

ENTRY = struct.Struct("=IIQ")
WAKE = 2**32 - 1


def described(trace: bytes) -> list[str]:
    """Say what was stored where, one line for each store."""
    return [
        f"woke {value}" if words == WAKE else f"words {words}: [{index}] = {value:#x}"
        for words, index, value in ENTRY.iter_unpack(trace)
    ]
