"""Orders of the household robot: how a sentence is read, and what is refused before the robot moves."""

import pytest

from robbie_robots.workers.home.orders import (
    MAX_TASKS,
    OrderReader,
    Task,
    TaskOrder,
    WrongOrder,
    check_orders,
)
from robbie_robots.workers.speech.order_grammar import WrongGrammar

SENTENCES = {
    "bring": ["[please] (bring | get) me the <object>"],
    "put": ["put the <object> on the <place>", "put it on the <place>"],
    "go": ["go to the <place>"],
    "learn": ["this is the <place>"],
    "follow": ["follow me"],
    "stop": ["stop"],
}
WORDS = {"object": ["soup", "salt and pepper"], "place": ["kitchen", "desk"]}
BRING_SOUP, BRING_SALT = TaskOrder(Task.BRING, "soup"), TaskOrder(Task.BRING, "salt and pepper")
GO, FOLLOW = TaskOrder(Task.GO, place="kitchen"), TaskOrder(Task.FOLLOW)


@pytest.fixture
def reader() -> OrderReader:
    return OrderReader(SENTENCES, WORDS)


@pytest.mark.parametrize(
    ("text", "tasks"),
    [
        ("please get me the soup", [BRING_SOUP]),
        ("Go to the kitchen and bring me the soup", [GO, BRING_SOUP]),
        ("go to the kitchen and then bring me the soup then follow me", [GO, BRING_SOUP, FOLLOW]),
        ("bring me the salt and pepper and go to the kitchen", [BRING_SALT, GO]),
        ("put it on the desk", [TaskOrder(Task.PUT, place="desk")]),
    ],
)  # fmt: skip
def test_sentences_become_tasks(text: str, tasks: list[TaskOrder], reader: OrderReader) -> None:
    assert reader.read(text) == tasks


@pytest.mark.parametrize(
    "text",
    [
        "",
        "dance",
        "stop",
        "go to the moon",
        "go to the kitchen and",
        "go to the kitchen and dance",
        "and follow me",
        " ".join(["follow me"] * 60),
        " and ".join(["follow me"] * (MAX_TASKS + 1)),
    ],
)
def test_other_sentences_are_refused(text: str, reader: OrderReader) -> None:
    with pytest.raises(WrongOrder):
        reader.read(text)


def test_grammar_whose_task_lacks_its_place_in_the_sentence_is_refused() -> None:
    with pytest.raises(WrongGrammar, match='"bring it" of the order "bring" needs <object>'):
        OrderReader({"bring": ["bring it"]}, WORDS)


@pytest.mark.parametrize(
    ("orders", "holds", "reason"),
    [
        ([], "", "1 to 8 tasks"),
        ([TaskOrder(Task.BRING)], "", "which object"),
        ([TaskOrder(Task.GO)], "", "which place"),
        ([TaskOrder(Task.GO, place="moon")], "", "I do not know the place 'moon'; I know: desk, kitchen"),
        ([TaskOrder(Task.PUT, place="desk")], "", "I hold nothing"),
        ([TaskOrder(Task.PUT, place="desk")] * 2, "soup", "I hold nothing"),
        ([BRING_SOUP], "tea", "I hold the tea"),
    ],
)
def test_order_that_the_robot_cannot_begin_is_refused(
    orders: list[TaskOrder], holds: str, reason: str
) -> None:
    with pytest.raises(WrongOrder, match=reason):
        check_orders(orders, ["kitchen", "desk"], holds)


def test_order_may_go_to_a_place_that_it_has_learnt_before() -> None:
    check_orders([TaskOrder(Task.LEARN, place="sofa"), TaskOrder(Task.GO, place="sofa")], [], "")
    check_orders([BRING_SOUP, BRING_SOUP], [], "soup")
