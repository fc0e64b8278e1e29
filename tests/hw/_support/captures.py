"""Bytes recorded from real devices, which are not part of the project."""

import os
from pathlib import Path

import pytest

from robbie_robots.hw.framing import Frame, FrameDecoder

CAPTURES = Path(os.environ.get("ROBBIE_CAPTURES", "no-captures"))
needs_captures = pytest.mark.skipif(
    not CAPTURES.is_dir(), reason="NOT TESTED: set ROBBIE_CAPTURES to the folder of recorded device bytes"
)


def decoded_in_pieces(decoder: FrameDecoder[Frame], data: bytes, size: int = 7) -> list[Frame]:
    """Feed a decoder as a serial port would: a few bytes at a time."""
    return [frame for i in range(0, len(data), size) for frame in decoder.feed(data[i : i + size])]
