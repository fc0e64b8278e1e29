"""Breaking any single step of the recovery must be noticed by the crash points, or they prove nothing."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product

import pytest

from robbie_mp.core import message_flow as message_flow_module
from robbie_mp.core import router as router_module
from robbie_mp.core.directory import Channel, Directory, Subscription
from robbie_mp.core.ledger import Ledger
from robbie_mp.core.link import Link
from robbie_mp.core.lockstep_queues import LockstepQueues
from robbie_mp.core.message_flow import MessageFlow
from robbie_mp.core.queues import Queues
from robbie_mp.core.router import Router
from robbie_mp.transport import layout
from tests.core.test_crash_points import SCENARIOS, SETTINGS, play


def nothing(*_arguments: object, **_named: object) -> None:
    """Do not do this step."""


def forget_what_was_claimed(
    _ledger: Ledger, _directory: Directory, _handle: int, channel: Channel
) -> list[Subscription]:
    return channel.subscriptions


def every_row(ledger: Ledger, _routed: Sequence[int]) -> set[tuple[int, int, int]]:
    return set(_records(ledger, range(ledger._tables.sizes.handles)))


def live_rows(ledger: Ledger, _routed: Sequence[int]) -> set[tuple[int, int, int]]:
    rows = range(ledger._tables.sizes.handles)
    return set(_records(ledger, [row for row in rows if ledger.row(row, layout.HANDLE_SEQUENCE)]))


def _records(ledger: Ledger, rows: Iterable[int]) -> Iterator[tuple[int, int, int]]:
    for row in rows:
        slot, _, incarnation = layout.unpack_source(ledger.row(row, layout.HANDLE_SOURCE))
        yield slot, incarnation, ledger.row(row, layout.HANDLE_RECORD)


MUTATIONS: dict[str, tuple[object, str, Callable[..., object]]] = {
    "counts are not completed": (Ledger, "_complete_count", nothing),
    "a message cut short in routing is not finished": (MessageFlow, "finish_routing", nothing),
    "a record that was handled to its end is not taken": (MessageFlow, "finish_publishing", nothing),
    "a row without a commit tells that a message was entered": (Ledger, "entered", every_row),
    "a row that was given back tells nothing": (Ledger, "entered", live_rows),
    "a message cut short in routing is sent to everybody again": (
        message_flow_module, "unclaimed", forget_what_was_claimed,
    ),
    "a record said again is taken for a violation": (Link, "is_said_again", lambda _link: False),
    "pushing is not noted": (Ledger, "mark_pushed", nothing),
    "declarations are not read again": (router_module, "restore_declarations", nothing),
    "references are not read again": (router_module, "restore_references", nothing),
    "counters are not read again": (router_module, "restore_slot", nothing),
}  # fmt: skip

MUTATIONS_OF_LOCKSTEP: dict[str, tuple[object, str, Callable[..., object]]] = {
    "several modules have a message at a time": (LockstepQueues, "_is_anyone_busy", lambda _queues: False),
    "a module is sent all its messages at once": (LockstepQueues, "pump", Queues.pump),
    "a new core does not say that all is settled": (Router, "_say_if_settled", nothing),
}  # fmt: skip


@pytest.mark.parametrize("mutation", MUTATIONS)
def test_broken_recovery_is_noticed(mutation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, name, replacement = MUTATIONS[mutation]
    monkeypatch.setattr(owner, name, replacement)
    assert _violated(), "no crash point noticed it"


@pytest.mark.parametrize("mutation", MUTATIONS_OF_LOCKSTEP)
def test_broken_lockstep_is_noticed(mutation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, name, replacement = MUTATIONS_OF_LOCKSTEP[mutation]
    monkeypatch.setattr(owner, name, replacement)
    assert _violated(lockstep=True), "no crash point noticed it"


def _violated(*, lockstep: bool = False) -> bool:
    for scenario, first, settings in product(reversed(SCENARIOS), range(5), SETTINGS):
        for death in range(first, 600, 5):
            try:
                play(scenario, settings, (death,), lockstep=lockstep)
            except (AssertionError, KeyError, IndexError, AttributeError):
                return True
    return False
