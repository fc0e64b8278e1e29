"""The page knows what modules tell of their lights, and asks the module that switches each."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robbie_mp.messages import LightsState, Message, SetLight
from robbie_mp.station.panels.light_controls import turn
from robbie_mp.station.watch.lights import MAX_LIGHTS, MAX_MODULES, LightId, LightsWatch

HEAD, REAR = LightId("lamps", "head", True), LightId("board", "rear", False)


class Source:
    """The part of a station that the watch uses."""

    def __init__(self) -> None:
        self.envelope = SimpleNamespace(topic="")
        self._handler: Callable[[Any], None]

    def hear(self, _message_type: type[Message], handler: Callable[[Any], None], _topic: str = "") -> None:
        self._handler = handler

    def tell(self, module: str, brightness: dict[str, float], *, can_dim: bool = True) -> None:
        self.envelope.topic = module
        values = np.array([*brightness.values()])
        self._handler(LightsState(name=[*brightness], brightness=values, can_dim=can_dim))


@pytest.fixture
def source() -> Source:
    return Source()


@pytest.fixture
def watch(source: Source) -> LightsWatch:
    return LightsWatch(source)  # type: ignore[arg-type]


def test_brightness_is_known_while_its_module_tells_it(
    source: Source, watch: LightsWatch, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    source.tell("lamps", {"head": 0.4})
    now_s[0] += 1.5
    source.tell("board", {"rear": 1.0}, can_dim=False)
    assert watch.shown() == {HEAD: 0.4, REAR: 1.0}
    now_s[0] += 1.0
    assert watch.shown() == {HEAD: None, REAR: 1.0}
    now_s[0] += 1.5
    assert not watch.are_on, "nobody knows whether a light shines whose module is silent"


def test_all_lights_are_switched_off_if_one_shines_and_on_if_all_are_dark(
    source: Source, watch: LightsWatch
) -> None:
    asked: list[tuple[str, str, float]] = []

    def ask(request: SetLight, _what: str, *, topic: str) -> None:
        asked.append((topic, request.name, request.brightness))

    page: Any = SimpleNamespace(ask=ask)
    source.tell("lamps", {"head": 0.0})
    source.tell("board", {"rear": 1.0}, can_dim=False)
    turn(watch, page)
    assert asked == [("lamps", "head", 0.0), ("board", "rear", 0.0)]
    source.tell("board", {"rear": 0.0}, can_dim=False)
    turn(watch, page)
    assert asked[2:] == [("lamps", "head", 1.0), ("board", "rear", 1.0)]


def test_number_of_lights_and_modules_is_bounded(source: Source, watch: LightsWatch) -> None:
    for number in range(MAX_MODULES + 3):
        source.tell(f"module{number}", {"head": 1.0})
    assert len(watch.shown()) == MAX_MODULES
    source.tell("module0", {f"light{number}": 1.0 for number in range(MAX_LIGHTS + 5)})
    assert len(watch.shown()) == MAX_LIGHTS
