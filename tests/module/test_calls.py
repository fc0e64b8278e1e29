"""Request and reply, in the harness: every call ends exactly once."""

from collections.abc import Callable

import pytest

from robbie_mp import (
    CallError,
    CallLost,
    CallRefused,
    CallTimedOut,
    Message,
    Module,
    ModuleHarness,
    NoServer,
    Reply,
    Request,
    ServerDied,
    float64,
)
from robbie_mp.messages import DeclarationError, schema_text
from robbie_mp.messages.calls import reply_type
from robbie_mp.module.calls.client import MAX_CALLS
from robbie_mp.module.calls.errors import CalledInSetup, InvalidTimeout, ServedTwice, TooManyCalls, WrongReply


class FoundPath(Reply, name="test_calls/srv/FindPath_Response"):
    length_m: float64


class FindPath(Request[FoundPath], name="test_calls/srv/FindPath_Request"):
    x_m: float64
    y_m: float64 = 0.5


class Planner(Module):
    """Serves paths."""

    def setup(self) -> None:
        self.handled: list[int] = []
        self.serve(FindPath, self.on_find_path, topic="fast")

    def on_find_path(self, request: FindPath) -> FoundPath:
        self.handled.append(request.call)
        if request.x_m < 0:
            raise CallRefused("the goal is inside a wall")
        return FoundPath(length_m=request.x_m + request.y_m)


class Client(Module):
    """Calls when the test says so."""

    def setup(self) -> None:
        self.paths: list[FoundPath] = []
        self.errors: list[CallError] = []

    def ask(
        self, x_m: float = 1.0, timeout_s: float = 5.0, on_error: Callable[[CallError], None] | None = None
    ) -> None:
        self.call(
            FindPath(x_m=x_m),
            self.paths.append,
            on_error or self.errors.append,
            timeout_s=timeout_s,
            topic="fast",
        )


class TickingClient(Client):
    """Calls in a tick."""

    period_s = 0.1

    def tick(self) -> None:
        if not self.paths:
            self.ask()


def test_request_and_reply_have_a_leading_field_call() -> None:
    assert schema_text(FindPath).splitlines() == ["uint64 call", "float64 x_m", "float64 y_m 0.5"]
    assert FindPath.decode(FindPath(call=7, x_m=2.0).encode()) == FindPath(call=7, x_m=2.0)
    assert reply_type(FindPath) is FoundPath


def test_wrong_declarations_are_refused() -> None:
    with pytest.raises(DeclarationError, match="already has a field"):

        class Twice(Reply, name="test_calls/srv/Twice"):
            call: float64  # type: ignore[assignment]

    with pytest.raises(DeclarationError, match="do not inherit"):

        class Further(FoundPath, name="test_calls/srv/Further"):
            pass

    class Bare(Request, name="test_calls/srv/Bare"):  # type: ignore[type-arg]
        pass

    with pytest.raises(DeclarationError, match=r"class Bare\(Request\[…\]\)"):
        reply_type(Bare)


def test_server_replies_and_refuses() -> None:
    with ModuleHarness(Planner) as harness:
        assert harness.call(FindPath(x_m=1.0), topic="fast") == FoundPath(length_m=1.5)
        with pytest.raises(CallRefused, match="inside a wall"):
            harness.call(FindPath(x_m=-1.0), topic="fast")
        with pytest.raises(LookupError, match="does not serve"):
            harness.call(FindPath(x_m=1.0))
        assert not harness.published


def test_serving_twice_and_wrong_replies_are_errors() -> None:
    class Wrong(Planner):
        def on_find_path(self, request: FindPath) -> FoundPath:
            return None  # type: ignore[return-value]

    with ModuleHarness(Wrong) as harness:
        with pytest.raises(ServedTwice, match="test_calls/srv/FindPath_Request on topic 'fast'"):
            harness.module.serve(FindPath, harness.module.on_find_path, topic="fast")
        with pytest.raises(WrongReply, match="returned None; return a FoundPath"):
            harness.call(FindPath(x_m=1.0), topic="fast")


def test_reply_arrives_once_and_later_ones_are_counted() -> None:
    with ModuleHarness(Client) as harness:
        harness.module.ask()
        (request,) = harness.take(FindPath)
        assert request.call >> 32 == 1
        harness.reply(request, FoundPath(length_m=3.0))
        harness.reply(request, FoundPath(length_m=4.0))
        harness.refuse(request, "too late")
        harness.advance(10.0)
        assert [path.length_m for path in harness.module.paths] == [3.0]
        assert harness.module.errors == []
        assert harness.module._calls.client.late == 2


def test_reply_from_another_module_does_not_end_a_call() -> None:
    with ModuleHarness(Client) as harness:
        harness.module.ask()
        (request,) = harness.take(FindPath)
        harness.send(FoundPath(call=request.call, length_m=1.0), topic="module", sender="playback")
        assert harness.module.paths == []


def test_refusal_has_the_servers_words() -> None:
    with ModuleHarness(Client) as harness:
        harness.module.ask()
        (request,) = harness.take(FindPath)
        harness.refuse(request, "the goal is inside a wall")
        (error,) = harness.module.errors
        assert isinstance(error, CallRefused)
        assert str(error) == "the goal is inside a wall"


def test_call_times_out_on_the_modules_clock_to_the_millisecond() -> None:
    with ModuleHarness(Client) as harness:
        harness.module.ask(timeout_s=0.3)
        harness.advance(0.299)
        assert not harness.module.errors
        harness.advance(0.001)
        (error,) = harness.module.errors
        assert isinstance(error, CallTimedOut)
        assert str(error) == "FindPath on topic 'fast': server has not replied in 0.3 s"


def test_missing_server_is_told_after_the_handler_and_at_once() -> None:
    with ModuleHarness(Client) as harness:
        harness.remove_server()
        harness.module.ask()
        assert not harness.module.errors
        harness.advance(0.0)
        (error,) = harness.module.errors
        assert isinstance(error, NoServer)
        assert not harness.take(FindPath)


def test_death_of_the_server_ends_its_calls() -> None:
    with ModuleHarness(Client) as harness:
        harness.module.ask()
        harness.kill_server()
        (error,) = harness.module.errors
        assert isinstance(error, ServerDied)
        (request,) = harness.take(FindPath)
        harness.reply(request, FoundPath(length_m=1.0))
        assert not harness.module.paths


def test_server_that_is_stopped_ends_its_calls() -> None:
    with ModuleHarness(Client) as harness:
        harness.module.ask()
        harness.remove_server()
        (error,) = harness.module.errors
        assert isinstance(error, NoServer)
        assert "removed by the test" in str(error)


def test_dropped_request_is_noticed_before_the_timeout() -> None:
    with ModuleHarness(Client) as harness:
        harness.module.ask(timeout_s=100.0)
        harness.bus.peers.kept.clear()
        harness.advance(1.1)
        (error,) = harness.module.errors
        assert isinstance(error, CallLost)


def test_slow_server_is_waited_for() -> None:
    with ModuleHarness(Client) as harness:
        harness.module.ask(timeout_s=100.0)
        harness.advance(50.0)
        (request,) = harness.take(FindPath)
        harness.reply(request, FoundPath(length_m=1.0))
        assert len(harness.module.paths) == 1
        assert not harness.module.errors


def test_error_without_a_function_for_it_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    with ModuleHarness(Client) as harness:
        harness.remove_server()
        harness.module.call(FindPath(x_m=1.0), harness.module.paths.append)
        harness.advance(0.0)
        assert "NoServer: FindPath: no module serves it" in caplog.text


def test_number_of_calls_is_bounded() -> None:
    with ModuleHarness(Client) as harness:
        for _ in range(MAX_CALLS):
            harness.module.ask()
        with pytest.raises(TooManyCalls, match="1000 calls have not ended"):
            harness.module.ask()
        harness.advance(6.0)
        assert len(harness.module.errors) == MAX_CALLS
        harness.module.ask()


@pytest.mark.parametrize("timeout_s", [0.0, -1.0, 1e300, float("inf"), float("nan")])
def test_timeout_must_be_positive_and_finite(timeout_s: float) -> None:
    with ModuleHarness(Client) as harness, pytest.raises(InvalidTimeout, match="greater than 0"):
        harness.module.ask(timeout_s=timeout_s)


def test_call_in_setup_is_refused() -> None:
    class Hasty(Client):
        def setup(self) -> None:
            super().setup()
            self.ask()

    with pytest.raises(CalledInSetup, match="from the first message or tick on"), ModuleHarness(Hasty):
        pass


def test_error_function_may_call_again() -> None:
    with ModuleHarness(Client) as harness:
        harness.module.ask(timeout_s=1.0, on_error=lambda _error: harness.module.ask(timeout_s=1.0))
        harness.advance(3.0)
        assert len(harness.take(FindPath)) == 2
        assert len(harness.module.errors) == 1


def test_tick_may_call() -> None:
    with ModuleHarness(TickingClient) as harness:
        harness.advance(0.0)
        (request,) = harness.take(FindPath)
        harness.reply(request, FoundPath(length_m=1.0))
        harness.advance(1.0)
        assert not harness.take(Message)
