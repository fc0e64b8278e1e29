"""Calls over a simulated core, with deaths, drops and late steps at random: each call ends exactly once."""

import logging
from collections import Counter, deque
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from robbie_mp import CallError, CallRefused, Message, Reply, Request, uint32
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages.calls import reply_type
from robbie_mp.module.calls.calls import Calls
from robbie_mp.module.calls.peers import Server
from robbie_mp.module.clock import ManualClock

LOG = logging.getLogger(__name__)
TIMEOUT_S = 30.0


class Twice(Reply, name="test_deaths/srv/Double_Response"):
    number: uint32


class Double(Request[Twice], name="test_deaths/srv/Double_Request"):
    number: uint32


class Place:
    """A module as the core sees it: its queue and subscriptions outlive its processes."""

    def __init__(self, name: str):
        self.name = name
        self.incarnation = 0
        self.is_open = True
        self.queue: deque[tuple[str, Message, str]] = deque()
        self.handlers: dict[tuple[type[Message], str], Any] = {}

    def takes(self, message: Message, topic: str) -> bool:
        return self.is_open and (type(message), topic) in self.handlers


class Wire:
    """The bus of one process, and what it sees of the others."""

    can_serve = True

    def __init__(self, run: "Run", place: Place):
        self.run = run
        self.place = place
        self.name = place.name
        self.incarnation = place.incarnation
        self.peers = self.subscriptions = self
        self.sent_by = ""

    def subscribe(self, message_type: type[Message], handler: Any, _handling: Any, topic: str) -> None:
        self.place.handlers[message_type, topic] = handler

    def publish(self, message: Message, topic: str) -> bool:
        self.run.route(message, topic, self.name)
        return True

    def sender(self) -> str:
        return self.sent_by

    def now_ns(self) -> int:
        return self.run.clock.monotonic_ns()

    def find_server(self, service: ChannelName) -> Server | None:
        server = Server(self.run.server.name, 1, service)
        return server if self.run.server.is_open else None

    def serves(self, _server: Server) -> bool:
        return self.run.server.is_open

    def is_same(self, server: Server, incarnation: int) -> bool:
        return self.serves(server) and self.run.server.incarnation == incarnation

    def incarnation_of(self, _server: Server) -> int:
        return self.run.server.incarnation

    def end_of(self, _server: Server) -> str:
        return "stopped"

    def rival(self, _service: ChannelName) -> str | None:
        return None


class Run(RuleBasedStateMachine):
    """A client and a server."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = ManualClock()
        self.places = [Place("server"), Place("client")]
        self.server, self.client = self.places
        self.made: set[int] = set()
        """Numbers of the calls of the client's present process."""
        self.ends: Counter[int] = Counter()
        self.handled: Counter[int] = Counter()
        self.number = 0
        self.dies_in_handler = False
        self.start_client()
        self.start_server()

    def start_client(self) -> None:
        self.client.incarnation += 1
        self.client.handlers.clear()
        self.client_wire = Wire(self, self.client)
        self.calls = Calls(self.client_wire, self.clock, LOG)  # type: ignore[arg-type]
        self.made = set()

    def start_server(self) -> None:
        self.server.incarnation += 1
        self.server_wire = Wire(self, self.server)
        service = Calls(self.server_wire, self.clock, LOG)  # type: ignore[arg-type]
        service.server.serve(Double, self.on_double, "")

    def route(self, message: Message, topic: str, sender: str) -> None:
        for place in self.places:
            if place.takes(message, topic):
                place.queue.append((topic, message, sender))

    def on_double(self, request: Double) -> Twice:
        self.handled[request.call] += 1
        if self.dies_in_handler:
            raise SystemExit
        if request.number % 5 == 0:
            raise CallRefused("a multiple of 5")
        return Twice(number=2 * request.number)

    # -- what happens --------------------------------------------------------------------------------------

    @rule(calls=st.integers(1, 3))
    def client_calls(self, calls: int) -> None:
        for _ in range(calls):
            self.number += 1
            number = self.number
            self.made.add(number)

            def on_reply(reply: Twice, number: int = number) -> None:
                assert reply.number == 2 * number
                self.end(number)

            def on_error(_error: CallError, number: int = number) -> None:
                self.end(number)

            self.calls.client.call(
                Double(number=number), reply_type(Double), on_reply, on_error, TIMEOUT_S, ""
            )

    def end(self, number: int) -> None:
        assert number in self.made, "the call of a dead process ended"
        self.ends[number] += 1

    @rule()
    def client_handles(self) -> None:
        self.handle(self.client, self.client_wire)

    @precondition(lambda self: self.server.is_open)
    @rule()
    def server_handles(self) -> None:
        self.handle(self.server, self.server_wire)

    @precondition(lambda self: self.server.is_open and self.server.queue)
    @rule()
    def server_dies_in_handler(self) -> None:
        self.dies_in_handler = True
        try:
            self.handle(self.server, self.server_wire)
        except SystemExit:
            pass
        finally:
            self.dies_in_handler = False
        self.start_server()

    @precondition(lambda self: self.server.is_open)
    @rule()
    def server_dies_between_handlers(self) -> None:
        self.start_server()

    @rule()
    def server_is_stopped_or_started(self) -> None:
        self.server.is_open = not self.server.is_open
        self.server.queue.clear()
        if self.server.is_open:
            self.start_server()

    @rule()
    def client_dies(self) -> None:
        self.start_client()
        self.client.queue.clear()  # its new process has not subscribed to replies yet

    @rule(place=st.integers(0, 1))
    def queue_overflows(self, place: int) -> None:
        if self.places[place].queue:
            self.places[place].queue.popleft()

    @rule(seconds=st.sampled_from([0.0, 0.06, 0.5, 1.1]))
    def time_passes(self, seconds: float) -> None:
        self.clock.advance(seconds)
        self.calls.end_handling()
        if self.calls.are_due():
            self.calls.run()

    def handle(self, place: Place, wire: Wire) -> None:
        if place.queue:
            topic, message, sender = place.queue.popleft()
            handler = place.handlers.get((type(message), topic))
            wire.sent_by = sender
            if handler is not None:
                handler(type(message).decode(message.encode()))

    # -- what must hold ------------------------------------------------------------------------------------

    @invariant()
    def no_call_ends_twice_and_no_request_is_handled_twice(self) -> None:
        assert max(self.ends.values(), default=0) <= 1
        assert max(self.handled.values(), default=0) <= 1

    def teardown(self) -> None:
        """Let all arrive that is on its way: the living client's calls have ended, before they time out."""
        for _ in range(60):
            self.time_passes(0.06)
            for place, wire in ((self.server, self.server_wire), (self.client, self.client_wire)):
                while place.queue and place.is_open:
                    self.handle(place, wire)
        self.no_call_ends_twice_and_no_request_is_handled_twice()
        assert self.made <= set(self.ends)
        assert len(self.calls.client) == 0


Run.TestCase.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)
TestRun = Run.TestCase
