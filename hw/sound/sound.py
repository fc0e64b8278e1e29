"""Sound in blocks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class SoundFormat:
    """How sound is sampled, in 16 bits.

    Attributes:
        rate_hz: samples each second.
        channels: 1 or more.
    """

    rate_hz: int = 16_000
    channels: int = 1

    def __str__(self) -> str:
        return f"{self.rate_hz} Hz, {self.channels} channel{'s' if self.channels != 1 else ''}"


@dataclass(frozen=True)
class SoundBlock:
    """A piece of sound.

    Attributes:
        stamp_s: time of its first sample.
        samples: (samples, channels) int16.
    """

    stamp_s: float
    samples: NDArray[np.int16]
