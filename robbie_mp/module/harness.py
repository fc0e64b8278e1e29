"""Runs a module inside a test, without a process or shared memory; the test controls the time."""

import contextlib
import weakref
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from types import TracebackType
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from typing_extensions import Self

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.bus.checkpoint.image import decode, encode
from robbie_mp.bus.transport.records import ANY_VERSION
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages import (
    CallRefusal,
    CallsAnswer,
    CallsQuestion,
    GoalCancel,
    GoalEnd,
    Message,
    lay_out,
    replace,
)
from robbie_mp.messages.calls import (
    GOAL_SUFFIX,
    REQUEST_SUFFIX,
    FeedbackType,
    Goal,
    ReplyType,
    Request,
    ResultType,
    reply_type,
)
from robbie_mp.messages.encoded import check_encapsulation, check_type
from robbie_mp.messages.errors import MessageError, NotAMessage
from robbie_mp.messages.message import check_message, check_message_type
from robbie_mp.messages.well_formed import check_well_formed
from robbie_mp.module.bus import CopyingBus, PublishAfterStop
from robbie_mp.module.calls.client import GOAL_ENDS
from robbie_mp.module.calls.errors import CallError, CallRefused
from robbie_mp.module.calls.peers import Server, service_topic
from robbie_mp.module.class_check import check_class
from robbie_mp.module.clock import ManualClock, is_duration
from robbie_mp.module.envelope import EncodedMessage, Envelope, MessageType
from robbie_mp.module.lent_memory import CopiedLoans, freeze_named_arrays
from robbie_mp.module.loop import ModuleLoop
from robbie_mp.module.module import Module, ModuleContext
from robbie_mp.module.setting_changes import SettingChanges
from robbie_mp.module.settings import check_settings
from robbie_mp.module.subscriptions import Subscription
from robbie_mp.module.ticks import TimedTicks
from robbie_mp.module.wiring import UNCHANGED, Wiring, check_topic

ModuleClass = TypeVar("ModuleClass", bound=Module)
GoalType = TypeVar("GoalType", bound=Goal[Any, Any])
CLIENT = "client"
SERVER = "server"
"""Names of the modules that call the module under test, and that serve it."""
CALL_LOOK_S = 0.2
"""Time within which a module notices what became of a server."""


class NotEntered(RobbieError, RuntimeError):
    """A test uses a harness without a `with` block, so `setup()` has not run."""


ROUNDED_S = 1e-9
"""A negative time that is smaller counts as 0."""


class InvalidAdvance(RobbieError, ValueError):
    """A test moves the time by something that is no time, or back."""


class Published(NamedTuple):
    """A message that the module under test has published."""

    message: Message
    topic: str


class PublishedEncoded(NamedTuple):
    """An encoded message that the module under test has published."""

    type_name: str
    version: int
    data: bytes
    topic: str


class ModuleHarness(Generic[ModuleClass]):
    """Sends messages to a module and collects what it publishes.

        with ModuleHarness(Obstacles, {"stop_distance_m": 0.5}) as harness:
            harness.send(LaserScan(ranges=[0.4]))
            assert harness.take(DriveCommand)

    Messages and checkpoints are encoded and decoded as in a robot: handlers get read-only arrays, and wrong
    field types are errors.

    Args:
        module_class: the class under test.
        settings: values of settings; the other settings have their defaults.
        output_directory: where the module writes results; by default a folder that is removed with the
            harness.
        name: the module's name in the profile.
        restored: the state that the module finds in `restored`, such as `checkpoint` of another harness.
        checkpoint_lost: whether a newer state than `restored` was damaged.
        topics: new names of topics by the module's own, as in a profile. `send` and `take` use the new ones.
        namespace: comes before the names of the module's topics, as in a profile.
        folder: relative paths in settings start from it; by default the current one.

    Attributes:
        module: the module under test.
        clock: the module's clock; it stands still except in `advance`.

    Raises:
        InvalidClass: the class has mistakes, as `robbie run` reports them before it starts.
        SettingError: a setting is wrong.
    """

    checks_class: ClassVar[bool] = True
    """Whether mistakes of the class are looked for."""

    def __init__(
        self,
        module_class: type[ModuleClass],
        settings: Mapping[str, object] | None = None,
        *,
        output_directory: Path | None = None,
        name: str = "module",
        restored: object = None,
        checkpoint_lost: bool = False,
        topics: Mapping[str, str] | None = None,
        namespace: str = "",
        folder: Path | None = None,
    ):
        if self.checks_class:
            check_class(module_class)
        self._is_entered = False
        self.clock = self.make_clock()
        self.bus = self.make_bus(name, Wiring(topics, namespace))
        self._checkpoints = HarnessCheckpoints(restored, int(checkpoint_lost))
        checked = check_settings(module_class, settings or {}, folder=folder)
        module_class.check(checked)
        if output_directory is None:
            output_directory = Path(mkdtemp(prefix="robbie-harness-"))
            weakref.finalize(self, rmtree, output_directory, ignore_errors=True)
        self.module = module_class(
            ModuleContext(
                name=name,
                settings=checked,
                bus=self.bus,
                clock=self.clock,
                checkpoints=self._checkpoints,
                output_directory=output_directory,
                show_status=lambda _line: None,
            )
        )
        self._changes = SettingChanges(self.module, self.bus)
        self._loop = ModuleLoop(self.module, self.bus, TimedTicks(self.module, self.clock), self._changes)
        self._last_call = 0

    def make_clock(self) -> ManualClock:
        """Return the module's clock."""
        return ManualClock()

    def make_bus(self, name: str, wiring: Wiring) -> "HarnessBus":
        """Return the module's bus."""
        return HarnessBus(self.clock, name, wiring)

    def __enter__(self) -> Self:
        """Run `setup()`.

        Raises:
            InvalidPeriod: the module's `period_s` is not positive, or it has a `tick()` but no period.
        """
        self._is_entered = True
        self._loop.set_up()
        self._loop.begin()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Run `teardown()` as an ordered stop does, unless the test has already failed."""
        if error is None:
            self._loop.tear_down()
        self.bus.stopped = True

    def send(self, message: Message, *, topic: str = "", sender: str = "test") -> None:
        """Let the module handle a message now.

        Args:
            message: the message.
            topic: the topic it is published on.
            sender: the name of its publisher, for `envelope`.

        Raises:
            NotAMessage: something else is sent.
            NotSubscribed: the module does not subscribe to such messages now.
            NotEntered: the harness is used without `with`.
        """
        check_message(message, "send")
        self.send_encoded(message.type_name, message.version, message.encode(), topic=topic, sender=sender)

    def _send(self, message: Message, *, topic: str, sender: str) -> None:
        """Send a message of a call, which the module may not know."""
        with contextlib.suppress(NotSubscribed):
            self.send(message, topic=topic, sender=sender)

    # -- calls ---------------------------------------------------------------------------------------------

    def call(self, request: Request[ReplyType], *, topic: str = "") -> ReplyType:
        """Let the module under test serve a request now.

            with ModuleHarness(Planner) as harness:
                assert harness.call(FindPath(x_m=1.0)).length_m == 1.0

        Args:
            request: the request.
            topic: the name of the service.

        Returns:
            The module's reply.

        Raises:
            CallRefused: the module refused it.
            LookupError: the module does not serve such requests.
            NotAMessage, DeclarationError: this is no request.
        """
        check_message(request, "call")
        replies: type[ReplyType] = reply_type(type(request))
        self._last_call += 1
        before = len(self.bus.published)
        self._send(replace(request, call=self._last_call), topic=service_topic(topic), sender=CLIENT)
        for entry in self.bus.published[before:]:
            message = entry.message
            if isinstance(message, CallRefusal) and message.call == self._last_call:
                self.bus.published.remove(entry)
                raise CallRefused(message.reason)
            if isinstance(message, replies) and message.call == self._last_call:
                self.bus.published.remove(entry)
                return replace(message, call=0)  # it equals the reply that a test makes
        raise LookupError(f"{type(self.module).__name__} does not serve {type(request).__name__}")

    def feed_back(self, goal: Goal[FeedbackType, Any], feedback: FeedbackType) -> None:
        """Send feedback on a goal of the module under test.

        Args:
            goal: the goal, which you have taken with `take`.
            feedback: the feedback.

        Raises:
            NotAMessage: they are no goal and no feedback.
        """
        check_call(goal, "feed_back")
        check_call(feedback, "feed_back")
        self._send(replace(feedback, call=goal.call), topic=self.module.name, sender=SERVER)

    def end_goal(self, goal: Goal[Any, ResultType], end: ResultType | CallError) -> None:
        """End a goal of the module under test, as its server does.

        Args:
            goal: the goal, which you have taken with `take`.
            end: its result; or `GoalAborted`, `GoalCancelled` or `GoalPreempted` with a reason.

        Raises:
            NotAMessage: this is no goal, or its end is no result.
        """
        check_call(goal, "end_goal")
        message: Message
        if isinstance(end, CallError):
            outcome = next(one for one, kind in GOAL_ENDS.items() if isinstance(end, kind))
            message = GoalEnd(call=goal.call, outcome=outcome, reason=str(end))
        else:
            check_call(end, "end_goal")
            message = replace(end, call=goal.call)
        self._send(message, topic=self.module.name, sender=SERVER)

    def send_goal(self, goal: GoalType, *, topic: str = "", client: str = CLIENT) -> GoalType:
        """Send a goal to the module under test, which handles it at once.

        Use `take` to see what the module answers: feedback, the result, `GoalEnd` or `CallRefusal`.

        Args:
            goal: the goal.
            topic: the name of the service.
            client: the name of the module that sends it.

        Returns:
            The goal as it was sent, for `cancel_goal`.

        Raises:
            NotAMessage: this is no goal.
        """
        check_call(goal, "send_goal")
        self._last_call += 1
        sent = replace(goal, call=self._last_call)
        self._send(sent, topic=service_topic(topic), sender=client)
        return sent

    def cancel_goal(self, goal: Goal[Any, Any], reason: str = "", *, client: str = CLIENT) -> None:
        """Cancel a goal that was sent with `send_goal`.

        Args:
            goal: the goal that `send_goal` returned.
            reason: in plain words.
            client: the name of the module that sent it.

        Raises:
            NotAMessage: this is no goal.
        """
        check_call(goal, "cancel_goal")
        self._send(GoalCancel(call=goal.call, reason=reason), topic=self.module.name, sender=client)

    def reply(self, request: Request[ReplyType], reply: ReplyType) -> None:
        """Reply to a request of the module under test, which you have taken with `take`.

            (request,) = harness.take(FindPath)
            harness.reply(request, FoundPath(length_m=3.0))

        Args:
            request: the request.
            reply: the reply.

        Raises:
            NotAMessage: they are no request and no reply.
        """
        check_call(request, "reply")
        check_call(reply, "reply")
        self._send(replace(reply, call=request.call), topic=self.module.name, sender=SERVER)

    def refuse(self, request: Request[Any], reason: str) -> None:
        """Refuse a request of the module under test.

        Args:
            request: the request.
            reason: what the server says.

        Raises:
            NotAMessage: this is no request.
        """
        check_call(request, "refuse")
        self._send(CallRefusal(call=request.call, reason=reason), topic=self.module.name, sender=SERVER)

    def kill_server(self) -> None:
        """Let the server of all requests die; its next process knows none of them."""
        self.bus.peers.server_incarnation += 1
        self.bus.peers.kept.clear()
        self.advance(CALL_LOOK_S)

    def remove_server(self) -> None:
        """Let there be no server for any request from now on, as when it was stopped."""
        self.bus.peers.has_server = False
        self.advance(CALL_LOOK_S)

    # ------------------------------------------------------------------------------------------------------

    def send_encoded(
        self, type_name: str, version: int, data: bytes, *, topic: str = "", sender: str = "test"
    ) -> None:
        """Let the module handle an encoded message now.

        Args:
            type_name: full name of the message's type, which needs no class.
            version: version of that type.
            data: the encoded message with its 4 bytes of encapsulation.
            topic: the topic it is published on.
            sender: the name of its publisher, for `envelope`.

        Raises:
            NotSubscribed: the module does not subscribe to such messages now.
            NotEntered: the harness is used without `with`.
        """
        self._check_entered()
        is_taken = self.bus.deliver(ChannelName(type_name, version, topic), data, sender)
        self._loop.run_calls()
        while self.bus.handle_next():
            self._loop.run_calls()
        if not is_taken:
            raise _not_subscribed(type(self.module).__name__, type_name, topic, self.bus.subscriptions)

    def change_setting(self, name: str, value: object) -> None:
        """Change a setting as `robbie param set` does.

        Args:
            name: the setting.
            value: its new value, as a profile would hold it.

        Raises:
            NotChangeable: the module has no changeable setting of this name.
            SettingError: the value does not fit, or the module refuses it.
            NotEntered: the harness is used without `with`.
        """
        self._check_entered()
        self._changes.change(name, value)

    def advance(self, seconds: float) -> None:
        """Move the time forward and run every tick that becomes due; the first tick is due at once.

        Args:
            seconds: how far.

        Raises:
            InvalidAdvance: this is no time, or a negative one.
            NotEntered: the harness is used without `with`.
        """
        self._check_entered()
        if isinstance(seconds, float) and -ROUNDED_S < seconds < 0.0:
            seconds = 0.0  # what a sum of floats leaves
        if not is_duration(seconds):
            raise InvalidAdvance(
                f"advance({seconds!r}): give a time from 0 to 1e9, in s; it does not go back"
            )
        end_ns = self.bus.end_ns = self.clock.monotonic_ns() + round(seconds * 1e9)
        self.bus.is_over = False
        while not (self.bus.is_over or self._loop.ends):
            self._loop.turn()
        self.clock.advance(max(0, end_ns - self.clock.monotonic_ns()) / 1e9)

    def _check_entered(self) -> None:
        if not self._is_entered:
            name = type(self.module).__name__
            raise NotEntered(
                f"setup() has not run; write `with ModuleHarness({name}) as harness:`, and use it there"
            )

    @property
    def checkpoint(self) -> Any:
        """The state that the module would find in `restored` after a crash now; None for a fresh start."""
        return decode(self._checkpoints.image).state

    @property
    def published(self) -> list[Published]:
        """Everything that the module has published and the test has not taken."""
        return self.bus.published

    @property
    def published_encoded(self) -> list[PublishedEncoded]:
        """Every encoded message that the module has published."""
        return self.bus.published_encoded

    def latched(self, message_type: type[MessageType], topic: str = "") -> MessageType | None:
        """Return the message that a module would get first if it subscribed now.

        Args:
            message_type: the class of the message.
            topic: its topic.

        Returns:
            The newest message of the type on the topic, None if the module has not published any as latched.

        Raises:
            NotAMessage: this is no class of messages.
        """
        check_message_type(message_type, "latched")
        data = self.bus.latched.get(ChannelName(message_type.type_name, message_type.version, topic))
        return None if data is None else message_type.decode(data)

    def take(self, message_type: type[MessageType], topic: str | None = None) -> list[MessageType]:
        """Take the messages of a type out of what the module has published.

        Args:
            message_type: the class of the messages.
            topic: take only messages on this topic; None for all.

        Returns:
            The messages, in the order of publishing.

        Raises:
            NotAMessage: this is no class of messages.
        """
        if message_type is not Message:
            check_message_type(message_type, "take")
        taken: list[MessageType] = []
        kept: list[Published] = []
        for entry in self.bus.published:
            if isinstance(entry.message, message_type) and topic in (None, entry.topic):
                taken.append(entry.message)
            else:
                kept.append(entry)
        self.bus.published[:] = kept
        return taken


def check_call(message: object, verb: str) -> None:
    """Check that a test gives a message that belongs to a call.

    Args:
        message: what should be one.
        verb: the method of the harness.

    Raises:
        NotAMessage: it is something else.
    """
    check_message(message, verb)
    if not hasattr(message, "call"):
        name = type(message).__name__
        raise NotAMessage(f"{verb} wants a message of a call, such as a request, reply or goal; got a {name}")


class HarnessPeers:
    """The other modules, as the test wants them: one server for all requests; see `Peers`.

    Args:
        name: the name of the module under test.
        clock: the test's time.

    Attributes:
        has_server: whether there is a server.
        server_incarnation: number of the server's process.
        kept: calls that the server works on or has replied to.
    """

    can_serve = True
    incarnation = 1

    def __init__(self, name: str, clock: ManualClock):
        self.name = name
        self._clock = clock
        self.has_server = True
        self.server_incarnation = 1
        self.kept: set[int] = set()

    def now_ns(self) -> int:
        """The test's time."""
        return self._clock.monotonic_ns()

    def find_server(self, service: ChannelName) -> Server | None:
        """Return the server."""
        return Server(SERVER, 1, service) if self.has_server else None

    def serves(self, _server: Server) -> bool:
        """Whether there is a server."""
        return self.has_server

    def is_same(self, _server: Server, incarnation: int) -> bool:
        """Whether there is a server, with this process."""
        return self.has_server and self.server_incarnation == incarnation

    def incarnation_of(self, _server: Server) -> int:
        """Return the number of the server's process."""
        return self.server_incarnation

    def end_of(self, _server: Server) -> str:
        """Say that the test removed it."""
        return "removed by the test"

    def rival(self, _service: ChannelName) -> str | None:
        """There is no other server."""
        return None


class NotSubscribed(RobbieError, LookupError):
    """A test sends a module a message that none of its subscriptions takes.

    Example scenarios:
      - the topic is misspelled, or left out
      - the module subscribes only later, in another handler
    """


_SENT_BY = {
    "Request": "call()",
    "Response": "reply()",
    "Goal": "send_goal()",
    "Feedback": "feed_back()",
    "Result": "end_goal()",
}
"""By the end of the name of a message of calls: the method of the harness that sends it."""


def _not_subscribed(
    module: str, type_name: str, topic: str, subscriptions: Iterable[Subscription]
) -> NotSubscribed:
    topics = {one.name.topic: one for one in subscriptions if one.name.type_name == type_name}
    takes = f"; it takes it on {', '.join(map(repr, sorted(topics)))}"
    if "/msg/" not in type_name and (method := _SENT_BY.get(type_name.rpartition("_")[2])):
        takes = f"; it is part of a call, so send it with {method}"
    why = (did_you_mean(topic, topics) or takes) if topics else "; it does not subscribe to this type"
    return NotSubscribed(f"{module} takes no {type_name} on topic {topic!r}{why}")


class HarnessCheckpoints:
    """Keeps the image of a module's newest checkpoint; its size has no limit."""

    def __init__(self, restored: object, lost: int):
        self.image = encode(restored)
        self.lost = lost

    @property
    def restored(self) -> Any:
        """The state in the image, with copies of its arrays."""
        return decode(self.image).state

    def save(self, state: object) -> bool:
        """Replace the image."""
        self.image = encode(state)
        return True


class HarnessBus(CopyingBus):
    """A bus with one module on it."""

    def __init__(self, clock: ManualClock, name: str = "module", wiring: Wiring = UNCHANGED):
        numbers = count()
        super().__init__(lambda _: next(numbers), wiring)
        self._clock = clock
        self._wiring = wiring
        self.peers = HarnessPeers(name, clock)
        self._questions: deque[list[int]] = deque()
        """Questions of the module about its calls."""
        self.end_ns = 0
        """Until when the time may pass while the module waits."""
        self.is_over = True
        """Whether the module waits although that time has come."""
        self._sequence = 0
        self.published: list[Published] = []
        self.published_encoded: list[PublishedEncoded] = []
        self.stopped = False
        self.copied_loans = CopiedLoans(self._log)
        self.latched: dict[ChannelName, bytes] = {}
        """The newest message of each latched channel."""

    @property
    def outstanding(self) -> int:
        """Always 0: the harness takes each message at once."""
        return 0

    def deliver(self, name: ChannelName, data: bytes, sender: str) -> bool:
        """Run every handler that subscribes to a message, but of those with patterns only the first.

        Returns:
            Whether there is any.
        """
        self._sequence += 1
        own_topic = self._wiring.own(name.type_name, name.topic)
        envelope = Envelope(own_topic, self._sequence, sender, self._clock.monotonic_ns())
        matched = matched_pattern = False
        for subscription in self.subscriptions:
            by_pattern = subscription.name.version == ANY_VERSION
            if (by_pattern and matched_pattern) or not subscription.name.takes(name):
                continue
            matched_pattern |= by_pattern
            matched = True
            self.hand_over(subscription, name, envelope, data)
        return matched

    def lose(self, error: MessageError) -> None:
        """Let the test fail: its message cannot be decoded."""
        raise error

    def handle_next(self) -> bool:
        """Answer the module's next question about its calls, as their server; False if there is none."""
        if not self._questions:
            return False
        asked = self._questions.popleft()
        pending = [call for call in asked if call in self.peers.kept]
        answer = CallsAnswer(calls=np.array(asked, np.uint64), pending=np.array(pending, np.uint64))
        name = ChannelName(answer.type_name, answer.version, self.peers.name)
        self.deliver(name, answer.encode(), SERVER)
        return True

    def wait(self, timeout_s: float) -> bool:
        """Let the time pass, unless there is a question to answer."""
        left_ns = self.end_ns - self._clock.monotonic_ns()
        self.is_over = left_ns <= 0 and not self._questions
        if left_ns > 0 and not self._questions:
            self._clock.advance(max(1, min(left_ns, timeout_s * 1e9)) / 1e9)
        return False

    def room_was_made(self) -> bool:
        """Return False: there is always room."""
        return False

    def advertise(self, message_type: type[Message], topic: str) -> None:
        """Check the type; there is nobody to tell."""
        check_message_type(message_type, "advertise")
        check_topic(topic)

    def publish(self, message: Message | EncodedMessage, topic: str, latched: bool = False) -> bool:
        """Collect a message."""
        if isinstance(message, EncodedMessage):
            check_type(message.type_name, message.version)
            check_encapsulation(message.type_name, message.data.cast("B"))
        else:
            check_message(message, "publish")
            check_topic(topic)
            if message.is_checked:
                check_well_formed(message)
        if self.stopped:
            raise PublishAfterStop(f"this module published a {message.type_name} after it was stopped")
        actual = self._wiring.actual(message.type_name, topic)
        if isinstance(message, EncodedMessage):
            data = bytes(message.data)
            self.published_encoded.append(PublishedEncoded(*message[:2], data, actual))
        elif isinstance(message, CallsQuestion):
            self._questions.append(message.calls.tolist())
            return True
        else:
            data = self._collect(message, actual)
            latched |= message.is_latched
        name = ChannelName(message.type_name, message.version, actual)
        if latched or name in self.latched:
            self.latched[name] = data
        return True

    def _collect(self, message: Message, topic: str) -> bytes:
        if message.type_name.endswith(
            (REQUEST_SUFFIX, GOAL_SUFFIX)
        ):  # a bridge knows some only by their text
            self.peers.kept.add(message.call)  # type: ignore[attr-defined]
        data = message.encode()
        self.published.append(Published(type(message).decode(data), topic))
        return data

    @contextmanager
    def loan(
        self,
        message_type: type[MessageType],
        topic: str,
        fields: Mapping[str, object],
        latched: bool = False,
    ) -> Iterator[MessageType]:
        """Collect a message that is filled in place."""
        check_message_type(message_type, "loan")
        check_topic(topic)
        plan = lay_out(message_type, fields)
        buffer = bytearray(plan.size)
        whole = np.frombuffer(buffer, np.uint8)
        message = plan.write(whole.data)
        yield message
        message.forget_arrays()
        holds = weakref.ref(whole)
        del whole
        if (held := holds()) is not None and not freeze_named_arrays(held, plan):
            self.copied_loans.add(message_type.type_name)
        self.publish(message_type.decode(bytes(buffer)), topic, latched)

    def wake_after_freed(self, messages: int) -> None:
        """Do nothing: there is always room."""
