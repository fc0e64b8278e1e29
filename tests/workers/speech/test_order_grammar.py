"""Grammars of spoken orders."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.workers.speech.order_grammar import (
    MAX_DEPTH,
    MAX_SENTENCES,
    OrderGrammar,
    SpokenWords,
    WrongGrammar,
)

WORDS = {"object": ["cup", "orange juice", "orange"], "place": ["kitchen", "kitchen table"]}
GRAMMAR = OrderGrammar(
    {
        "bring": ["[please] (bring | get) me (the | a) <object> [from the <place>]"],
        "go": ["go to the <place>"],
        "stop": ["stop", "stand still"],
    },
    WORDS,
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("stop", SpokenWords("stop", "stop")),
        ("Stand  still", SpokenWords("stop", "stand still")),
        ("get me a cup", SpokenWords("bring", "get me a cup", {"object": "cup"})),
        ("bring me the orange", SpokenWords("bring", "bring me the orange", {"object": "orange"})),
        (
            "please bring me the orange juice from the kitchen table",
            SpokenWords(
                "bring",
                "please bring me the orange juice from the kitchen table",
                {"object": "orange juice", "place": "kitchen table"},
            ),
        ),
    ],
)
def test_words_give_their_order_and_slots(text: str, expected: SpokenWords) -> None:
    assert GRAMMAR.parse(text) == expected


@pytest.mark.parametrize(
    "text", ["", "bring me", "bring the cup", "stop it", "go to the kitchen tables", "get mea cup"]
)
def test_words_outside_the_grammar_give_none(text: str) -> None:
    assert GRAMMAR.parse(text) is None


def test_grammar_is_written_as_jsgf() -> None:
    assert GRAMMAR.jsgf.splitlines() == [
        "#JSGF V1.0;",
        "grammar orders;",
        "public <order> = ([please] (bring | get) me (the | a) <object> [from the <place>]) "
        "| (go to the <place>) | (stop) | (stand still);",
        "<object> = cup | orange juice | orange;",
        "<place> = kitchen | kitchen table;",
    ]
    assert {"please", "juice", "table", "still"} <= GRAMMAR.vocabulary
    assert "object" not in GRAMMAR.vocabulary


@pytest.mark.parametrize(
    ("orders", "words", "text"),
    [
        ({}, {}, "no order"),
        ({"Go There": ["go"]}, {}, 'the order "Go There" needs a name'),
        ({"go": []}, {}, "has no sentence"),
        ({"go": [""]}, {}, "a choice without words"),
        ({"go": ["[go]"]}, {}, "may be empty"),
        ({"go": ["go to (a | )"]}, {}, "a choice without words"),
        ({"go": ["go [there"]}, {}, r'a "\[" without its "\]"'),
        ({"go": ["go there)"]}, {}, r'a "\)" that closes nothing'),
        ({"go": ["go to <place"]}, {}, r'"<" is no word'),
        ({"go": ["go to 5"]}, {}, '"5" is no word'),
        ({"go": ["go to <place>"]}, {}, 'no words for "<place>"; there are lists for: none'),
        ({"go": ["<place> <place>"]}, {"place": ["bed"]}, "twice"),
        ({"go": ["go"]}, {"place": []}, 'the list "place" has 0 words'),
        ({"go": ["go"]}, {"place": ["room 5"]}, '"room 5" in the list "place" is no word'),
        ({"go": ["(" * (MAX_DEPTH + 1) + "go" + ")" * (MAX_DEPTH + 1)]}, {}, "brackets within brackets"),
        ({"go": ["go"] * (MAX_SENTENCES + 1)}, {}, "at most 200 fit"),
    ],
)
def test_wrong_grammar_is_refused_with_its_place(
    orders: dict[str, list[str]], words: dict[str, list[str]], text: str
) -> None:
    with pytest.raises(WrongGrammar, match=text):
        OrderGrammar(orders, words)


@given(st.text(alphabet="ab []()|<>'5", max_size=30))
def test_any_sentence_is_read_or_refused(sentence: str) -> None:
    try:
        grammar = OrderGrammar({"order": [sentence]}, {"a": ["one"], "b": ["two"]})
    except WrongGrammar as error:
        assert "order" in str(error)
    else:
        assert grammar.parse("") is None


@given(st.text(max_size=30))
def test_any_words_are_read_or_refused(text: str) -> None:
    found = GRAMMAR.parse(text)
    assert found is None or re.fullmatch(r"[a-z ]+", found.text)
