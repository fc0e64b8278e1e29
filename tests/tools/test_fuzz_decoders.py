"""Every decoder of a device survives damaged bytes; the tool itself notices decoders that do not."""

from collections.abc import Sequence
from random import Random

import pytest

from tools.fuzz.decoders.fuzz import DecoderUnderTest, fuzz
from tools.fuzz.decoders.subjects import SUBJECTS

DAMAGED_BYTES = 10_000


@pytest.mark.parametrize("name", SUBJECTS)
def test_decoder_survives_damage_and_is_in_step_within_two_frames(name: str) -> None:
    outcome = fuzz(SUBJECTS[name], DAMAGED_BYTES, seed=1)
    assert outcome.failures == []
    assert outcome.damaged_bytes >= DAMAGED_BYTES
    assert outcome.most_lost <= 2


class Fragile:
    """A decoder that raises at a byte it does not know."""

    def feed(self, data: bytes) -> Sequence[str]:
        return [data.decode("ascii")]


class Deaf:
    """A decoder that never finds its way back."""

    def __init__(self) -> None:
        self.lost = False

    def feed(self, data: bytes) -> Sequence[bytes]:
        self.lost |= data != b"frame"
        return [] if self.lost else [data]


def frame(_random: Random) -> bytes:
    return b"frame"


def test_decoder_that_raises_is_reported() -> None:
    outcome = fuzz(DecoderUnderTest(Fragile, frame), DAMAGED_BYTES)
    assert "UnicodeDecodeError" in outcome.failures[0]


def test_decoder_that_stays_out_of_step_is_reported() -> None:
    outcome = fuzz(DecoderUnderTest(Deaf, frame), DAMAGED_BYTES)
    assert "5 intact frames lost" in outcome.failures[0]
