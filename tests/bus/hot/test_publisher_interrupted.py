"""While C publishes, a garbage collection may run any Python code, such as another thread that publishes."""

from collections.abc import Callable, Iterator

import pytest

from robbie_mp.bus.transport import layout
from tests._support.implementations import NATIVE
from tests.bus.core._support.simulated_run import RING_RECORDS, SimulatedRun
from tests.bus.transport._support.pair import Pair, picture

pytestmark = pytest.mark.skipif(NATIVE is None, reason="NOT TESTED: the hot path in C is not used here")


@pytest.fixture
def pair(monkeypatch: pytest.MonkeyPatch) -> Iterator[Pair]:
    monkeypatch.setattr(SimulatedRun, "native_modules", NATIVE)
    made = Pair(NATIVE)
    yield made
    made.close()


class Topic(str):
    """A topic that does something else whenever it is looked up."""

    act: Callable[[], object]

    def __hash__(self) -> int:
        self.act()
        return super().__hash__()


def test_ring_that_is_filled_in_between_is_not_overfilled(pair: Pair) -> None:
    for _ in range(3):
        assert pair.outbox.publish(picture(1, 8), "topic")
        pair.pass_on()
    refused: list[bool] = []

    def fill() -> None:
        topic.act = lambda: None
        while pair.outbox.publish(picture(2, 8), "topic"):
            pass
        refused.append(True)

    topic = Topic("topic")
    topic.act = fill
    assert not pair.outbox.publish(picture(3, 8), topic)
    assert refused
    head = pair.sender_words[layout.OUT_HEAD]
    sent = RING_RECORDS - min(8, RING_RECORDS // 2)
    tail = pair.run.modules[1, 1].into[layout.IN_OUTBOUND_TAIL]
    assert head - tail <= sent, "it took the room that is left for releases"
