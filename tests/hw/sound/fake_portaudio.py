"""A stand-in for sounddevice, with devices that a test plugs in and out."""

import time
from collections import deque
from typing import Any

LIMIT_S = 20.0


class FakePortAudio:
    """The part of sounddevice that the drivers use. It finds devices only when it is initialized."""

    class PortAudioError(Exception):
        pass

    def __init__(self) -> None:
        self.devices = {"USB"}
        self.known: set[str] = set()
        self.heard: deque[bytes] = deque()
        self.played: list[bytes] = []
        self.overflows = False
        self.is_slow = False
        self.waiting_samples = 0
        self.open_streams = 0
        self.settings: dict[str, Any] = {}
        self.RawInputStream = lambda **settings: FakeStream(self, settings)
        self.RawOutputStream = self.RawInputStream

    def _terminate(self) -> None:
        self.known = set()

    def _initialize(self) -> None:
        self.known = set(self.devices)


class FakeStream:
    def __init__(self, library: FakePortAudio, settings: dict[str, Any]) -> None:
        if not any(settings["device"] in name for name in library.known):
            raise ValueError(f"No device matching {settings['device']!r}")
        if settings["channels"] > 2:
            raise library.PortAudioError("Invalid number of channels")
        self.library, self.is_started, self.is_closed = library, False, False
        library.settings = settings
        library.open_streams += 1

    @property
    def read_available(self) -> int:
        return self.library.waiting_samples

    def start(self) -> None:
        self.is_started = True

    def read(self, frames: int) -> tuple[bytes, bool]:
        self._wait(lambda: bool(self.library.heard))
        data = self.library.heard.popleft()
        assert len(data) == 2 * frames * self.library.settings["channels"]
        return data, self.library.overflows

    def write(self, data: bytes) -> bool:
        self._wait(lambda: not self.library.is_slow)
        self.library.played.append(data)
        return False

    def close(self) -> None:
        assert not self.is_closed
        self.is_closed = True
        self.library.open_streams -= 1

    def _wait(self, condition: Any) -> None:
        give_up_s = time.monotonic() + LIMIT_S
        while True:
            if not self.library.devices:
                raise self.library.PortAudioError("Unanticipated host error")
            if condition():
                return
            assert time.monotonic() < give_up_s
            time.sleep(0.001)
