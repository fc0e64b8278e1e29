"""A module's end of the bus, against a core in the same process."""

import gc
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from robbie_mp import MessageHandling
from robbie_mp.base.linux.forks import ForkedProcess
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.endpoint import Endpoint, EndpointMemory
from robbie_mp.bus.transport.records import Delivery, Inbound, Outbound
from tests._support.implementations import Native
from tests.bus.core._support.simulated_run import (
    CREDIT,
    RING_RECORDS,
    SimulatedModule,
    SimulatedRun,
    connected,
)

DELIVERY = Delivery(0, 0, 0, 1, 1, 0, 8, 0)

pytestmark = pytest.mark.usefixtures("native")


@pytest.fixture
def threads_switch_often() -> Iterator[None]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_message_never_overtakes_the_declaration_of_its_channel() -> None:
    run = SimulatedRun()
    module = run.start(1)
    for _ in range(RING_RECORDS + 3):
        module.endpoint.send(Outbound.WAIT_FREED, 0)  # the core is busy elsewhere, and the ring fills
    channel = module.advertise()
    run.run_core()
    module.publish(channel, 1)
    run.run_core()
    assert run.reports == []
    assert run.words[layout.CORE_LAST_SEQUENCE] == 1


def test_what_did_not_fit_into_the_ring_follows_in_order() -> None:
    run = SimulatedRun()
    module = run.start(1)
    for _ in range(2 * RING_RECORDS):
        module.endpoint.send(Outbound.WAIT_FREED, 0)
    channel = module.advertise()
    assert not module.publish(channel, 1)
    run.run_core()
    assert module.endpoint.take() is None
    assert not module.publish(channel, 1)
    run.run_core()
    assert module.publish(channel, 1)
    run.run_core()
    assert run.reports == []


def test_taking_pushes_what_did_not_fit_into_the_ring_before() -> None:
    run = SimulatedRun()
    for incarnation in range(1, RING_RECORDS + 4):
        run.modules[1, incarnation] = SimulatedModule(1, incarnation)
        run.supervisor.endpoint.send(Outbound.MODULE_UP, 1, incarnation)
        run.supervisor.endpoint.send(Outbound.MODULE_DOWN, 1, incarnation)
    reclaimed = 0
    for _ in range(10):
        run.run_core()
        reclaimed += sum(kind is Inbound.RECLAIMED for kind, _, _ in run.supervisor_notices())
    assert reclaimed == RING_RECORDS + 3


@pytest.mark.usefixtures("threads_switch_often")
def test_declarations_made_in_several_threads_get_numbers_of_their_own() -> None:
    for _ in range(20):
        endpoint = SimulatedRun().start(1).endpoint
        numbers: list[int] = []

        def declare(thread: int, endpoint: Endpoint = endpoint, numbers: list[int] = numbers) -> None:
            numbers.extend(endpoint.advertise("test_msgs/msg/Number", 1, f"{thread} {n}") for n in range(10))

        threads = [threading.Thread(target=declare, args=(number,)) for number in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(numbers) == list(range(40))


@pytest.mark.parametrize(
    "use",
    [
        lambda module: module.publish(0, 1),
        lambda module: module.endpoint.send(Outbound.WAIT_FREED, 0),
        lambda module: module.endpoint.take(),
        lambda module: module.endpoint.release(DELIVERY),
        lambda module: module.endpoint.done(DELIVERY),
        lambda module: module.endpoint.freed(),
    ],
)
def test_forked_process_is_refused(use: Callable[[SimulatedModule], object]) -> None:
    module = SimulatedRun().start(1)
    before = module.out[layout.OUT_HEAD]
    module.endpoint.disown()
    module.endpoint.disown()  # in a fork of the fork
    with pytest.raises(ForkedProcess):
        use(module)
    assert module.out[layout.OUT_HEAD] == before


def test_release_wakes_the_core_only_if_it_waits_for_it() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for wanted in (0, 1000, 1):
        publisher.publish(channel, wanted)
        run.run_core()
        subscriber.into[layout.IN_WANT_RELEASE] = wanted
        before = subscriber.core_wakeups
        subscriber.handle_all()
        assert subscriber.core_wakeups == before + (wanted == 1)


def test_publishing_leaves_room_for_releases() -> None:
    module = SimulatedRun().start(1)
    channel = module.advertise()
    accepted = 0
    while module.publish(channel, accepted):
        accepted += 1
    pushed = module.out[layout.OUT_HEAD]
    assert accepted > 0
    for _ in range(2 * CREDIT):
        module.endpoint.release(DELIVERY)
    assert module.out[layout.OUT_HEAD] == pushed + 2 * CREDIT
    assert not module.endpoint._backlog


@pytest.mark.parametrize("action", ["publish", "release"])
def test_thread_that_declares_lets_no_other_overtake_it(action: str) -> None:
    """A record that is not in the ring yet, because its thread stands still, is still the first."""
    module = SimulatedRun().start(1)
    channel = module.advertise()
    before = module.out[layout.OUT_HEAD]
    act = (
        partial(module.publish, channel, 1)
        if action == "publish"
        else partial(module.endpoint.release, DELIVERY)
    )
    thread = threading.Thread(target=act)
    with module.endpoint.lock, module.endpoint.lock:  # it may be taken again by the same thread
        thread.start()
        thread.join(0.05)
        assert thread.is_alive()
        assert module.out[layout.OUT_HEAD] == before
    thread.join(10)
    assert module.out[layout.OUT_HEAD] == before + 1


def test_lock_of_c_belongs_to_a_thread(native: Native | None) -> None:
    lock = SimulatedRun().start(1).endpoint.lock if native is None else native.Lock()
    assert isinstance(lock, type(threading.RLock()) if native is None else native.Lock)
    refused: list[type[BaseException]] = []

    def give_back() -> None:
        try:
            lock.__exit__(None, None, None)
        except RuntimeError as error:
            refused.append(type(error))

    with lock:
        thread = threading.Thread(target=give_back)
        thread.start()
        thread.join()
    assert refused == [RuntimeError]
    give_back()
    assert refused == [RuntimeError] * 2


def test_endpoint_that_was_closed_holds_no_memory(native: Native | None) -> None:
    memory = [bytearray(8 * layout.out_words(RING_RECORDS)), bytearray(8 * layout.in_words(CREDIT))]
    out, into = (memoryview(each).cast("Q") for each in memory)
    endpoint = Endpoint(EndpointMemory(1, 1, out, into, lambda: None), RING_RECORDS, CREDIT, native)
    if native is not None:
        with pytest.raises(BufferError):
            memory[0].clear()
    endpoint.close()
    if native is not None:
        with pytest.raises(ValueError, match="closed"):
            endpoint.take()
        endpoint = None  # type: ignore[assignment]
        del out, into
        for each in memory:
            each.clear()


def test_endpoint_in_a_cycle_is_collected(native: Native | None) -> None:
    memory = bytearray(8 * layout.out_words(RING_RECORDS))
    module = SimulatedModule(1, 1, out=memoryview(memory).cast("Q"))  # its `wake_core` refers to it
    module.publish(0, 1)
    del module
    gc.collect()
    memory.clear()
