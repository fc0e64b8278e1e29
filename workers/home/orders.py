"""What a household robot can be told to do, and the sentences that say it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from strenum import StrEnum

from robbie_robots.workers.speech.order_grammar import OrderGrammar, SpokenWords, WrongGrammar, spoken

CONNECTIONS = ("and then", "then", "and")
"""What stands between two orders of a sentence."""
MAX_TASKS = 8
"""Tasks that one order may have."""
MAX_WORDS = 100


class Task(StrEnum):
    """What the robot can be told to do; the names are those of orders in a grammar."""

    BRING = "bring"
    """Fetch an object and hand it to the person who gave the order."""
    PUT = "put"
    """Put on a table what is in the hand, or an object that the robot fetches first."""
    GO = "go"
    """Drive to a place."""
    LEARN = "learn"
    """Give a name to the place where the robot stands."""
    FOLLOW = "follow"
    """Follow the person in front of the robot, until it is told to stop."""
    WHO = "who"
    """Look for persons, and say who is where."""


NEEDS_ARM = {Task.BRING, Task.PUT}
NEEDS_OBJECT = {Task.BRING}
NEEDS_PLACE = {Task.PUT, Task.GO, Task.LEARN}


class TaskOrder(NamedTuple):
    """One task: what to do, with which object and place; '' where it needs none."""

    task: Task
    object: str = ""
    place: str = ""

    @property
    def text(self) -> str:
        """Return the order in words, from the robot's point of view."""
        match self.task:
            case Task.BRING:
                return f"bring you the {self.object}"
            case Task.PUT:
                return f"put {f'the {self.object}' if self.object else 'it'} on the {self.place}"
            case Task.GO:
                return f"go to the {self.place}"
            case Task.LEARN:
                return f"call this place the {self.place}"
            case Task.FOLLOW:
                return "follow you"
            case Task.WHO:
                return "tell you who is where"


class WrongOrder(ValueError):
    """An order that the robot does not understand, or cannot carry out; the text says why."""


class OrderReader:
    """Reads orders of one or several tasks by a grammar.

    Args:
        sentences: for each order's name its sentences, as of an `OrderGrammar`. Names that are no task, such
            as `stop`, are left out.
        words: the words that fit each place of a sentence; orders have them as they are written here.

    Raises:
        WrongGrammar: a sentence is wrong, or a task lacks the place in the sentence that it needs.
    """

    def __init__(self, sentences: Mapping[str, Sequence[str]], words: Mapping[str, Sequence[str]]) -> None:
        tasks = {name: said for name, said in sentences.items() if name in list(Task)}
        self._grammar = OrderGrammar(tasks, words)
        self._written = {spoken(word): word for choices in words.values() for word in choices}
        for name, said in tasks.items():
            needed = [slot for slot, those in SLOTS.items() if Task(name) in those]
            for sentence in said:
                if missing := [slot for slot in needed if f"<{slot}>" not in sentence]:
                    raise WrongGrammar(
                        f'the sentence "{sentence}" of the order "{name}" needs <{missing[0]}>'
                    )

    def read(self, text: str) -> list[TaskOrder]:
        """Return the tasks of a sentence such as "go to the kitchen and bring me the soup".

        Raises:
            WrongOrder: it is not in the grammar, or has too many tasks.
        """
        words = text.lower().split()
        found = self._split(words) if len(words) <= MAX_WORDS else None
        if found is None:
            raise WrongOrder(f"I do not understand {text!r:.200}")
        if len(found) > MAX_TASKS:
            raise WrongOrder(f"these are {len(found)} tasks; at most {MAX_TASKS} fit into an order")
        return found

    def _split(self, words: list[str]) -> list[TaskOrder] | None:
        """Return the tasks of these words: of the whole, or of a first order and the rest."""
        whole = self._grammar.parse(" ".join(words))
        if whole is not None:
            return [self._task(whole)]
        for connection in map(str.split, CONNECTIONS):
            for at in range(1, len(words) - len(connection)):
                if words[at : at + len(connection)] != connection:
                    continue
                first = self._grammar.parse(" ".join(words[:at]))
                rest = self._split(words[at + len(connection) :]) if first is not None else None
                if first is not None and rest is not None:
                    return [self._task(first), *rest]
        return None

    def _task(self, said: SpokenWords) -> TaskOrder:
        object_said, place_said = said.slots.get("object", ""), said.slots.get("place", "")
        written = self._written
        return TaskOrder(
            Task(said.order), written.get(object_said, object_said), written.get(place_said, place_said)
        )


SLOTS = {"object": NEEDS_OBJECT, "place": NEEDS_PLACE}


def check_orders(orders: Sequence[TaskOrder], places: Iterable[str], holds: str) -> None:
    """Check that the robot can begin an order.

    Args:
        orders: the tasks.
        places: names of the places that it knows.
        holds: what is in its hand.

    Raises:
        WrongOrder: it cannot; the text says why.
    """
    known = set(places)
    if not 0 < len(orders) <= MAX_TASKS:
        raise WrongOrder(f"an order has 1 to {MAX_TASKS} tasks, not {len(orders)}")
    for order in orders:
        if order.task in NEEDS_OBJECT and not order.object:
            raise WrongOrder(f"{order.task}: which object? Its name is empty")
        if order.task in NEEDS_PLACE and not order.place:
            raise WrongOrder(f"{order.task}: which place? Its name is empty")
        if order.task is Task.LEARN:
            known.add(order.place)
        elif order.place and order.place not in known:
            names = ", ".join(sorted(known)) or "none yet"
            raise WrongOrder(f"I do not know the place {order.place!r:.80}; I know: {names}")
        if order.task in NEEDS_ARM:
            if not (order.object or holds):
                raise WrongOrder("I hold nothing that I could put down")
            if order.object and holds not in ("", order.object):
                raise WrongOrder(f"I hold the {holds}: tell me first where to put it")
            holds = ""
