"""Histories that are drawn from a number, so that a failure can name what it played."""

from random import Random

from tests.bus.core._support.crowd import Crowd
from tests.bus.core._support.history import SLOTS, History
from tests.bus.core.test_router_random import ACTIONS, LATCHED_ACTIONS


def history(seed: int) -> History:
    """Play a history of three modules, whose core may die a few times."""
    random = Random(seed)
    deaths = tuple(random.randrange(2000) for _ in range(random.choice((0, 0, 1, 2, 3))))
    queue_messages, handles = random.choice(((6, 24), (6, 24), (1, 12), (6, 4)))
    latched = random.random() < 0.4
    drawn = History(
        deaths, queue_messages, handles,
        by_patterns=random.random() < 0.2,
        in_flight_bytes=random.choice((16, 1 << 30)),
        latched=latched,
        latched_bytes=random.choice((4, 1 << 30)),
    )  # fmt: skip
    actions = LATCHED_ACTIONS if latched else ACTIONS
    for _ in range(random.randrange(80)):
        getattr(drawn, random.choice(actions))(random.choice(SLOTS))
    drawn.finish()
    return drawn


def crowd(seed: int) -> Crowd:
    """Play a larger robot, which is all drawn at random."""
    drawn = Crowd(seed, deaths=seed % 4)
    drawn.play()
    return drawn
