"""What one message costs, counted and not timed: posts, calls and copies, on the whole way and back.

A change that makes these grow makes the robot slower on every machine; one that lowers them may lower the
bounds here.
"""

import gc
import os
import sys
import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from robbie_mp import Message, MessageHandling
from robbie_mp.bus._hot import choice
from robbie_mp.bus.core.members import LinkMemory, RouterLimits
from robbie_mp.bus.core.native_router import make_router
from robbie_mp.bus.core.router import SlotLimits
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.channels import ChannelNames
from robbie_mp.bus.transport.endpoint import Endpoint, EndpointMemory
from robbie_mp.bus.transport.records import Outbound
from robbie_mp.bus.transport.run_memory import make_block_store, make_views
from robbie_mp.bus.transport.shared_folder import make_folder, remove_names
from robbie_mp.bus.transport.tables import CoreTables, TableSizes
from robbie_mp.bus.transport.words import Words
from robbie_mp.messages import Image, float64
from robbie_mp.module.clock import SystemClock
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.outbox import Outbox
from tests._support.implementations import Native

RUN_ID = f"test{os.getpid()}"
RING_RECORDS = 256
CREDIT = 64
OURS = ("Publisher.publish", "Subscriber.handle_next", "Books.serve_round", "Books.before_sleep")
SUPERVISOR, PUBLISHER, SUBSCRIBER = 0, 1, 2


class Speed(Message, name="test_msgs/msg/Speed", version=1):
    """A small message. What moves the robot is checked when it is published, which costs more calls."""

    linear: float64 = 0.0
    angular: float64 = 0.0


def zeros(count: int) -> Words:
    return memoryview(bytearray(8 * count)).cast("Q")


class Chain:
    """Publisher, core and subscriber as in a robot, but in one process and one step after the other."""

    def __init__(self, native: Native | None) -> None:
        self.native = native
        self.posts = Counter[str]()
        self.images: list[int] = []
        sizes = TableSizes(4, channels=8, subscriptions=8, handles=600, references=600)
        tables = CoreTables.create(zeros(sizes.words), sizes)
        limits = RouterLimits(RING_RECORDS, CREDIT, message_bytes=1 << 24)
        bounds = [SlotLimits(1000, 1 << 30)] * 4
        self.out = [zeros(layout.out_words(RING_RECORDS)) for _ in bounds]
        self.into = [zeros(layout.in_words(CREDIT)) for _ in bounds]
        self.core = make_router(native, tables, limits, bounds, self._connect, print)
        self.ends = ends = [self._endpoint(slot) for slot in range(3)]
        make_folder(RUN_ID)
        blocks = make_block_store(
            RUN_ID, PUBLISHER, 1, segment_bytes=1 << 20, limit_bytes=1 << 26, native=native
        )
        self.outbox = Outbox(ends[PUBLISHER], blocks, self.out[PUBLISHER], SystemClock(), native)
        self.views = make_views(RUN_ID, native)
        self.inbox = Inbox(
            ends[SUBSCRIBER], self.views, self.out[SUBSCRIBER], ChannelNames(tables.words), native
        )
        self.inbox.subscriptions.subscribe(Speed, lambda _: None, MessageHandling.ALWAYS_DELIVER, "")
        self.inbox.subscriptions.subscribe(Image, self._on_image, MessageHandling.ALWAYS_DELIVER, "")
        for end in ends:
            end.send(Outbound.READY)
        self.work()

    def _connect(self, slot: int, incarnation: int) -> LinkMemory:
        wake = self._post(f"slot {slot}")
        return LinkMemory(incarnation, self.out[slot], self.into[slot], wake, lambda: None)

    def _endpoint(self, slot: int) -> Endpoint:
        self.core.module_up(slot, 1)
        memory = EndpointMemory(slot, 1, self.out[slot], self.into[slot], self._post("core"))
        return Endpoint(memory, RING_RECORDS, CREDIT, self.native)

    def _post(self, to: str) -> Callable[[], None]:
        def post() -> None:
            self.posts[to] += 1

        return post

    def _on_image(self, image: Image) -> None:
        self.images.append(image.data.__array_interface__["data"][0])

    def work(self) -> None:
        """Do all that is to be done, as core and subscriber do it when they are woken."""
        self._run_core()
        while self.inbox.handle_next():
            pass
        self._run_core()

    def _run_core(self) -> None:
        while self.core.run_round() or self.core.before_sleep():
            pass

    def send(self, message: Message) -> None:
        assert self.outbox.publish(message, "")
        self.work()

    def close(self) -> None:
        self.outbox.close()
        self.views.close()
        remove_names(RUN_ID)


@pytest.fixture
def chain(native: Native | None) -> Iterator[Chain]:
    made = Chain(native)
    for _ in range(5):  # declared, generated, mapped
        made.send(Speed())
        made.send(Image(data=np.zeros(1000, np.uint8)))
    made.posts.clear()
    made.images.clear()
    yield made
    made.close()


def calls_of(action: Callable[[], object]) -> tuple[int, set[str]]:
    """Count calls of Python functions, and name the built-in ones with what they belong to."""
    python = 0
    builtin = set[str]()

    def note(_frame: object, event: str, what: Any) -> None:
        nonlocal python
        python += event == "call"
        if event == "c_call":
            owner = what.__module__ or type(what.__self__).__module__
            builtin.add(f"{owner}.{what.__qualname__}")

    gc.collect()
    gc.disable()  # a collection calls what others hang on it, as hypothesis does
    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(None)
        gc.enable()
    return python - 1, builtin - {"sys.setprofile"}  # the action itself is one call


def test_message_costs_two_posts_and_its_release_none(chain: Chain) -> None:
    for _ in range(100):
        chain.send(Speed())
    assert chain.posts == {"core": 100, f"slot {SUBSCRIBER}": 100}


def test_message_calls_nothing_that_enters_the_kernel(chain: Chain) -> None:
    """Besides the posts, counted above: locks that nobody else holds and reading the clock do not."""
    _, builtin = calls_of(lambda: chain.send(Speed()))
    codec = ("robbie_mp.messages.", "robbie_mp.bus._hot.native.MessageCodec.")
    harmless = (
        "builtins.", "_struct.", "collections.", "_thread.", "pickle.PickleBuffer.", f"{__name__}.Speed.",
        *codec,
    )  # fmt: skip
    ours = {f"robbie_mp.bus._hot.native.{name}" for name in OURS}
    expected = {"time.monotonic_ns"} if chain.native is None else ours
    assert {name for name in builtin if not name.startswith(harmless)} == expected


@pytest.mark.slow
@pytest.mark.every_turn
def test_message_takes_few_calls(chain: Chain) -> None:
    message = Speed()
    publishing, _ = calls_of(lambda: chain.outbox.publish(message, ""))
    routing, _ = calls_of(chain.core.run_round)
    handling, _ = calls_of(chain.inbox.handle_next)
    releasing, _ = calls_of(chain.core.run_round)
    encoding = 4 if choice.native() is None else 0
    assert publishing <= encoding + (13 if chain.native is None else 3)
    assert routing <= (25 if chain.native is None else 2), "the post is two calls of the test"
    assert handling <= (24 if chain.native is None else 2)
    assert releasing <= (20 if chain.native is None else 0)


def test_array_is_copied_once_on_its_way(chain: Chain) -> None:
    """Into shared memory: neither publisher, core nor subscriber takes memory of its own for it."""
    size = 1 << 20
    image = Image(data=np.full(size, 7, np.uint8))
    chain.send(image)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    chain.send(image)
    peak = tracemalloc.get_traced_memory()[1] - before
    tracemalloc.stop()
    assert peak < size / 20
    mapped = [np.frombuffer(segment.buffer, np.uint8) for segment in chain.views._segments.values()]
    starts = [(each.__array_interface__["data"][0], each.nbytes) for each in mapped]
    assert all(any(at <= address < at + length for at, length in starts) for address in chain.images)


def test_loaned_array_is_not_copied_at_all(chain: Chain) -> None:
    size = 1 << 20
    with chain.outbox.loan(Image, "", {"data": size}) as image:
        image.data[:] = 9
        lent = image.data.__array_interface__["data"][0]
    chain.work()
    own = [np.frombuffer(segment.buffer, np.uint8) for segment, _ in chain.outbox._blocks._segments]
    at = [lent - each.__array_interface__["data"][0] for each in own]
    mapped = [np.frombuffer(segment.buffer, np.uint8) for segment in chain.views._segments.values()]
    seen = [chain.images[-1] - each.__array_interface__["data"][0] for each in mapped]
    assert set(at) & set(seen), "what was lent lies where it was seen, in the same segment"
