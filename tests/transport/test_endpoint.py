"""A module's end of the bus, against a core in the same process."""

import sys
import threading
from collections.abc import Iterator

import pytest

from robbie_mp.transport import layout
from robbie_mp.transport.endpoint import Endpoint
from robbie_mp.transport.records import Inbound, Outbound
from tests.core._support.simulated_run import RING_RECORDS, SimulatedModule, SimulatedRun


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
