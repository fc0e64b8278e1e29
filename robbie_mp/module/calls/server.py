"""The server's side of calls: runs the handlers, sends replies and refusals, and answers questions."""

import logging
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np

from robbie_mp.bus.transport.records import MessageHandling
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages.calls import (
    Feedback,
    FeedbackType,
    Goal,
    ReplyType,
    Request,
    Result,
    ResultType,
    goal_types,
    number_call,
    reply_type,
)
from robbie_mp.messages.message import Message
from robbie_mp.messages.stock.robbie_msgs import CallRefusal, CallsAnswer, CallsQuestion, GoalCancel, GoalEnd
from robbie_mp.messages.well_formed import find_flaw, ill_formed
from robbie_mp.module.bus import Bus
from robbie_mp.module.calls.due import NEVER_NS, Due
from robbie_mp.module.calls.errors import CallRefused, CannotServe, GoalEnded, ServedTwice, WrongReply
from robbie_mp.module.calls.peers import service_topic
from robbie_mp.module.subscriptions import SubscribedTwice

LOOK_PERIOD_NS = 1_000_000_000
"""How often a server looks whether another module has begun to serve the same."""


GoalType = TypeVar("GoalType")


class ActiveGoal(Generic[GoalType, FeedbackType, ResultType]):
    """A goal that a module works on; `Module.serve_goals` gives it to the module.

    End it with exactly one of `succeed`, `abort`, `cancelled` and `preempt`.

    Attributes:
        goal: the goal, as the client sent it.
        client: the name of the module that sent it.
    """

    def __init__(
        self, server: "ServiceCalls", client: str, goal: GoalType, types: tuple[type[Feedback], type[Result]]
    ):
        self._server = server
        self._types = types
        self.goal = goal
        self.client = client
        self.was_cancelled = False
        """Whether its client has cancelled it. The client repeats that until the goal has ended."""

    @property
    def key(self) -> tuple[str, int]:
        """Client and call."""
        return self.client, self.goal.call  # type: ignore[attr-defined]

    @property
    def is_active(self) -> bool:
        """Whether it has not ended."""
        return self._server.goals.get(self.key) is self

    @property
    def memory(self) -> dict[str, Any]:
        """Goals for a checkpoint, so that the next process can continue them; see `Module.resume_goal`."""
        return {"client": self.client, "goal": self.goal.encode()}  # type: ignore[attr-defined]

    def feedback(self, feedback: FeedbackType) -> None:
        """Tell the client how far the work is.

        Args:
            feedback: of the type that belongs to the goal.

        Raises:
            GoalEnded: the goal has ended.
            WrongReply: the message has another type.
        """
        self._send(feedback, self._types[0])

    def succeed(self, result: ResultType) -> None:
        """End the goal with its result; arguments and errors as for `feedback`.

        Args:
            result: of the type that belongs to the goal.
        """
        self._send(result, self._types[1])
        del self._server.goals[self.key]

    def abort(self, reason: str) -> None:
        """End the goal, because it cannot be reached; the client gets `GoalAborted`.

        Args:
            reason: in plain words.

        Raises:
            GoalEnded: the goal has ended.
        """
        self._end(GoalEnd.ABORTED, reason)

    def cancelled(self, reason: str = "") -> None:
        """End the goal, because its client cancelled it; arguments and errors as for `abort`.

        Args:
            reason: in plain words.
        """
        self._end(GoalEnd.CANCELLED, reason)

    def preempt(self, reason: str) -> None:
        """End the goal, because another one takes its place. A goal that has ended stays as it is.

        Args:
            reason: in plain words.
        """
        if self.is_active:  # who replaces a goal need not know whether its client has cancelled it meanwhile
            self._end(GoalEnd.PREEMPTED, reason)

    def refuse(self, reason: str) -> None:
        """Refuse the goal after all, where another system decides; its client gets `CallRefused`.

        Args:
            reason: in plain words.

        Raises:
            GoalEnded: the goal has ended.
        """
        self._check_active()
        del self._server.goals[self.key]
        self._server.refuse(*self.key, reason)

    def _end(self, outcome: int, reason: str) -> None:
        self._check_active()
        del self._server.goals[self.key]
        self._server.send(self.client, GoalEnd(call=self.key[1], outcome=outcome, reason=reason))

    def _send(self, message: Message, wanted: type[Message]) -> None:
        self._check_active()
        if not isinstance(message, wanted):
            raise WrongReply(
                f"{message!r:.80} does not belong to {type(self.goal).__name__}; send a {wanted.__name__}"
            )
        number_call(message, self.key[1])
        self._server.send(self.client, message)

    def _check_active(self) -> None:
        if not self.is_active:
            raise GoalEnded(f"this {type(self.goal).__name__} of {self.client} has already ended")


class LaterReply:
    """A request whose reply comes later.

    Args:
        calls: the services of the module.
        client: the module that called.
        call: the number of the call.
    """

    def __init__(self, calls: "ServiceCalls", client: str, call: int):
        self._calls, self._client, self._call = calls, client, call

    def reply(self, reply: Message) -> None:
        """Send the reply, unless this call has ended already.

        Raises:
            MessageTooLarge: it does not fit into the module's memory; the request can still be refused.
        """
        if (self._client, self._call) in self._calls.later:
            number_call(reply, self._call)
            self._calls.send(self._client, reply)
            self._end()

    def refuse(self, reason: str) -> None:
        """Refuse the request, unless this call has ended already."""
        if self._end():
            self._calls.refuse(self._client, self._call, reason)

    def _end(self) -> bool:
        key = self._client, self._call
        is_open = key in self._calls.later
        self._calls.later.discard(key)
        return is_open


class ServiceCalls:
    """The services of one module.

    Args:
        bus: the module's bus.
        log: the module's logger.
        due: brought forward when something will be due for these services.

    Attributes:
        goals: the goals that are being worked on, by client and call.
        later: the requests whose replies come later, by client and call.
        refused: number of requests that a handler refused.
        repeated: number of goals ignored whose number belongs to a goal that has not ended.
        unsent: number of replies for which there was no memory.
    """

    def __init__(self, bus: Bus, log: logging.Logger, due: Due):
        self._bus = bus
        self._log = log
        self._due = due
        self._services: list[ChannelName] = []
        self.goals: dict[tuple[str, int], ActiveGoal[Any, Any, Any]] = {}
        self.later: set[tuple[str, int]] = set()
        self._on_cancels: dict[type[Message], Callable[[Any, str], None] | None] = {}
        self.refused = 0
        self.repeated = 0
        self.unsent = 0
        self.look_again_ns = 0

    @property
    def are_any(self) -> bool:
        """Whether the module serves anything."""
        return bool(self._services)

    def serve(
        self, request_type: type[Request[ReplyType]], handler: Callable[[Any], ReplyType], topic: str
    ) -> None:
        """Subscribe to the requests of a service.

        Raises:
            ServedTwice: this module already serves them.
            CannotServe: the module runs as a tool.
        """
        replies = reply_type(request_type)

        def on_request(request: Request[ReplyType]) -> None:
            client = self._bus.sender()
            if not self._is_well_formed(request, client):
                return
            try:
                reply = handler(request)
            except CallRefused as refusal:
                self.refuse(client, request.call, str(refusal))
                return
            if not isinstance(reply, replies):
                raise WrongReply(
                    f"the handler of {request_type.__name__} returned {reply!r}; "
                    f"return a {replies.__name__}, or raise CallRefused"
                )
            number_call(reply, request.call)
            self.send(client, reply)

        on_request.__qualname__ = getattr(handler, "__qualname__", type(handler).__qualname__)
        self.listen(request_type, on_request, topic)

    def serve_later(
        self,
        request_type: type[Message],
        handler: Callable[[Any, LaterReply], None],
        topic: str,
    ) -> None:
        """Subscribe to the requests of a service whose handler replies when it can; raises as `serve`.

        Args:
            request_type: the class of the requests, which have a field `call`.
            handler: gets each request, and what replies to it or refuses it, which it must do in the end.
            topic: the name of the service.
        """

        def on_request(request: Any) -> None:
            client = self._bus.sender()
            if self._is_well_formed(request, client):
                self.later.add((client, request.call))
                handler(request, LaterReply(self, client, request.call))

        self.listen(request_type, on_request, topic)

    def _is_well_formed(self, request: Any, client: str) -> bool:
        """Whether a request or goal is well formed; otherwise it is refused."""
        if (flaw := find_flaw(request)) is None:
            return True
        self.refuse(client, request.call, str(ill_formed(request.type_name, flaw)))
        return False

    def _is_repeated(self, active: ActiveGoal[Any, Any, Any]) -> bool:
        """Whether a client has used the number of a goal that has not ended; then the new goal is ignored.

        Otherwise one of the two would be lost without an end, or a reply would end the other one.
        """
        if active.key not in self.goals:
            return False
        self.repeated += 1
        name = type(active.goal).__name__
        self._log.warning("ignored a %s of %s: its goal %d has not ended", name, *active.key)
        return True

    def listen(
        self,
        request_type: type[Message],
        on_request: Callable[[Any], None],
        topic: str,
    ) -> None:
        """Subscribe to requests, and to the questions of their clients; raises as `serve`."""
        if not self._bus.peers.can_serve:
            raise CannotServe(f"{self._bus.peers.name} is a tool; serve in a module of the profile")
        subscriptions, own = self._bus.subscriptions, self._bus.peers.name
        service = ChannelName(request_type.type_name, request_type.version, service_topic(topic))
        always = MessageHandling.ALWAYS_DELIVER
        try:
            subscriptions.subscribe(request_type, on_request, always, service.topic)
        except SubscribedTwice as error:
            raise ServedTwice(f"this module already serves {_describe(service)}") from error
        if not self._services:
            subscriptions.subscribe(CallsQuestion, self._on_question, always, own)
        self._services.append(service)
        self._due.bring_forward(self.look_again_ns)

    def serve_goals(
        self,
        goal_type: type[Goal[FeedbackType, ResultType]],
        on_goal: Callable[[Any], None],
        on_cancel: Callable[[Any, str], None] | None,
        topic: str,
    ) -> None:
        """Subscribe to goals and to their cancels; raises as `serve`."""
        self.serve_goals_of(goal_type, goal_types(goal_type), on_goal, on_cancel, topic)

    def serve_goals_of(
        self,
        goal_type: type[Message],
        types: tuple[type[Any], type[Any]],
        on_goal: Callable[[Any], None],
        on_cancel: Callable[[Any, str], None] | None,
        topic: str,
    ) -> None:
        """Subscribe as `serve_goals`, to goals of a class without `Goal`.

        Args:
            goal_type: the class of the goals, which have a field `call`.
            types: the classes of feedback and result, which have such a field, too.
            on_goal: gets each goal.
            on_cancel: gets each goal that is cancelled, and the reason; None: it ends at once.
            topic: the name of the service.
        """

        def on_message(goal: Any) -> None:
            active: ActiveGoal[Any, Any, Any] = ActiveGoal(self, self._bus.sender(), goal, types)
            if not self._is_well_formed(goal, active.client) or self._is_repeated(active):
                return
            self.goals[active.key] = active
            try:
                on_goal(active)
            except CallRefused as refusal:
                self.goals.pop(active.key, None)
                self.refuse(active.client, goal.call, str(refusal))

        on_message.__qualname__ = getattr(on_goal, "__qualname__", type(on_goal).__qualname__)
        self.listen(goal_type, on_message, topic)
        if not self._on_cancels:
            always = MessageHandling.ALWAYS_DELIVER
            self._bus.subscriptions.subscribe(GoalCancel, self._on_cancel, always, self._bus.peers.name)
        self._on_cancels[goal_type] = on_cancel

    def resume(
        self, goal_type: type[Goal[FeedbackType, ResultType]], memory: dict[str, Any]
    ) -> "ActiveGoal[Any, FeedbackType, ResultType]":
        """Continue a goal of an earlier incarnation; see `Module.resume_goal`."""
        goal = goal_type.decode(memory["goal"])
        active: ActiveGoal[Any, FeedbackType, ResultType] = ActiveGoal(
            self, memory["client"], goal, goal_types(goal_type)
        )
        self.goals[active.key] = active
        return active

    def _on_cancel(self, cancel: GoalCancel) -> None:
        active = self.goals.get((self._bus.sender(), cancel.call))
        if active is None or active.was_cancelled:
            return  # it has just ended, or the client repeats the cancel
        active.was_cancelled = True
        on_cancel = self._on_cancels.get(type(active.goal))
        if on_cancel is None:
            active.cancelled(cancel.reason)
        else:
            on_cancel(active, cancel.reason)

    def due_ns(self) -> int:
        """Return when to look for rivals, by the machine's clock; NEVER_NS: it serves nothing."""
        return self.look_again_ns if self._services else NEVER_NS

    def check_rivals(self) -> None:
        """Check that no other module serves the same.

        Raises:
            ServedTwice: one that takes precedence does.
        """
        peers = self._bus.peers
        self.look_again_ns = peers.now_ns() + LOOK_PERIOD_NS
        for service in self._services:
            rival = peers.rival(service)
            if rival is not None:
                raise ServedTwice(
                    f"{peers.name} and {rival} both serve {_describe(service)}; {rival}, which is started "
                    "first, keeps it. Serve on another topic, or remove one of them"
                )

    def refuse(self, client: str, call: int, reason: str) -> None:
        """Send a refusal instead of a reply."""
        self.refused += 1
        self.send(client, CallRefusal(call=call, reason=reason))

    def send(self, client: str, message: Message) -> None:
        """Send a message to a client."""
        if not self._bus.publish(message, client):
            self.unsent += 1
            self._log.error("no memory to send a %s to %s", message.type_name, client)

    def _on_question(self, question: CallsQuestion) -> None:
        client = self._bus.sender()
        open_ = self.goals.keys() | self.later
        pending = [call for call in question.calls.tolist() if (client, call) in open_]
        self.send(client, CallsAnswer(calls=question.calls, pending=np.array(pending, np.uint64)))


def _describe(service: ChannelName) -> str:
    _, _, topic = service.topic.partition("/")
    return f"{service.type_name}{f' on topic {topic!r}' * bool(topic)}"
