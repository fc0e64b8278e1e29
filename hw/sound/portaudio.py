"""Microphones and loudspeakers through PortAudio (sounddevice)."""

import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.connection.background import BackgroundDevice, T
from robbie_robots.hw.connection.errors import DeviceFault
from robbie_robots.hw.sound.sound import SoundBlock, SoundFormat


class SoundFault(DeviceFault):
    """The device is not there, is in use, or has not the wanted format."""


class SoundLibraryMissing(ImportError):
    """sounddevice, or PortAudio itself, is not installed."""


def portaudio() -> ModuleType:
    """Return sounddevice.

    Raises:
        SoundLibraryMissing: it is not installed, or the library PortAudio is not.
    """
    try:
        import sounddevice  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise SoundLibraryMissing("sound needs sounddevice: pip install sounddevice") from error
    except OSError as error:  # it looks for PortAudio when it is imported
        raise SoundLibraryMissing("sound needs PortAudio: sudo apt install libportaudio2") from error
    return sounddevice  # type: ignore[no-any-return]


class SoundDevice(BackgroundDevice[T]):
    """A stream of PortAudio.

    PortAudio is started again at each connection, because it does not see new devices otherwise. So a process
    can have one stream only.

    Args:
        device: a part of the device's name, as `python -m sounddevice` shows it; "": the system's default.
        wanted: rate and channels.
        block_s: length of a block.
        silence_s: see `BackgroundDevice`.
        library: for tests, in place of sounddevice.
    """

    def __init__(
        self,
        device: str = "",
        wanted: SoundFormat | None = None,
        *,
        block_s: float = 0.02,
        silence_s: float = 2.0,
        library: Any = None,
    ) -> None:
        super().__init__(device or "the default device", silence_s=silence_s, kept=50)
        self.wanted = wanted or SoundFormat()
        self.block_samples = max(1, round(block_s * self.wanted.rate_hz))
        self._library = library or portaudio()
        self._device = device or None
        self._stream: Any = None

    def _open(self) -> None:
        library = self._library
        try:
            library._terminate()
            library._initialize()
            self._stream = self._stream_class(
                samplerate=self.wanted.rate_hz,
                channels=self.wanted.channels,
                blocksize=self.block_samples,
                dtype="int16",
                device=self._device,
            )
            self._stream.start()
        except (library.PortAudioError, ValueError) as error:
            raise SoundFault(f"{self.name} cannot be used with {self.wanted}: {error}") from error

    @property
    @abstractmethod
    def _stream_class(self) -> Any:
        """Return the library's class of streams in this direction."""

    def _called(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call the library; a failure is the loss of the device."""
        try:
            return call(*arguments)
        except self._library.PortAudioError as error:
            raise SoundFault(f"{self.name} broke: {error}") from error

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            self._called(stream.close)


class Microphone(SoundDevice[SoundBlock]):
    """A microphone: `poll` returns blocks of sound.

    Args:
        device: see `SoundDevice`.
        wanted: likewise.
        block_s: likewise.
        clock: the time for stamps, s.
        silence_s: see `BackgroundDevice`.
        library: see `SoundDevice`.

    Raises:
        SoundLibraryMissing: see `portaudio`.

    Example:
        with closing(Microphone("USB")) as microphone:
            for block in microphone.poll(1.0):
                print(abs(block.samples).max())
    """

    def __init__(
        self,
        device: str = "",
        wanted: SoundFormat | None = None,
        *,
        block_s: float = 0.02,
        clock: Callable[[], float] = time.time,
        silence_s: float = 2.0,
        library: Any = None,
    ) -> None:
        super().__init__(device, wanted, block_s=block_s, silence_s=silence_s, library=library)
        self.overflows = 0
        """How often PortAudio has lost sound, because it was not read in time."""
        self._clock = clock

    @property
    def _stream_class(self) -> Any:
        return self._library.RawInputStream

    def _read(self) -> SoundBlock:
        data, has_overflowed = self._called(self._stream.read, self.block_samples)
        # What waits was recorded after this block. The device's own delay cannot be seen.
        recorded = self.block_samples + self._stream.read_available
        stamp_s = self._clock() - recorded / self.wanted.rate_hz
        self.overflows += bool(has_overflowed)
        samples = np.frombuffer(bytes(data), "<i2").reshape(-1, self.wanted.channels)
        return SoundBlock(stamp_s, samples)


class Speaker(SoundDevice[int]):
    """A loudspeaker that plays blocks one after the other, and silence between them.

    If more sound waits than `longest_s`, the oldest is dropped, and counted. So is all that waits when the
    loudspeaker is lost.

    Args:
        device: see `SoundDevice`.
        wanted: likewise.
        block_s: likewise.
        longest_s: as much sound may wait.
        silence_s: see `BackgroundDevice`.
        library: see `SoundDevice`.

    Raises:
        SoundLibraryMissing: see `portaudio`.

    Example:
        with closing(Speaker()) as speaker:
            speaker.poll(1.0)
            speaker.play(np.zeros((16_000, 1), np.int16))
    """

    def __init__(
        self,
        device: str = "",
        wanted: SoundFormat | None = None,
        *,
        block_s: float = 0.02,
        longest_s: float = 2.0,
        silence_s: float = 2.0,
        library: Any = None,
    ) -> None:
        super().__init__(device, wanted, block_s=block_s, silence_s=silence_s, library=library)
        self.played_samples = 0
        self.dropped_samples = 0
        """Samples that were dropped because too much sound waited, or because the loudspeaker was lost."""
        self._most = round(longest_s * self.wanted.rate_hz)
        self._waiting: deque[NDArray[np.int16]] = deque()
        self._waiting_samples = 0

    @property
    def waiting_s(self) -> float:
        """Return the length of the sound that waits."""
        return self._waiting_samples / self.wanted.rate_hz

    def play(self, samples: NDArray[np.int16]) -> bool:
        """Play sound after that which waits.

        Args:
            samples: (samples, channels).

        Returns:
            Whether it will be played: not without a loudspeaker.

        Raises:
            ValueError: the number of channels is not the loudspeaker's.
        """
        if samples.ndim != 2 or samples.shape[1] != self.wanted.channels:
            raise ValueError(f"samples of shape {samples.shape} for {self.wanted}")
        with self._changed:
            if not self.is_connected:
                self.dropped_samples += len(samples)
                return False
            for begin in range(0, len(samples), self.block_samples):
                self._waiting.append(samples[begin : begin + self.block_samples])
            self._waiting_samples += len(samples)
            while self._waiting_samples > self._most:
                self._drop_oldest()
            self._changed.notify_all()
        return True

    @property
    def _stream_class(self) -> Any:
        return self._library.RawOutputStream

    def _read(self) -> int:
        """Play one block, or silence."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._waiting or self._is_ending, self.block_samples / self.wanted.rate_hz
            )
            samples = self._waiting.popleft() if self._waiting else None
            self._waiting_samples -= 0 if samples is None else len(samples)
        if samples is None:
            silence = np.zeros((self.block_samples, self.wanted.channels), np.int16)
            self._called(self._stream.write, silence.tobytes())
            return 0
        self._called(self._stream.write, np.ascontiguousarray(samples, "<i2").tobytes())
        self.played_samples += len(samples)
        return len(samples)

    def _lose(self, reason: str) -> None:
        while self._waiting:
            self._drop_oldest()
        super()._lose(reason)

    def _drop_oldest(self) -> None:
        dropped = len(self._waiting.popleft())
        self._waiting_samples -= dropped
        self.dropped_samples += dropped
