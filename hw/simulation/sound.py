"""A microphone that plays a WAV file, and a loudspeaker that records one."""

import wave
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.sound.sound import SoundBlock, SoundFormat


class NotWav(ValueError):
    """The file is no WAV file with samples of 16 bits, or it is empty."""


class WavMicrophone:
    """Hears a WAV file, again and again.

    Args:
        file: the file, 16 bits; rate and channels are the microphone's.
        start_s: time of the file's first sample.
        block_s: length of a block.

    Raises:
        NotWav: see there.
        OSError: the file cannot be read.
    """

    # A clock that leaps does not make it say more than this at once.
    MAX_BLOCKS = 50

    def __init__(self, file: Path, start_s: float, block_s: float = 0.02) -> None:
        try:
            with wave.open(str(file), "rb") as opened:
                if opened.getsampwidth() != 2 or not opened.getnframes():
                    raise NotWav(f"{file} has no samples of 16 bits")
                self.format = SoundFormat(opened.getframerate(), opened.getnchannels())
                data = opened.readframes(opened.getnframes())
        except (wave.Error, EOFError) as error:
            raise NotWav(f"{file} is no WAV file: {error}") from error
        self.dropped = 0
        """Blocks that were skipped because the clock has leapt."""
        self._samples = np.frombuffer(data, "<i2").reshape(-1, self.format.channels)
        self._block = max(1, round(block_s * self.format.rate_hz))
        self._start_s, self._next = start_s, 0

    def read(self, now_s: float) -> list[SoundBlock]:
        """Return the blocks that have ended by now."""
        ended = int((now_s - self._start_s) * self.format.rate_hz + 1e-6) // self._block
        if ended - self._next > self.MAX_BLOCKS:
            self.dropped += ended - self._next - self.MAX_BLOCKS
            self._next = ended - self.MAX_BLOCKS
        blocks = []
        for number in range(self._next, ended):
            first = number * self._block
            places = np.arange(first, first + self._block) % len(self._samples)
            blocks.append(SoundBlock(self._start_s + first / self.format.rate_hz, self._samples[places]))
        self._next = max(self._next, ended)
        return blocks


class WavSpeaker:
    """Records what it plays, with the silence between, into a WAV file.

    Args:
        file: the file, open for writing; `close` closes it.
        wanted: rate and channels.
        start_s: time of the file's first sample.
        longest_s: the file is no longer than this.
    """

    def __init__(self, file: BinaryIO, wanted: SoundFormat, start_s: float, longest_s: float = 600.0) -> None:
        self.wanted, self.recorded_samples, self.dropped_samples = wanted, 0, 0
        self._start_s, self._most = start_s, round(longest_s * wanted.rate_hz)
        self._opened = file
        self._file = wave.open(file, "wb")  # noqa: SIM115 - `close` closes it
        self._file.setnchannels(wanted.channels)
        self._file.setsampwidth(2)
        self._file.setframerate(wanted.rate_hz)

    def play(self, samples: NDArray[np.int16], now_s: float) -> None:
        """Play sound at this time, or after that which still plays.

        Args:
            samples: (samples, channels).
            now_s: the time.
        """
        since = round((now_s - self._start_s) * self.wanted.rate_hz)
        silence = max(0, min(since, self._most) - self.recorded_samples)
        kept = samples[: max(0, self._most - self.recorded_samples - silence)]
        self._file.writeframes(bytes(2 * self.wanted.channels * silence) + kept.astype("<i2").tobytes())
        self.recorded_samples += silence + len(kept)
        self.dropped_samples += len(samples) - len(kept)

    def close(self) -> None:
        """Finish the file."""
        self._file.close()
        self._opened.close()
