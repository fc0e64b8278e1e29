"""Microphone and loudspeaker by PortAudio, on a stand-in for its library."""

import sys
import time
from collections.abc import Callable
from contextlib import closing

import numpy as np
import pytest

from robbie_robots.hw.sound.portaudio import Microphone, SoundLibraryMissing, Speaker, portaudio
from robbie_robots.hw.sound.sound import SoundBlock, SoundFormat
from tests.hw.sound.fake_portaudio import LIMIT_S, FakePortAudio

STEREO = SoundFormat(1000, 2)
BLOCK = np.arange(40, dtype=np.int16).reshape(20, 2)


def until(condition: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.001)


def heard(microphone: Microphone, library: FakePortAudio) -> SoundBlock:
    library.heard.append(BLOCK.tobytes())
    give_up_s = time.monotonic() + LIMIT_S
    while not (blocks := microphone.poll(0.01)):
        assert time.monotonic() < give_up_s
    return blocks[0]


def end(library: FakePortAudio) -> None:
    """Let a call that waits return, so that the driver can end."""
    library.devices.clear()


def test_microphone_gives_blocks_stamped_at_their_first_sample() -> None:
    library = FakePortAudio()
    library.waiting_samples, library.overflows = 500, True
    with closing(Microphone("USB", STEREO, block_s=0.02, clock=lambda: 100.0, library=library)) as microphone:
        block = heard(microphone, library)
        np.testing.assert_array_equal(block.samples, BLOCK)
        assert block.stamp_s == pytest.approx(100.0 - 0.52)
        assert microphone.overflows == 1
        assert library.settings["blocksize"] == 20 and library.settings["samplerate"] == 1000
        end(library)
    assert library.open_streams == 0


def test_microphone_is_found_again_after_it_was_pulled_out() -> None:
    library = FakePortAudio()
    with closing(Microphone("USB", STEREO, library=library)) as microphone:
        heard(microphone, library)
        library.devices.clear()
        until(lambda: not microphone.is_connected)
        assert microphone.poll() == []
        until(lambda: "No device matching 'USB'" in microphone.reason)
        library.devices.add("USB Audio")
        heard(microphone, library)
        assert (microphone.counters.connections, microphone.counters.losses) == (2, 1)
        end(library)


def test_impossible_format_is_told() -> None:
    library = FakePortAudio()
    with closing(Microphone("USB", SoundFormat(1000, 9), library=library)) as microphone:
        microphone.poll()
        until(lambda: "not yet" not in microphone.reason)
        assert microphone.reason == "USB cannot be used with 1000 Hz, 9 channels: Invalid number of channels"


def test_speaker_plays_in_order_and_drops_the_oldest_beyond_its_bound() -> None:
    library = FakePortAudio()
    with closing(Speaker("USB", STEREO, block_s=0.02, longest_s=0.06, library=library)) as speaker:
        speaker.play(BLOCK)
        assert speaker.dropped_samples == 20  # it is not connected yet
        until(lambda: bool(speaker.poll()))
        library.is_slow = True
        library.played.clear()
        for number in range(6):
            speaker.play(np.full((20, 2), number + 1, np.int16))
        assert speaker.waiting_s <= 0.06
        library.is_slow = False
        until(lambda: speaker.waiting_s == 0 and np.full((20, 2), 6, np.int16).tobytes() in library.played)
        told = [data[0] for data in library.played if any(data)]
        assert told == sorted(told) and told[-3:] == [4, 5, 6]
        assert speaker.dropped_samples == 20 * (1 + 6 - len(told))
        assert speaker.played_samples == 20 * len(told)
        until(lambda: library.played[-1] == bytes(80))  # silence between
        end(library)


def test_sound_that_waited_for_a_lost_speaker_is_dropped() -> None:
    library = FakePortAudio()
    with closing(Speaker("USB", STEREO, library=library)) as speaker:
        until(lambda: bool(speaker.poll()))
        library.is_slow = True
        speaker.play(np.ones((1000, 2), np.int16))
        library.devices.clear()
        until(lambda: not speaker.is_connected)
        assert speaker.waiting_s == 0 and not speaker.play(BLOCK)
        library.is_slow = False
        library.devices.add("USB")
        library.played.clear()
        until(lambda: bool(speaker.poll()) and bool(library.played))
        assert not any(map(any, library.played))
        end(library)


def test_samples_of_another_shape_are_refused() -> None:
    speaker = Speaker("USB", STEREO, library=FakePortAudio())
    with pytest.raises(ValueError, match="for 1000 Hz, 2 channels"):
        speaker.play(np.zeros(10, np.int16))


def test_missing_library_is_told_with_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(SoundLibraryMissing, match="pip install sounddevice"):
        Microphone()

    class NoPortAudio:
        def find_spec(self, name: str, path: object, target: object = None) -> None:
            if name == "sounddevice":
                raise OSError("PortAudio library not found")

    monkeypatch.delitem(sys.modules, "sounddevice")
    monkeypatch.setattr(sys, "meta_path", [NoPortAudio(), *sys.meta_path])
    with pytest.raises(SoundLibraryMissing, match="sudo apt install libportaudio2"):
        portaudio()
