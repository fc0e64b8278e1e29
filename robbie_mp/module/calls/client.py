"""The client's side of calls: sends requests, and ends each call exactly once."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from robbie_mp.bus.transport.records import MessageHandling
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages.calls import GOAL_SUFFIX, REQUEST_SUFFIX, number_call
from robbie_mp.messages.message import Message
from robbie_mp.messages.stock.robbie_msgs import CallRefusal, CallsAnswer, CallsQuestion, GoalCancel, GoalEnd
from robbie_mp.messages.well_formed import find_flaw, ill_formed
from robbie_mp.module.bus import Bus
from robbie_mp.module.calls.due import NEVER_NS, Due
from robbie_mp.module.calls.errors import (
    CallError,
    CallLost,
    CallNotSent,
    CallRefused,
    CallTimedOut,
    GoalAborted,
    GoalCancelled,
    GoalPreempted,
    InvalidTimeout,
    NoServer,
    ServerDied,
    TooManyCalls,
)
from robbie_mp.module.calls.peers import Server, service_topic
from robbie_mp.module.clock import Clock, is_span

MAX_CALLS = 1000
"""Limit of the calls of a module that have not ended."""
LOOK_PERIOD_NS = 50_000_000
"""Time between two looks at the servers of calls that have not ended."""
QUESTION_PERIOD_NS = 1_000_000_000
"""Time between two questions to a server that seems to work on a call."""
CANCEL_PERIOD_NS = 250_000_000
"""The same after the goal was cancelled: each question repeats the cancel, which may have been lost."""
CALL_BITS = 32
CALL_MASK = (1 << CALL_BITS) - 1
GOAL_ENDS: dict[int, type[CallError]] = {
    GoalEnd.CANCELLED: GoalCancelled,
    GoalEnd.ABORTED: GoalAborted,
    GoalEnd.PREEMPTED: GoalPreempted,
}
OnError = Callable[[CallError], None]


@dataclass(slots=True, eq=False)
class _Call:
    """A call that has not ended."""

    number: int
    label: str
    server: Server
    on_reply: Callable[[Any], None]
    on_error: OnError
    begun_ns: int
    """On the module's clock, as the next one."""
    timeout_ns: int | None
    asked_ns: int
    """When the server was asked about it, or sent the request."""
    incarnation: int
    """The incarnation of the server that was asked about the call, or got the request."""
    first_incarnation: int
    on_feedback: Callable[[Any], None] | None = None
    on_accepted: Callable[[], None] | None = None
    """Called once it is known that the server works on it; None: nobody asks, or it is known."""
    cancel_reason: str | None = None
    """Why the goal was cancelled; None if it was not."""
    is_over: bool = False
    """Whether its end was reported, though the server may still work on it and must be cancelled."""
    seems_gone: bool = False
    """Whether the server did not serve any more at the last look; a reply may be on its way."""

    def accept(self) -> None:
        """Report that the server works on it, unless that was reported."""
        report, self.on_accepted = self.on_accepted, None
        if report is not None:
            report()

    def question_due_ns(self) -> int:
        """Return when to ask the server about it."""
        return self.asked_ns + (QUESTION_PERIOD_NS if self.cancel_reason is None else CANCEL_PERIOD_NS)

    def timeout_due_ns(self) -> int | None:
        """Return when the call times out."""
        return None if self.timeout_ns is None else self.begun_ns + self.timeout_ns


@dataclass(slots=True, eq=False)
class _Service:
    """A service that this module has called."""

    name: ChannelName
    label: str
    server: Server | None = None
    """The server found last; None: there was none."""
    incarnation: int = 0
    """Its incarnation when it was found."""


class ClientCalls:
    """The calls that one module makes.

    Args:
        bus: the module's bus.
        clock: times the calls.
        log: the module's logger.
        due: brought forward when something will be due for these calls.

    Attributes:
        late: number of replies to calls that had already ended, or were made by an earlier incarnation.
    """

    def __init__(self, bus: Bus, clock: Clock, log: logging.Logger, due: Due):
        self._bus = bus
        self._clock = clock
        self._log = log
        self._due = due
        self._calls: dict[int, _Call] = {}
        self._failed: list[tuple[OnError, CallError]] = []
        """Calls that have failed; their errors are still to be reported."""
        self._services: dict[tuple[type[Message], str], _Service] = {}
        """Services that had a server when they were called last, by type of requests and topic."""
        self._listened: set[type[Any]] = set()
        self._listens_as = ""
        """The topic of this module's replies."""
        self._number = 0
        self._look_ns = 0
        self.late = 0

    def __len__(self) -> int:
        """Number of calls that have not ended."""
        return len(self._calls) + len(self._failed)

    @property
    def has_failed_calls(self) -> bool:
        """Whether errors are to be reported at once."""
        return bool(self._failed)

    def call(
        self,
        request: Message,
        replies: type[Message],
        on_reply: Callable[[Any], None],
        on_error: OnError | None,
        timeout_s: float | None,
        topic: str,
        feedbacks: type[Message] | None = None,
        on_feedback: Callable[[Any], None] | None = None,
        on_accepted: Callable[[], None] | None = None,
    ) -> int:
        """Send a request or a goal, which may be of a class without `Request`; see `Module.call`.

        Args:
            request: a message with a field `call`.
            replies: the type of the replies, which have such a field, too.
            on_reply: called with the reply.
            on_error: called with the error; None: it is logged.
            timeout_s: time for the reply; None: any.
            topic: the name of the service.
            feedbacks: for a goal, the type of its feedback.
            on_feedback: called with the feedback.
            on_accepted: called once when the server has accepted the goal, before anything else of it. If it
                refuses the goal, only `on_error` is called. None: nobody asks the server.

        Returns:
            The number of the call.
        """
        if timeout_s is not None and not is_span(timeout_s):
            raise InvalidTimeout(f"timeout_s={timeout_s}; give a time greater than 0, at most 1e9, in s")
        if len(self._calls) + len(self._failed) >= MAX_CALLS:
            raise TooManyCalls(
                f"{len(self)} calls have not ended; wait for replies, or give a shorter timeout"
            )
        if replies not in self._listened:
            self._listen(replies, self._on_reply)
        if feedbacks is not None and feedbacks not in self._listened:
            self._listen(feedbacks, self._on_feedback)
            if GoalEnd not in self._listened:
                self._listen(GoalEnd, self._on_goal_end)
        # The reply waits for what is done before the request is sent, but not for the rest.
        peers = self._bus.peers
        service = self._services.get((type(request), topic))
        if service is None or not (service.server and peers.is_same(service.server, service.incarnation)):
            service = self._find(type(request), topic)
        self._number = self._number + 1 & CALL_MASK
        number = peers.incarnation << CALL_BITS | self._number
        report = on_error or self._log_error
        server, incarnation = service.server, service.incarnation
        if server is None:
            self._report_soon(report, NoServer(f"{service.label}: no module serves it"))
            return number
        number_call(request, number)
        is_sent = self._bus.publish(request, service.name.topic)
        if not is_sent:
            full = CallNotSent(f"{service.label}: this module's memory or ring is full")
            self._report_soon(report, full)
            return number
        now_ns = self._clock.monotonic_ns()
        timeout_ns = None if timeout_s is None else round(timeout_s * 1e9)
        look_ns = peers.now_ns() + min(LOOK_PERIOD_NS, timeout_ns or LOOK_PERIOD_NS)
        self._look_ns = min(look_ns, self._look_ns) if self._calls else look_ns
        self._due.bring_forward(self._look_ns)
        self._calls[number] = call = _Call(
            number,
            service.label,
            server,
            on_reply,
            report,
            now_ns,
            timeout_ns,
            now_ns,
            incarnation,
            incarnation,
            on_feedback,
            on_accepted,
        )
        if on_accepted is not None:
            self._ask([call])  # the question arrives after the goal, so the answer tells what became of it
        return number

    def end_earlier(self, number: int, goal_type: type[Message], topic: str, reason: str) -> None:
        """Cancel a goal that an earlier process of this module has sent, until its server has ended it.

        Args:
            number: the number of its call.
            goal_type: its class.
            topic: the name of the service.
            reason: in plain words.
        """
        service = self._find(goal_type, topic)
        if service.server is None or number in self._calls:
            return
        if GoalEnd not in self._listened:
            self._listen(GoalEnd, self._on_goal_end)
        now_ns, incarnation = self._clock.monotonic_ns(), service.incarnation
        self._calls[number] = call = _Call(
            number,
            service.label,
            service.server,
            _ignore,
            _ignore,
            now_ns,
            None,
            now_ns,
            incarnation,
            incarnation,
            cancel_reason=reason,
            is_over=True,
        )
        self._look_ns = self._bus.peers.now_ns() + LOOK_PERIOD_NS
        self._due.bring_forward(self._look_ns)
        self._ask([call])

    def cancel(self, number: int, reason: str) -> bool:
        """Ask the server of a goal to end it, again and again until it has; False if it has ended already."""
        call = self._calls.get(number)
        if call is None or call.is_over:
            return False
        call.cancel_reason = reason
        self._ask([call])
        return True

    def is_waiting(self, number: int) -> bool:
        """Whether a call has not ended."""
        call = self._calls.get(number)
        return call is not None and not call.is_over

    def forget_place(self) -> None:
        """End all calls, because this module has lost its place in the run and gets another one."""
        for call in list(self._calls.values()):
            self._fail(call, CallLost(f"{call.label}: this tool was detached"))
        for message_type in self._listened:
            self._bus.subscriptions.forget(message_type, self._listens_as)
        self._listened.clear()
        self._services.clear()

    # -- what is due ---------------------------------------------------------------------------------------

    def due_ns(self) -> int:
        """Return when something is due, by the machine's clock; NEVER_NS: nothing is."""
        if self._failed:
            return 0
        return self._look_ns if self._calls else NEVER_NS

    def report(self) -> None:
        """Report the errors of the calls that have failed."""
        failed, self._failed = self._failed, []
        for on_error, error in failed:
            on_error(error)

    def expire(self) -> None:
        """End the calls whose time is up, and ask about those that take long; both by the module's clock."""
        now_ns = self._clock.monotonic_ns()
        old: list[_Call] = []
        for call in list(self._calls.values()):
            if now_ns < call.begun_ns:  # the run's time was set back
                call.begun_ns = call.asked_ns = now_ns
            due_ns = call.timeout_due_ns()
            if due_ns is not None and now_ns >= due_ns:
                self._time_out(call, (now_ns - call.begun_ns) / 1e9)
            elif now_ns >= call.question_due_ns():
                old.append(call)
        self._ask(old)

    def _time_out(self, call: _Call, waited_s: float) -> None:
        """End a call whose time is up; a goal is also cancelled, and kept until its server has ended it."""
        if call.on_feedback is not None:
            self.cancel(call.number, "its time is up")
        self._fail(
            call, CallTimedOut(f"{call.label}: {call.server.module} has not replied in {waited_s:.3g} s")
        )
        if call.on_feedback is not None:
            call.is_over, call.timeout_ns = True, None
            self._calls[call.number] = call

    def is_look_due(self) -> bool:
        """Whether it is time to look at the servers."""
        return bool(self._calls) and self._bus.peers.now_ns() >= self._look_ns

    def look(self) -> None:
        """Look whether servers have ended, or are other processes than those that got the requests."""
        peers = self._bus.peers
        self._look_ns = peers.now_ns() + min(LOOK_PERIOD_NS, self._soonest_timeout_ns())
        seen: dict[Server, tuple[bool, int]] = {}
        orphans: list[_Call] = []
        for call in list(self._calls.values()):
            server = call.server
            if server not in seen:
                seen[server] = peers.serves(server), peers.incarnation_of(server)
            serves, incarnation = seen[server]
            if not serves and call.seems_gone:
                end = peers.end_of(server)
                self._fail(call, NoServer(f"{call.label}: {server.module} serves it no longer ({end})"))
            elif serves and incarnation != call.incarnation:
                call.incarnation = incarnation
                orphans.append(call)
            call.seems_gone = not serves
        self._ask(orphans)

    def _soonest_timeout_ns(self) -> int:
        """Return the time until the next call times out, if the module's clock runs as the machine's."""
        now_ns = self._clock.monotonic_ns()
        dues = (call.timeout_due_ns() for call in self._calls.values())
        left_ns = min((due_ns - now_ns for due_ns in dues if due_ns is not None), default=LOOK_PERIOD_NS)
        return left_ns if left_ns > 0 else LOOK_PERIOD_NS

    def _ask(self, calls: list[_Call]) -> None:
        """Ask the servers of calls whether they still work on them; repeat the cancels of goals."""
        now_ns = self._clock.monotonic_ns()
        numbers: dict[str, list[int]] = {}
        for call in calls:
            call.asked_ns = now_ns
            if call.cancel_reason is not None:
                cancel = GoalCancel(call=call.number, reason=call.cancel_reason)
                self._bus.publish(cancel, call.server.module)
            numbers.setdefault(call.server.module, []).append(call.number)
        if calls and CallsAnswer not in self._listened:
            self._listen(CallsAnswer, self._on_answer)
        for module, asked in numbers.items():
            self._bus.publish(CallsQuestion(calls=np.array(asked, np.uint64)), module)

    # -- what arrives --------------------------------------------------------------------------------------

    def _listen(self, message_type: type[Any], handler: Callable[[Any], None]) -> None:
        self._listened.add(message_type)
        always = MessageHandling.ALWAYS_DELIVER
        subscriptions, own = self._bus.subscriptions, self._bus.peers.name
        self._listens_as = own
        subscriptions.subscribe(message_type, handler, always, own)
        if CallRefusal not in self._listened:
            self._listened.add(CallRefusal)
            subscriptions.subscribe(CallRefusal, self._on_refusal, always, own)

    def _on_reply(self, reply: Any) -> None:
        call = self._take(reply.call)
        if call is None:
            return
        call.accept()
        if (flaw := find_flaw(reply)) is None:
            call.on_reply(reply)
        else:
            call.on_error(CallLost(f"{call.label}: {ill_formed(reply.type_name, flaw)}"))

    def _on_refusal(self, refusal: CallRefusal) -> None:
        call = self._take(refusal.call)
        if call is not None:
            call.on_error(CallRefused(refusal.reason))

    def _on_feedback(self, feedback: Any) -> None:
        call = self._calls.get(feedback.call)
        if call is None or call.is_over or call.server.module != self._bus.sender():
            self.late += 1
        elif call.on_feedback is not None:
            call.accept()
            call.on_feedback(feedback)

    def _on_goal_end(self, end: GoalEnd) -> None:
        call = self._take(end.call)
        if call is not None:
            call.accept()
            call.on_error(GOAL_ENDS.get(end.outcome, GoalAborted)(end.reason))

    def _on_answer(self, answer: CallsAnswer) -> None:
        sender = self._bus.sender()
        pending = set(answer.pending.tolist())
        for number in answer.calls.tolist():
            call = self._calls.get(number)
            if call is None or call.server.module != sender:
                continue
            if number in pending:
                call.accept()
            else:
                self._fail(call, self._lost(call))
        self.report()

    def _lost(self, call: _Call) -> CallError:
        module = call.server.module
        if call.incarnation != call.first_incarnation:
            return ServerDied(f"{call.label}: {module} died before it replied, and has been restarted")
        return CallLost(f"{call.label}: the request or the reply of {module} was dropped")

    def _take(self, number: int) -> _Call | None:
        """Return the call that the message being handled ends; None if it ends none."""
        call = self._calls.get(number)
        if call is None or call.server.module != self._bus.sender():
            self.late += 1
            self._log.debug("a reply came too late: call %d", number)
            return None
        del self._calls[number]
        if call.is_over:
            self.late += 1
            return None
        return call

    def _fail(self, call: _Call, error: CallError) -> None:
        """End a call; its error is reported by the next `report`, unless its end was reported before."""
        del self._calls[call.number]
        if not call.is_over:
            self._report_soon(call.on_error, error)

    def _report_soon(self, on_error: OnError, error: CallError) -> None:
        self._failed.append((on_error, error))
        self._due.bring_forward(0)

    def _find(self, request_type: type[Message], topic: str) -> _Service:
        """Find the server of a service, and remember it."""
        name = request_type.__name__.removesuffix(REQUEST_SUFFIX).removesuffix(GOAL_SUFFIX)
        service = _Service(
            ChannelName(request_type.type_name, request_type.version, service_topic(topic)),
            f"{name}{f' on topic {topic!r}' * bool(topic)}",
        )
        peers = self._bus.peers
        service.server = peers.find_server(service.name)
        if service.server is None:
            self._services.pop((request_type, topic), None)
        else:
            service.incarnation = peers.incarnation_of(service.server)
            self._services[request_type, topic] = service
        return service

    def _log_error(self, error: CallError) -> None:
        self._log.error("%s: %s", type(error).__name__, error)


class SentGoal:
    """A goal that a module has sent; `Module.send_goal` returns it."""

    def __init__(self, client: ClientCalls, number: int):
        self._client = client
        self._number = number

    @property
    def is_active(self) -> bool:
        """Whether the goal has not ended."""
        return self._client.is_waiting(self._number)

    def cancel(self, reason: str = "") -> bool:
        """Ask the server to end the goal. The goal ends when the server says so, with `GoalCancelled`.

        The module repeats the request until the goal has ended, because a message may be lost with a process.

        Args:
            reason: in plain words.

        Returns:
            False if the goal has already ended.
        """
        return self._client.cancel(self._number, reason)


def _ignore(_: object) -> None:
    """Do nothing: the client has already been told that its goal ended."""
