"""The robot's ear and voice, with a recogniser that a test tells what it hears."""

import logging
import shutil
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_mp import ModuleHarness, SettingError, Time
from robbie_mp.messages import RawAudio, TaughtNames
from robbie_robots.modules.speech import speech
from robbie_robots.modules.speech.messages import Say, SpokenOrder
from robbie_robots.modules.speech.speech import SpokenOrders, Voice
from robbie_robots.workers.speech.order_grammar import OrderGrammar
from robbie_robots.workers.speech.order_recognizer import RATE_HZ, Heard

SETTINGS = {
    "orders": {"bring": ["bring me the <object>"], "stop": ["stop"]},
    "words": {"object": ["cup", "orange juice"]},
    "confirm": ["bring"],
}
BLOCK_S = 0.1


class ToldRecognizer:
    """Hears what a test has put into `next_text`."""

    def __init__(
        self, grammars: dict[str, OrderGrammar], pronunciations: object, max_distance: float
    ) -> None:
        self.grammars, self.max_distance = grammars, max_distance
        self.next_text, self.next_distance = "", 0.1
        self.is_closed = False

    def use(self, name: str, grammar: OrderGrammar) -> None:
        self.grammars[name] = grammar

    def can_pronounce(self, text: str) -> bool:
        return "zzyx" not in text

    def recognize(self, samples: NDArray[np.int16], grammar: str) -> Heard:
        assert samples.ndim == 1 and samples.size > RATE_HZ / 4
        order = self.grammars[grammar].parse(self.next_text)
        is_near = self.next_distance <= self.max_distance
        return Heard(order if is_near else None, self.next_text, self.next_text, self.next_distance)

    def close(self) -> None:
        self.is_closed = True


def audio(
    samples: NDArray[np.int16], rate_hz: int = RATE_HZ, channels: int = 1, kind: str = "pcm-s16"
) -> RawAudio:
    data = np.frombuffer(samples.astype("<i2").tobytes(), np.uint8)
    return RawAudio(
        timestamp=Time(), data=data, format=kind, sample_rate=rate_hz, number_of_channels=channels
    )


class Robot:
    """A robot that hears what a test says."""

    def __init__(self, harness: ModuleHarness[SpokenOrders]) -> None:
        self.harness = harness

    @property
    def recognizer(self) -> ToldRecognizer:
        recognizer: object = self.harness.module.recognizer
        assert isinstance(recognizer, ToldRecognizer)
        return recognizer

    def hear(self, text: str, distance: float = 0.1) -> None:
        self.recognizer.next_text, self.recognizer.next_distance = text, distance
        for level, blocks in ((0, 3), (1000, 6), (0, 9)):
            for _ in range(blocks):
                self.harness.send(
                    audio(np.full(round(BLOCK_S * RATE_HZ), level, np.int16)), topic="microphone"
                )
                self.harness.advance(BLOCK_S)

    def said(self) -> list[str]:
        return [say.text for say in self.harness.take(Say)]

    def orders(self) -> list[SpokenOrder]:
        return self.harness.take(SpokenOrder)


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Iterator[Robot]:
    monkeypatch.setattr(speech, "OrderRecognizer", ToldRecognizer)
    monkeypatch.setattr(speech, "silero", lambda: lambda chunk: float(np.abs(chunk).max() > 100))
    with ModuleHarness(SpokenOrders, SETTINGS, name="orders") as harness:
        yield Robot(harness)


def test_order_that_needs_no_confirmation_is_published_at_once(robot: Robot) -> None:
    robot.hear("stop")
    (order,) = robot.orders()
    assert (order.order, order.text, order.slots, order.was_confirmed) == ("stop", "stop", [], False)
    assert robot.said() == []


def test_order_to_be_confirmed_counts_when_the_person_says_yes(robot: Robot) -> None:
    robot.hear("bring me the orange juice")
    assert robot.orders() == []
    assert robot.said() == ["Did you say: bring me the orange juice?"]
    robot.hear("yes")
    (order,) = robot.orders()
    assert (order.order, order.was_confirmed) == ("bring", True)
    assert [(slot.name, slot.words) for slot in order.slots] == [("object", "orange juice")]


def test_names_of_taught_objects_are_understood_until_they_are_forgotten(robot: Robot) -> None:
    robot.harness.send(TaughtNames(names=["Mint Tea", "cup", "zzyx", "no. 5"]), topic="objects")
    for text in ("bring me the mint tea", "bring me the cup", "bring me the zzyx"):
        robot.hear(text)
        robot.hear("yes")
    assert [order.text for order in robot.orders()] == ["bring me the mint tea", "bring me the cup"]
    robot.harness.send(TaughtNames(), topic="objects")
    robot.hear("bring me the mint tea")
    assert robot.said()[-1] != "Did you say: bring me the mint tea?"


def test_order_that_is_denied_is_not_published(robot: Robot) -> None:
    robot.hear("bring me the cup")
    robot.hear("no")
    assert robot.orders() == []
    assert robot.said()[-1] == "Then I do nothing."
    robot.hear("stop")
    assert [order.order for order in robot.orders()] == ["stop"]


def test_order_is_dropped_when_nobody_answers(robot: Robot) -> None:
    robot.hear("bring me the cup")
    robot.harness.advance(9.0)
    assert robot.said()[-1] == "I heard no answer, so I do nothing."
    robot.hear("yes")  # which is no order
    assert robot.orders() == []


def test_answer_that_has_begun_in_time_counts(robot: Robot) -> None:
    robot.hear("bring me the cup")
    robot.recognizer.next_text = "yes"
    robot.harness.advance(7.0)
    for level, blocks in ((1000, 6), (0, 9)):
        for _ in range(blocks):
            robot.harness.send(audio(np.full(1600, level, np.int16)), topic="microphone")
            robot.harness.advance(BLOCK_S)
    assert [order.was_confirmed for order in robot.orders()] == [True]


def test_robot_asks_again_when_the_answer_is_neither_yes_nor_no(robot: Robot) -> None:
    robot.hear("bring me the cup")
    robot.hear("yes", distance=0.9)
    assert robot.said()[-1] == "Please say yes or no."
    robot.hear("yes")
    assert len(robot.orders()) == 1


def test_speech_outside_the_grammar_is_refused_and_counted(robot: Robot) -> None:
    robot.hear("stop", distance=0.9)
    assert robot.orders() == []
    assert "1 refused" in robot.harness.module.status


def test_robot_does_not_listen_to_its_own_voice(robot: Robot) -> None:
    robot.harness.send(audio(np.zeros(RATE_HZ * 3, np.int16)), topic="loudspeaker")
    robot.hear("stop")  # 1.8 s
    assert robot.orders() == []
    robot.harness.advance(2.0)
    robot.hear("stop")
    assert len(robot.orders()) == 1


def test_first_channel_is_heard(robot: Robot) -> None:
    robot.recognizer.next_text = "stop"
    for level, blocks in ((0, 3), (1000, 6), (0, 9)):
        for _ in range(blocks):
            both = np.stack([np.full(1600, level), np.zeros(1600)], axis=1).astype(np.int16)
            robot.harness.send(audio(both.ravel(), channels=2), topic="microphone")
            robot.harness.advance(BLOCK_S)
    assert len(robot.orders()) == 1


@pytest.mark.parametrize(
    "wrong",
    [
        audio(np.zeros(800, np.int16), rate_hz=8000),
        audio(np.zeros(800, np.int16), kind="opus"),
        audio(np.zeros(801, np.int16), channels=2),
        audio(np.zeros(800, np.int16), channels=0),
    ],
)
def test_sound_of_a_wrong_format_is_refused_counted_and_logged_once(
    wrong: RawAudio, robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.ERROR):
        for _ in range(3):
            robot.harness.send(wrong, topic="microphone")
            robot.harness.advance(0.2)
    assert "3 blocks of a wrong format" in robot.harness.module.status
    assert len([record for record in caplog.records if "refused sound" in record.message]) == 1


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"orders": {"go": ["go to <place>"]}}, 'no words for "<place>"'),
        ({"orders": {"go": ["go"]}, "confirm": ["bring"]}, "there is no order bring"),
    ],
)
def test_mistake_in_the_grammar_is_found_before_the_robot_starts(
    settings: dict[str, object], text: str
) -> None:
    with pytest.raises(SettingError, match=text), ModuleHarness(SpokenOrders, settings):
        pass


@pytest.fixture
def voice(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleHarness[Voice]]:
    def length_of_text(text: str, rate_hz: int, *_: object) -> NDArray[np.int16]:
        return np.arange(len(text) * rate_hz // 10, dtype=np.int16)

    monkeypatch.setattr(speech, "speak", length_of_text)
    with ModuleHarness(Voice, {"max_waiting": 2}, name="voice") as harness:
        yield harness


def test_voice_sends_sound_as_fast_as_it_plays(voice: ModuleHarness[Voice]) -> None:
    voice.send(Say(text="x" * 30))  # 3 s
    voice.advance(1.0)
    first = np.concatenate([block.data.view("<i2") for block in voice.take(RawAudio, "loudspeaker")])
    assert RATE_HZ < len(first) < 1.4 * RATE_HZ
    voice.advance(3.0)
    rest = np.concatenate([block.data.view("<i2") for block in voice.take(RawAudio, "loudspeaker")])
    np.testing.assert_array_equal(np.concatenate([first, rest]), np.arange(3 * RATE_HZ, dtype=np.int16))


def test_voice_drops_the_oldest_texts_that_wait(voice: ModuleHarness[Voice]) -> None:
    for text in ("first", "second", "third", "fourth"):
        voice.send(Say(text=text))
    voice.send(Say(text="  "))
    voice.advance(3.0)
    assert "2 texts, 0 wait, 2 dropped" in voice.module.status


@pytest.mark.skipif(shutil.which("espeak-ng") is None, reason="espeak-ng is not installed")
def test_unknown_voice_is_refused() -> None:
    with pytest.raises(SettingError, match="espeak-ng failed"), ModuleHarness(Voice, {"voice": "nobody"}):
        pass
