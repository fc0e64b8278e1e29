"""The seed inputs, the inputs with a single mistake, and mutations that keep the form of steps."""

from collections.abc import Iterator
from random import Random

from robbie_mp.bus.transport.records import Outbound
from tests.bus.core._support.siege import Siege
from tools.fuzz.core.attack import CONTROL_WORDS, KINDS
from tools.fuzz.core.steps import MAX_STEPS, STEP_BYTES, Do, Step, decode, encode, step
from tools.fuzz.core.words import dictionary

HAS_MESSAGES = (step(Do.PUBLISH), step(Do.CORE), step(Do.BEHAVE), step(Do.PUBLISH), step(Do.CORE))
"""Steps after which both modules hold messages, and the core has handled some of the hostile module's."""
AFTERWARDS = (step(Do.PUBLISH), step(Do.CORE), step(Do.HANDLE), step(Do.CORE))
MOST_MUTATIONS = 4
COLUMNS = {
    Outbound.ADVERTISE: 1, Outbound.SUBSCRIBE: 1, Outbound.PUBLISH: 6, Outbound.DONE: 2, Outbound.RELEASE: 2,
    Outbound.WAIT_FREED: 1, Outbound.MODULE_UP: 2, Outbound.MODULE_DOWN: 3, Outbound.MODULE_GONE: 2,
    Outbound.MAKE_ROOM: 3,
}  # fmt: skip
"""Number of words with a meaning in each kind of record, besides the kind."""


def seeds() -> list[bytes]:
    """Return inputs for each kind of record, for each control word, and for several deaths of the core."""
    kinds = [encode(*HAS_MESSAGES, step(Do.RECORD, kind), *AFTERWARDS) for kind in range(len(KINDS))]
    pairs = [
        encode(*HAS_MESSAGES, step(Do.RECORD, first), step(Do.RECORD, second), *AFTERWARDS)
        for first, second in ((3, 3), (4, 5), (5, 5), (0, 3), (1, 5))
    ]
    words = [
        encode(*HAS_MESSAGES, step(Do.SCRIBBLE, 0, 0, word, 27), after, *AFTERWARDS)
        for word in range(len(CONTROL_WORDS))
        for after in (step(Do.CORE), step(Do.RESTART_CORE))
    ]
    deaths = [
        encode(*HAS_MESSAGES, step(Do.CORE_DIES, stores, 0, 0, 0, 0), step(Do.BEHAVE), *AFTERWARDS)
        for stores in range(0, 60, 7)
    ]
    declared = encode(*HAS_MESSAGES, step(Do.DECLARE, 0, 1), step(Do.DECLARE, 1, 1, 1), *AFTERWARDS)
    restarted = encode(*HAS_MESSAGES, step(Do.RESTART_HOSTILE), step(Do.RECORD, 3), *AFTERWARDS)
    return [*kinds, *pairs, *words, *deaths, declared, restarted]


def single_mistakes() -> Iterator[bytes]:
    """Yield inputs with each word of the dictionary in each control word and each column of each record."""
    words = len(dictionary(Siege()))
    for control in range(len(CONTROL_WORDS)):
        for word in range(words):
            scribble = step(Do.SCRIBBLE, 0, 0, control, word)
            yield encode(*HAS_MESSAGES, scribble, step(Do.CORE), step(Do.RESTART_CORE), *AFTERWARDS)
    for kind, name in enumerate(KINDS):
        for column in range(1 + COLUMNS.get(name, 0)):
            for word in range(words):
                yield encode(*HAS_MESSAGES, step(Do.RECORD, kind, column, word), *AFTERWARDS)


def mutate(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Change an input a few times: change a number, or insert, remove, repeat or copy steps."""
    steps = list(decode(data)) or [step(Do.CORE)]
    for _ in range(random.randint(1, MOST_MUTATIONS)):
        at = random.randrange(len(steps))
        match random.randrange(6):
            case 0:
                steps.insert(at, Step(random.choice(list(Do)), random.randbytes(STEP_BYTES - 1)))
            case 1 if len(steps) > 1:
                del steps[at]
            case 2:
                steps.insert(at, steps[random.randrange(len(steps))])
            case 3:
                steps[at:at] = decode(random.choice(others))
            case _:
                numbers = bytearray(steps[at].numbers)
                numbers[random.randrange(len(numbers))] = random.randrange(256)
                steps[at] = Step(steps[at].what, bytes(numbers))
    return encode(*steps[:MAX_STEPS])
