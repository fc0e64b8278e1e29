"""The robot's microphone and loudspeaker, real and simulated."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_mp import REQUIRED, Module, SettingError, Time, setting
from robbie_mp.base.linux.private_files import make_private_file
from robbie_mp.messages import RawAudio
from robbie_robots.hw.simulation.sound import NotWav, WavMicrophone, WavSpeaker
from robbie_robots.hw.sound.portaudio import Microphone, Speaker
from robbie_robots.hw.sound.sound import SoundBlock, SoundFormat
from robbie_robots.modules.devices.pluggable import ReconnectingDeviceModule

PCM = "pcm-s16"


def message(block: SoundBlock, sound: SoundFormat) -> RawAudio:
    """Return the message of a block."""
    return RawAudio(
        timestamp=Time.from_nanoseconds(round(block.stamp_s * 1e9)),
        data=np.ascontiguousarray(block.samples).view(np.uint8).ravel(),
        format=PCM,
        sample_rate=sound.rate_hz,
        number_of_channels=sound.channels,
    )


class MicrophoneModule(ReconnectingDeviceModule[SoundBlock]):
    """A microphone; publishes `RawAudio` on a topic named after the module, and `DeviceState`."""

    device_name: str = setting("", "part of the name that `python -m sounddevice` shows; empty: the default")
    rate_hz: int = setting(16_000, "samples each second", minimum=1_000, maximum=192_000)
    channels: int = setting(1, "channels", minimum=1, maximum=32)
    block_s: float = setting(0.02, "length of a block", minimum=0.005, maximum=1.0)
    silence_s: float = setting(
        2.0, "the device counts as disconnected when it sends nothing for this time", minimum=0.1
    )

    @property
    def place(self) -> str:
        """Return the device's name."""
        return self.device_name or "the default device"

    def open_device(self) -> Microphone:
        """Return the driver."""
        self.sound = SoundFormat(self.rate_hz, self.channels)
        self.microphone = Microphone(
            self.device_name, self.sound, block_s=self.block_s, clock=self.time_s, silence_s=self.silence_s
        )
        return self.microphone

    def on_value(self, value: SoundBlock) -> None:
        """Publish a block."""
        self.publish(message(value, self.sound), topic=self.name)

    def status_line(self) -> str:
        """Return the line that `robbie top` shows."""
        if not self.microphone.is_connected:
            return super().status_line()
        heard = self.microphone
        return (
            f"{heard.counters.values} blocks, {heard.dropped} dropped, {heard.overflows} overflows, "
            f"lost {heard.counters.losses} times"
        )


class HearingModule(Module):
    """A module that plays `RawAudio` of a topic with its own name. Other formats are refused and counted."""

    rate_hz: int = setting(16_000, "samples each second", minimum=1_000, maximum=192_000)
    channels: int = setting(1, "channels", minimum=1, maximum=32)

    def listen(self) -> None:
        """Subscribe to what is to be played."""
        self.refused = 0
        self.sound = SoundFormat(self.rate_hz, self.channels)
        self.subscribe(RawAudio, self.on_audio, topic=self.name, optional=True)

    def on_audio(self, audio: RawAudio) -> None:
        """Play a block if it has the right format."""
        told = SoundFormat(audio.sample_rate, audio.number_of_channels)
        if audio.format != PCM or told != self.sound or audio.data.size % (2 * self.channels):
            self.refused += 1
            if self.refused == 1:
                self.log.error(
                    "refused sound from %s: %s with %s and %d bytes; this plays %s with %s",
                    self.envelope.sender,
                    audio.format,
                    told,
                    audio.data.size,
                    PCM,
                    self.sound,
                )
            return
        # A copy: the sound waits longer than the message should.
        self.play(np.frombuffer(audio.data.tobytes(), "<i2").reshape(-1, self.channels))

    def play(self, samples: NDArray[np.int16]) -> None:
        """Play samples: (samples, channels)."""
        raise NotImplementedError


class SpeakerModule(HearingModule, ReconnectingDeviceModule[int]):
    """A loudspeaker: see `HearingModule`. Publishes `DeviceState` on a topic named after the module."""

    wait_s = 0.0

    device_name: str = setting("", "part of the name that `python -m sounddevice` shows; empty: the default")
    block_s: float = setting(0.02, "length of the blocks that are played", minimum=0.005, maximum=1.0)
    longest_s: float = setting(2.0, "longest sound that may wait", minimum=0.1, maximum=60.0)
    silence_s: float = setting(
        2.0, "the device counts as disconnected when it takes nothing for this time", minimum=0.1
    )
    period_s: float = setting(0.05, "time between looks at the device", minimum=0.005)

    @property
    def place(self) -> str:
        """Return the device's name."""
        return self.device_name or "the default device"

    def setup(self) -> None:
        """Create the driver."""
        super().setup()
        self.listen()

    def open_device(self) -> Speaker:
        """Return the driver."""
        self.speaker = Speaker(
            self.device_name,
            SoundFormat(self.rate_hz, self.channels),
            block_s=self.block_s,
            longest_s=self.longest_s,
            silence_s=self.silence_s,
        )
        return self.speaker

    def on_value(self, value: int) -> None:
        """Do nothing: these are the samples that were played."""

    def play(self, samples: NDArray[np.int16]) -> None:
        """Play samples."""
        self.speaker.play(samples)

    def status_line(self) -> str:
        """Return the line that `robbie top` shows."""
        if not self.speaker.is_connected:
            return super().status_line()
        played = self.speaker
        return (
            f"{played.played_samples / self.rate_hz:.1f} s played, {played.waiting_s:.1f} s waiting, "
            f"{played.dropped_samples / self.rate_hz:.1f} s dropped, {self.refused} refused, "
            f"lost {played.counters.losses} times"
        )


class SimulatedMicrophoneModule(Module):
    """A microphone that hears a WAV file again and again; publishes what `MicrophoneModule` does."""

    file: Path = setting(REQUIRED, "the WAV file, 16 bits", must_exist=True)
    block_s: float = setting(0.02, "length of a block", minimum=0.005, maximum=1.0)
    period_s: float = setting(0.02, "time between looks at the clock", minimum=0.001)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the file, so that a mistake in it is reported before anything starts."""
        file = settings["file"]
        assert isinstance(file, Path)
        try:
            WavMicrophone(file, 0.0)
        except (NotWav, OSError) as error:
            raise SettingError(str(error), "file") from error

    def setup(self) -> None:
        """Begin the file."""
        self.microphone = WavMicrophone(self.file, self.clock.now_ns() / 1e9, self.block_s)
        self.blocks = 0

    def tick(self) -> None:
        """Publish the blocks that have ended."""
        for block in self.microphone.read(self.clock.now_ns() / 1e9):
            self.publish(message(block, self.microphone.format), topic=self.name)
            self.blocks += 1
        self.status = f"{self.blocks} blocks, {self.microphone.dropped} dropped"


class SimulatedSpeakerModule(HearingModule):
    """A loudspeaker that records what it plays into a WAV file with its name: see `HearingModule`."""

    longest_s: float = setting(600.0, "length of the file at most", minimum=0.1)
    period_s: float = setting(1.0, "time between status lines", minimum=0.01)

    def setup(self) -> None:
        """Begin the file."""
        self.listen()
        self.output_directory.mkdir(parents=True, exist_ok=True)
        path = self.output_directory / f"{self.name}.wav"
        path.unlink(missing_ok=True)  # a link is not followed
        file = make_private_file(path)  # not `result_file`: what was recorded stays if this process is killed
        self.speaker = WavSpeaker(file, self.sound, self.clock.now_ns() / 1e9, self.longest_s)

    def play(self, samples: NDArray[np.int16]) -> None:
        """Record samples."""
        self.speaker.play(samples, self.clock.now_ns() / 1e9)

    def tick(self) -> None:
        """Say how much was recorded."""
        recorded_s, dropped_s = (
            count / self.rate_hz for count in (self.speaker.recorded_samples, self.speaker.dropped_samples)
        )
        self.status = f"{recorded_s:.1f} s recorded, {dropped_s:.1f} s dropped, {self.refused} refused"

    def teardown(self) -> None:
        """Finish the file."""
        self.speaker.close()
