"""Spoken orders, by the real recognisers: synthetic ones, and recordings of people."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from robbie_robots.workers.speech.order_grammar import OrderGrammar, WrongGrammar
from robbie_robots.workers.speech.order_recognizer import RATE_HZ, OrderRecognizer
from robbie_robots.workers.speech.utterances import UtteranceFinder, silero
from robbie_robots.workers.speech.voice import speak
from tools.trials.recognition.speech import CAFE, HOME, read_sound

RECORDINGS = Path(__file__).parents[3].parent / "shared" / "data" / "home" / "speech"

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]
needs_voice = pytest.mark.skipif(shutil.which("espeak-ng") is None, reason="espeak-ng is not installed")
needs_recordings = pytest.mark.skipif(not RECORDINGS.exists(), reason=f"no recordings at {RECORDINGS}")


@pytest.fixture(scope="module")
def recognizer() -> Iterator[OrderRecognizer]:
    made = OrderRecognizer({"home": HOME, "cafe": CAFE})
    yield made
    made.close()


@needs_voice
@pytest.mark.parametrize(
    ("text", "order"),
    [("stop", "stop"), ("this is the kitchen", "learn"), ("get me the orange juice", "bring")],
)
def test_spoken_order_is_understood_in_digital_silence(
    text: str, order: str, recognizer: OrderRecognizer
) -> None:
    silence = np.zeros(RATE_HZ, np.int16)
    sound = np.concatenate([silence, speak(text, RATE_HZ), silence])
    (utterance,) = UtteranceFinder(silero()).add(sound)
    heard = recognizer.recognize(utterance, "home")
    assert heard.order is not None and heard.order.order == order


@needs_voice
def test_words_that_come_later_are_understood_and_unknown_ones_change_nothing() -> None:
    orders = {"bring": ["bring me the <object>"]}
    recognizer = OrderRecognizer({"home": OrderGrammar(orders, {"object": ["soup"]})})
    sound = speak("bring me the orange juice", RATE_HZ)
    assert recognizer.recognize(sound, "home").order is None
    assert recognizer.can_pronounce("Orange juice") and not recognizer.can_pronounce("zzyx juice")
    recognizer.use("home", OrderGrammar(orders, {"object": ["soup", "orange juice"]}))
    with pytest.raises(WrongGrammar, match="does not know zzyx"):
        recognizer.use("home", OrderGrammar(orders, {"object": ["zzyx"]}))
    heard = recognizer.recognize(sound, "home").order
    assert heard is not None and heard.slots == {"object": "orange juice"}
    recognizer.close()


@needs_voice
def test_other_speech_is_refused(recognizer: OrderRecognizer) -> None:
    for text in ("what time is it", "my sister lives in paris", "the weather is nice today"):
        assert recognizer.recognize(speak(text, RATE_HZ), "home").order is None


@needs_recordings
def test_recorded_orders_of_people_are_understood(recognizer: OrderRecognizer) -> None:
    names = ["1e37483d-173a-4527-949c-317182a92d49", "7dbde3c5-6907-4592-b553-871ceb482fc8"]
    for name in names:
        heard = recognizer.recognize(read_sound(RECORDINGS / "coffee" / f"{name}.flac"), "cafe")
        assert heard.order is not None, heard


def test_silence_gives_no_order(recognizer: OrderRecognizer) -> None:
    assert recognizer.recognize(np.zeros(RATE_HZ, np.int16), "home").order is None


def test_word_that_no_dictionary_knows_needs_its_pronunciation() -> None:
    grammar = OrderGrammar({"go": ["go to robbiemp"]}, {})
    with pytest.raises(WrongGrammar, match="does not know robbiemp; write how each is pronounced"):
        OrderRecognizer({"orders": grammar})
    with pytest.raises(WrongGrammar, match='has the unknown phoneme "XX"'):
        OrderRecognizer({"orders": grammar}, {"robbiemp": "R XX"})
    OrderRecognizer({"orders": grammar}, {"robbiemp": "R AA B IY EH M P IY"}).close()
