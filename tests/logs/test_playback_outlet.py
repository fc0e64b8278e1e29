"""Limits of the messages of a log in flight."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from robbie_mp.logs.playback.outlet import PATIENCE_NS, PacedOutlet
from robbie_mp.logs.playback.translation import Translation
from robbie_mp.logs.recording.reader import LoggedMessage, open_log
from robbie_mp.messages import DecodeError
from robbie_mp.module.clock import ManualClock
from tests.logs.recording._support.logs import write_log

LIMIT, LIMIT_BYTES = 5, 1000


class FakeModule:
    """Publishes into nothing; the test says how much of it is still on its way."""

    def __init__(self) -> None:
        self.clock = ManualClock(1)
        self.outstanding = 0
        self.kept = 0
        """Of those: handled, but somebody still looks at them."""
        self.sent: list[bytes] = []
        self.log = SimpleNamespace(error=lambda *words: self.said.append(words))
        self.said: list[Any] = []
        self.ill_formed = SimpleNamespace(admits_encoded=lambda *_: True)

    def unhandled(self) -> int:
        return self.outstanding - self.kept

    def publish_encoded(self, _type: str, _version: int, data: bytes, *, topic: str, latched: bool) -> bool:
        self.sent.append(data)
        self.outstanding += 1
        return True


@pytest.fixture(scope="module")
def message(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LoggedMessage]:
    with open_log(write_log(tmp_path_factory.mktemp("logs") / "log.mcap", 3)) as log:
        yield next(log.messages())


@pytest.fixture
def outlet() -> tuple[FakeModule, PacedOutlet]:
    module = FakeModule()
    translations = dict.fromkeys(range(3), Translation(1, None))
    return module, PacedOutlet(module, translations, lambda _: None, LIMIT, LIMIT_BYTES, module.unhandled)  # type: ignore[arg-type]


def send_while_room(outlet: PacedOutlet, message: LoggedMessage, size: int) -> int:
    sent = 0
    while outlet.has_room(size):
        assert outlet.send(message._replace(data=b"\0\1\0\0" + bytes(size - 4)))
        sent += 1
    return sent


@pytest.mark.parametrize(("size", "fit"), [(10, LIMIT), (200, 5), (300, 3), (600, 1), (5000, 1)])
def test_messages_wait_when_too_many_or_too_large_ones_are_in_flight(
    outlet: tuple[FakeModule, PacedOutlet], message: LoggedMessage, size: int, fit: int
) -> None:
    module, paced = outlet
    assert send_while_room(paced, message, size) == fit
    module.outstanding -= 1
    assert send_while_room(paced, message, size) == 1
    module.outstanding = 0
    assert send_while_room(paced, message, size) == fit


@pytest.mark.parametrize("size", [10, 600])
def test_handled_messages_that_are_kept_delay_nothing(
    outlet: tuple[FakeModule, PacedOutlet], message: LoggedMessage, size: int
) -> None:
    module, paced = outlet
    fit = send_while_room(paced, message, size)
    assert not paced.is_empty()
    module.kept = fit
    assert paced.is_empty()
    assert send_while_room(paced, message, size) == fit
    assert not paced.is_empty()


def test_unhandled_messages_do_not_delay_the_end_for_ever(
    outlet: tuple[FakeModule, PacedOutlet], message: LoggedMessage
) -> None:
    module, paced = outlet
    paced.send(message)
    assert not paced.is_empty()
    module.clock.advance(0.9 * PATIENCE_NS / 1e9)
    assert not paced.is_empty()
    module.clock.advance(0.2 * PATIENCE_NS / 1e9)
    assert paced.is_empty()
    module.outstanding = 0
    paced.send(message)
    assert not paced.is_empty()
    module.outstanding = 0
    assert paced.is_empty()


def test_message_that_cannot_be_published_is_skipped_and_logged(
    outlet: tuple[FakeModule, PacedOutlet], message: LoggedMessage
) -> None:
    module, paced = outlet

    def refuse(*_arguments: object, **_options: object) -> bool:
        raise DecodeError("no encoding")

    module.publish_encoded = refuse  # type: ignore[method-assign]
    assert paced.send(message)
    assert paced.balance.left_out == {"damaged messages of 'laser/front'": 1}
    assert len(module.said) == 1


def test_published_messages_and_those_left_out_are_counted_but_not_given_ones(message: LoggedMessage) -> None:
    module = FakeModule()
    why = "messages of 'laser/front', whose type does not fit"
    fits = PacedOutlet(module, {message.channel.id: Translation(1, None)}, lambda _: None, 5, 1000, lambda: 0)  # type: ignore[arg-type]
    does_not = PacedOutlet(module, {message.channel.id: why}, lambda _: None, 5, 1000, lambda: 0)  # type: ignore[arg-type]
    for outlet in (fits, does_not):
        assert outlet.send(message, is_given=True) and outlet.send(message) and outlet.send(message)
    assert (fits.balance.used, fits.balance.left_out) == (2, {})
    assert (does_not.balance.used, does_not.balance.left_out) == (0, {why: 3})
    module.ill_formed = SimpleNamespace(admits_encoded=lambda *_: False)
    assert fits.send(message)
    assert fits.balance.left_out == {"ill-formed messages of 'laser/front'": 1}
