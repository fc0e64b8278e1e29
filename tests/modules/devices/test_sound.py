"""The modules of microphones and loudspeakers, real and simulated."""

import logging
import wave
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_mp import ModuleHarness, SettingError, Time
from robbie_mp.messages import DeviceState, RawAudio
from robbie_robots.hw.sound import portaudio
from robbie_robots.modules.devices.sound import (
    MicrophoneModule,
    SimulatedMicrophoneModule,
    SimulatedSpeakerModule,
    SpeakerModule,
)
from tests.hw.sound.fake_portaudio import FakePortAudio

TONE = (10_000 * np.sin(np.arange(800) / 5)).astype(np.int16)


@pytest.fixture
def tone(tmp_path: Path) -> Path:
    file = tmp_path / "tone.wav"
    with wave.open(str(file), "wb") as opened:
        opened.setnchannels(1)
        opened.setsampwidth(2)
        opened.setframerate(8000)
        opened.writeframes(TONE.tobytes())
    return file


def audio(samples: NDArray[np.int16], rate_hz: int = 8000, kind: str = "pcm-s16") -> RawAudio:
    data = samples.astype("<i2").view(np.uint8)
    return RawAudio(timestamp=Time(), data=data, format=kind, sample_rate=rate_hz, number_of_channels=1)


def test_simulated_microphone_says_its_file_again_and_again(tone: Path) -> None:
    with ModuleHarness(SimulatedMicrophoneModule, {"file": tone}, name="microphone") as microphone:
        microphone.advance(0.31)
        blocks = microphone.take(RawAudio, "microphone")
    assert {(block.format, block.sample_rate, block.number_of_channels) for block in blocks} == {
        ("pcm-s16", 8000, 1)
    }
    samples = np.concatenate([block.data.view("<i2") for block in blocks])
    np.testing.assert_array_equal(samples, np.tile(TONE, 4)[: len(samples)])
    assert len(samples) in (2240, 2400)
    stamps = [block.timestamp.nanoseconds for block in blocks]
    assert np.diff(stamps) == pytest.approx([20_000_000] * (len(blocks) - 1), abs=2)


def test_simulated_speaker_records_sound_with_the_silence_between(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    settings = {"rate_hz": 8000, "longest_s": 0.5}
    with (
        caplog.at_level(logging.ERROR),
        ModuleHarness(SimulatedSpeakerModule, settings, name="speaker", output_directory=tmp_path) as speaker,
    ):
        speaker.send(audio(TONE), topic="speaker")
        speaker.advance(0.2)
        speaker.send(audio(TONE, 44_100), topic="speaker")
        speaker.send(audio(TONE, kind="opus"), topic="speaker")
        speaker.send(audio(TONE), topic="speaker")
        speaker.advance(1.0)
        speaker.send(audio(TONE), topic="speaker")
        speaker.advance(1.0)
        assert speaker.module.status == "0.5 s recorded, 0.1 s dropped, 2 refused"
    assert caplog.text.count("refused sound from") == 1
    with wave.open(str(tmp_path / "speaker.wav"), "rb") as opened:
        assert (opened.getframerate(), opened.getnchannels()) == (8000, 1)
        samples = np.frombuffer(opened.readframes(10_000), "<i2")
    assert len(samples) == 4000
    np.testing.assert_array_equal(samples[:800], TONE)
    assert not samples[800:1600].any()
    np.testing.assert_array_equal(samples[1600:2400], TONE)


def test_file_that_is_no_sound_is_refused_before_the_start(tmp_path: Path) -> None:
    (tmp_path / "text.wav").write_text("no sound")
    with pytest.raises(SettingError, match="is no WAV file"):
        ModuleHarness(SimulatedMicrophoneModule, {"file": tmp_path / "text.wav"})


def test_real_microphone_and_speaker_speak_the_same_message(monkeypatch: pytest.MonkeyPatch) -> None:
    library = FakePortAudio()
    monkeypatch.setattr(portaudio, "portaudio", lambda: library)
    settings = {"device_name": "USB", "rate_hz": 8000}
    with ModuleHarness(MicrophoneModule, settings, name="microphone") as microphone:
        library.heard.extend([TONE[:160].tobytes()])
        blocks: list[RawAudio] = []
        while not blocks:
            microphone.advance(0.005)
            blocks = microphone.take(RawAudio, "microphone")
        np.testing.assert_array_equal(blocks[0].data.view("<i2"), TONE[:160])
        states = microphone.take(DeviceState)
        assert states[-1].state == "CONNECTED" and states[-1].port == "USB"
        library.devices.clear()
    library.devices.add("USB")
    with ModuleHarness(SpeakerModule, settings, name="speaker") as speaker:
        while not [state for state in speaker.take(DeviceState) if state.state == "CONNECTED"]:
            speaker.advance(0.05)
        library.played.clear()
        speaker.send(blocks[0], topic="speaker")
        while TONE[:160].tobytes() not in library.played:
            speaker.advance(0.05)
        library.devices.clear()
