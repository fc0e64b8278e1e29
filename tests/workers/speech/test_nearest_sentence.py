"""The sentence of a grammar that sounds most like what was heard."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.workers.speech import nearest_sentence
from robbie_robots.workers.speech.nearest_sentence import GrammarTooLarge, NearestSentence
from robbie_robots.workers.speech.order_grammar import OrderGrammar
from robbie_robots.workers.speech.pronunciation import distance, phonemes

DICTIONARY = {
    "bring": "B R IH NG",
    "me": "M IY",
    "a": "AH",
    "cup": "K AH P",
    "cub": "K AH B",
    "red": "R EH D",
    "box": "B AA K S",
    "stop": "S T AA P",
    "step": "S T EH P",
}
GRAMMAR = OrderGrammar(
    {"bring": ["bring [me] (a | red) <object>"], "stop": ["stop"]}, {"object": ["cup", "red box"]}
)
SENTENCES = [
    " ".join(filter(None, ["bring", *each])) for each in product(("me", ""), ("a", "red"), ("cup", "red box"))
] + ["stop"]


def sounds(text: str) -> list[str]:
    return phonemes(text.split(), DICTIONARY.get)


@pytest.fixture(scope="module")
def nearest() -> NearestSentence:
    return NearestSentence(GRAMMAR, DICTIONARY.get)


@pytest.mark.parametrize("sentence", SENTENCES)
def test_sentence_of_the_grammar_is_found_exactly(sentence: str, nearest: NearestSentence) -> None:
    assert nearest.find(sounds(sentence)) == sentence


@pytest.mark.parametrize(
    ("heard", "sentence"),
    [
        ("step", "stop"),
        ("bring me a cub", "bring me a cup"),
        ("bring a box", "bring a red box"),
        ("bring red cub", "bring red cup"),
        ("", "stop"),
    ],
)
def test_similar_sounds_give_the_nearest_sentence(
    heard: str, sentence: str, nearest: NearestSentence
) -> None:
    assert nearest.find(sounds(heard)) == sentence


@given(
    st.lists(
        st.sampled_from(["B", "R", "IH", "NG", "M", "IY", "AH", "K", "P", "S", "T", "AA", "?x"]), max_size=14
    )
)
def test_no_other_sentence_is_nearer(heard: list[str]) -> None:
    found = NearestSentence(GRAMMAR, DICTIONARY.get).find(heard)
    assert found in SENTENCES

    def changes(sentence: str) -> float:
        told = sounds(sentence)
        return distance(told, heard) * max(len(told), len(heard))

    assert changes(found) == pytest.approx(min(map(changes, SENTENCES)))


def test_grammar_that_takes_too_long_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nearest_sentence, "MAX_NODES", 20)
    with pytest.raises(GrammarTooLarge, match="more than 20 phonemes"):
        NearestSentence(GRAMMAR, DICTIONARY.get)
