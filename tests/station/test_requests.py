"""Requests and goals of operators: each ends exactly once, with a reply or an error."""

from collections.abc import Callable

import pytest

from robbie_mp.messages import CancelNavigation, Message, NavigationCancelled, SetControl
from robbie_mp.module.calls.errors import (
    CallError,
    CallNotSent,
    CallRefused,
    GoalAborted,
    GoalCancelled,
    GoalPreempted,
    NoServer,
    TooManyCalls,
)
from robbie_mp.station.page.page import ending
from robbie_mp.station.page.requests import MAX_WAITING, Asked, Asking, Requests

OnEnd = Callable[[Message | CallError], None]


def test_request_is_sent_by_the_modules_thread_and_ends_with_its_reply() -> None:
    sent: list[tuple[Asking, OnEnd]] = []
    requests = Requests(lambda message, on_end, _topic: sent.append((message, on_end)))
    asked = requests.ask(CancelNavigation(reason="enough"), "the cancel")
    assert not sent
    requests.tick()
    requests.tick()
    ((message, on_end),) = sent
    assert (message, asked.has_ended) == (CancelNavigation(reason="enough"), False)
    on_end(NavigationCancelled(client="mission"))
    assert (asked.reply, asked.error, asked.has_ended) == (NavigationCancelled(client="mission"), None, True)


def test_request_beyond_the_limit_ends_at_once_with_an_error() -> None:
    sent: list[Asking] = []
    requests = Requests(lambda message, _end, _topic: sent.append(message))
    asked = [requests.ask(CancelNavigation(), "the cancel") for _ in range(MAX_WAITING + 1)]
    assert [one.has_ended for one in asked] == [False] * MAX_WAITING + [True]
    assert isinstance(asked[-1].error, CallNotSent)
    requests.tick()
    assert len(sent) == MAX_WAITING


def test_request_that_cannot_be_sent_ends_with_the_reason() -> None:
    def send(_message: Asking, _on_end: OnEnd, _topic: str) -> None:
        raise TooManyCalls("1000 calls have not ended")

    requests = Requests(send)
    asked = requests.ask(CancelNavigation(), "the cancel")
    requests.tick()
    assert ending(asked) == "the cancel failed: 1000 calls have not ended"


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (CallRefused("not today"), "the goal was refused: not today"),
        (GoalCancelled("enough"), "the goal was cancelled: enough"),
        (GoalPreempted("another came"), "the goal was given up: another came"),
        (GoalAborted("no path"), "the goal cannot be reached: no path"),
        (NoServer("no module serves it"), "the goal failed: no module serves it"),
    ],
)
def test_operator_is_told_how_a_request_or_goal_has_failed(error: CallError, text: str) -> None:
    asked = Asked("the goal")
    asked.end(error)
    assert ending(asked) == text


def test_order_to_move_that_waited_for_the_module_is_not_sent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sent: list[Asking] = []
    requests = Requests(lambda message, _end, _topic: sent.append(message))
    now_s = [100.0]
    monkeypatch.setattr("robbie_mp.station.page.requests.time.monotonic", lambda: now_s[0])
    late, any_time = requests.ask(SetControl(), "go on", within_s=2.0), requests.ask(SetControl(), "hold")
    now_s[0] += 10.0
    requests.tick()
    assert isinstance(late.error, CallNotSent)
    assert len(sent) == 1 and not any_time.has_ended
