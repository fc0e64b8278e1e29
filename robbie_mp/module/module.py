"""The base class of every module."""

import logging
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar, cast

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import replacing
from robbie_mp.base.state_machine import StateMachine
from robbie_mp.bus.checkpoint.keeper import Checkpoints
from robbie_mp.bus.transport.records import MessageHandling
from robbie_mp.messages.calls import (
    Action,
    FeedbackType,
    Goal,
    ReplyType,
    Request,
    ResultType,
    Service,
    goal_types,
    reply_type,
)
from robbie_mp.messages.message import Message
from robbie_mp.messages.refusals import Refusals
from robbie_mp.messages.stock.builtin_interfaces import Time
from robbie_mp.messages.stock.std_msgs import Header
from robbie_mp.module.bus import Bus
from robbie_mp.module.calls.calls import Calls
from robbie_mp.module.calls.client import SentGoal
from robbie_mp.module.calls.errors import CallError
from robbie_mp.module.calls.server import ActiveGoal
from robbie_mp.module.clock import Clock, is_span
from robbie_mp.module.deadlines import check_deadline
from robbie_mp.module.envelope import EncodedMessage, Envelope, MessageType
from robbie_mp.module.handlers import check_handler
from robbie_mp.module.health import Health
from robbie_mp.module.settings import apply_settings, setting
from robbie_mp.module.timers import Timer

if TYPE_CHECKING:
    from robbie_mp.messages.descriptions import TypeDescription

RequestType = TypeVar("RequestType", bound=Message)
GoalType = TypeVar("GoalType", bound=Message)

__all__ = ["MessageHandling", "Module", "ModuleContext", "setting"]


def _text_of(reason: object) -> str:
    """Return a reason that is no text as a text; '' if it is None or False."""
    return "" if reason is None or reason is False else str(reason)


class InvalidPeriod(RobbieError, ValueError):
    """A module's `period_s` cannot be used.

    Example scenarios:
      - it is 0, negative, longer than 30 years, or no number
      - the module has a `tick()`, but nothing sets `period_s`, so `tick()` would never run
    """


class ResultNotWritten(RobbieError, OSError):
    """A module cannot write a file into the folder for results.

    Example scenarios:
      - the disk is full
      - there is a folder of the file's name
      - the folder for results was removed during the run
    """


@dataclass(frozen=True)
class ModuleContext:
    """Everything a module gets from the robot it is part of."""

    name: str
    settings: dict[str, object]
    bus: Bus
    clock: Clock
    checkpoints: Checkpoints
    output_directory: Path
    show_status: Callable[[str], None]
    show_states: Callable[[str], None] = lambda _line: None
    show_health: Callable[[str], None] = lambda _line: None
    run_id: str = ""
    """The run that the module is part of; '' in a test."""
    wake: Callable[[], None] = lambda: None
    """Ends the module's wait for messages; any thread may call it."""


class Module:
    """Thin glue between messages and a device or worker.

    A passive module is woken by the messages it subscribes to. An active module is also woken every
    `period_s` to run `tick()`. Handlers and ticks run one after the other in one thread, and they may take
    their time: only this module waits. An exception that leaves a handler ends the process, and the
    supervisor starts it again.

        class Obstacles(Module):
            stop_distance_m: float = setting(0.4, "obstacles nearer than this stop the robot")

            def setup(self) -> None:
                self.subscribe(LaserScan, self.on_scan, MessageHandling.KEEP_ONLY_NEWEST)

            def on_scan(self, scan: LaserScan) -> None:
                if scan.ranges.min() < self.stop_distance_m:
                    self.publish(DriveCommand())
    """

    period_s: Any = None  # a float, or None; were it said here, no subclass could declare it as float only
    """Time between ticks, in s; None for a passive module.

    A class that defines `tick` must set it. Write `period_s = None` if the ticks begin later, when a handler
    sets it.
    """
    patience_s: float = 0.0
    """How long messages may wait, in s, so that this module takes many of them in one go.

    A module that records or sums up should set it: the system then does less work for each message. On an
    ordered stop the module still handles everything that was published before. In lockstep it has no effect.
    """
    nice = 0
    """The nice value of the module's process, 0 to 19, unless the profile sets another one.

    Set it above 0 for long computations, so that other modules never wait for the processor. When all
    processors are busy, a module with 10 gets about a tenth of the time of a module with 0.
    """
    slice_ms: float | None = None
    """The time slice of its threads, 0.1 to 100 ms, unless the profile sets another one; None: the usual one.

    With a longer slice than others it gets as much time as without, but other modules that wake up interrupt
    it at once. Set it to 100 if the module moves much data and must be prompt, too.
    """
    handler_deadline_s: float | None = None
    """How long a handler or tick may take before it counts as hung, unless the profile says it; None: 10 s.

    Set it to less for a module that others wait for and whose handlers are short, such as a bridge.
    """
    ticks_wait = False
    """Whether its ticks wait, such as for a device. Then it is not DEGRADED when it misses ticks."""
    follows_run_clock = True
    """Whether `clock` and ticks follow the run's time while a log is played or a simulation runs.

    Set it to False for a module that serves people or disks rather than the robot: it follows the machine's
    clock.
    """

    def __init__(self, context: ModuleContext):
        self.name = context.name
        self.clock = context.clock
        self.output_directory = context.output_directory
        self.restored: Any = context.checkpoints.restored
        """The state last given to `checkpoint`, with copies of its arrays; None on a fresh start."""
        self.checkpoint_lost = context.checkpoints.lost > 0
        """Whether newer state than `restored` was damaged. Then do not rely on it for what must be safe."""
        self.log = logging.getLogger(context.name)
        self.stop_requested = False
        self._bus = context.bus
        self._checkpoints = context.checkpoints
        self._health = Health(self.log.warning, context.show_health)
        self._calls = Calls(context.bus, context.clock, self.log, self._health)
        self.run_id = context.run_id
        self._show_status = context.show_status
        self._status = self._degraded = ""
        self._show_states = context.show_states
        self._states: dict[str, str] = {}
        self._wake = context.wake
        self._is_tick_awaited = False
        apply_settings(self, context.settings)

    # -- for authors to define -------------------------------------------------------------------------

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check the settings beyond their types and limits, before any process starts.

        Args:
            settings: the value of every setting, already checked against its declaration.

        Raises:
            SettingError: the settings cannot be used.
        """

    @classmethod
    def further_types(
        cls, settings: dict[str, object], others: Collection[str]
    ) -> "Iterable[TypeDescription]":
        """Describe the message types that this module publishes without having a class for them.

        Tools that attach to the run need these descriptions. Called after `check`, with the same settings.
        Types that have a class are known already.

        Args:
            settings: the value of every setting, already checked.
            others: names of the profile's other modules.

        Returns:
            One description for each type.

        Raises:
            SettingError: the module could not publish these types.
        """
        return ()

    def setup(self) -> None:
        """Open devices, create workers, subscribe. Runs once in each process, before the first message.

        Do not publish here: other modules may not have subscribed yet. Publish from the first tick on.
        """

    def tick(self) -> None:
        """Do the module's periodic work; called every `period_s`."""

    def setting_changed(self, name: str) -> None:
        """Apply a setting that has just been changed; its attribute already has the new, checked value.

        Settings declared with `changeable=True` can be changed while the module runs, with `robbie param
        set`. This method is called between two messages or ticks. If you read the attribute each time you
        need it, you need not define this method.

        Args:
            name: the setting.

        Raises:
            SettingError: the new value cannot be used. The attribute gets its old value back, and the error
                is shown to the user who asked for the change.
        """

    def teardown(self) -> None:
        """Write results and close devices. Runs on an ordered stop, but not after a crash."""

    # -- for authors to use ----------------------------------------------------------------------------

    def subscribe(
        self,
        message_type: type[MessageType],
        handler: Callable[[MessageType], None],
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
        *,
        topic: str = "",
        optional: bool = False,
        deadline_s: float | None = None,
        on_late: Callable[[], None] | None = None,
    ) -> None:
        """Subscribe to the messages of a type.

        `robbie run` and `robbie top` warn if no module has published such a message, or has announced it with
        `advertise`, 10 s after this module has started.

        Give a deadline to input that must keep coming, such as what the robot sees while it drives:

            self.subscribe(LaserScan, self.on_scan, deadline_s=0.3, on_late=self.stop_driving)

        If the newest message that has come was published longer ago, or none has come since all modules were
        ready, the module is DEGRADED: that is logged, and `robbie top` shows it, until a message comes in
        time. How often this happened, and the longest age, are counted. A message costs no more with a
        deadline. In lockstep, the deadline is looked at with each tick.

        Args:
            message_type: the class of the messages.
            handler: called with each message, in the order of publishing.
            handling: what to do when messages come faster than they are handled.
            topic: the topic to subscribe to; '' for all topics.
            optional: whether the module works without these messages; then nobody is warned, and a deadline
                begins with the first message.
            deadline_s: longest age of the newest message, by the module's clock, in s; None: any.
            on_late: called once when it is exceeded, and again only after a message has come in time. It runs
                between two messages or ticks, and may do all that they may.

        Raises:
            NotAMessage: `message_type` is not a class of messages.
            InvalidHandler: `handler` cannot be called with a message, or is `async`.
            InvalidTopic: the topic's name has characters that not everything carries.
            InvalidDeadline: `deadline_s` is not a positive time, or there is only an `on_late`.
            SubscribedTwice: the module has already subscribed to this type and topic.
            TooManyDeclarations: the module subscribes and publishes too much.
        """
        check_deadline(deadline_s, on_late)
        if on_late is not None:
            check_handler("subscribe", on_late)
        subscriptions = self._bus.subscriptions
        name = subscriptions.subscribe(message_type, handler, handling, topic, optional=optional)
        if deadline_s is not None:
            what = message_type.__name__ + (f" on topic '{topic}'" if topic else "")
            self._calls.deadlines.add(name, what, deadline_s, on_late, is_optional=optional)

    def subscribe_encoded(
        self,
        type_pattern: str,
        handler: Callable[[EncodedMessage], None],
        *,
        topic: str = "*",
        version: int | None = None,
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
    ) -> None:
        """Subscribe to messages of any type as encoded bytes, to record them or to send them on.

            self.subscribe_encoded("sensor_msgs/msg/*", self.on_message)

        Patterns are shell patterns (`*`, `?`, `[…]`; case matters) for the whole name. The core matches them
        once for each new pair of type and topic, so further patterns cost nothing per message, and you do
        not miss the first message of a new pair. If several patterns of this module match a message, only
        the handler of the pattern subscribed to first gets it. You get every version of a type, and every
        message, up to the limits of this module's queue.

        With `version`, you get one version of one type, and no patterns are looked at. So there may be many
        such subscriptions, and only the newest message may be wanted:

            self.subscribe_encoded(
                Image.type_name, self.on_image, topic="front", version=Image.version,
                handling=MessageHandling.KEEP_ONLY_NEWEST,
            )

        Args:
            type_pattern: pattern for the full name of the type, such as "sensor_msgs/msg/LaserScan"; with
                `version`, the full name itself.
            handler: called with each message, in the order of publishing.
            topic: pattern for the topic; "" matches only messages without a topic. With `version`, the topic
                itself, and "" for all topics, as for `subscribe`.
            version: version of the type; None: every version of every type that matches.
            handling: what to do when messages come faster than they are handled; only with `version`.

        Raises:
            SubscribedTwice: the module has already subscribed with the same patterns.
            EmptyPattern: the pattern for the type is empty.
            TooManyDeclarations: the module has more than 32 patterns.
            NameTooLong: a pattern has more than 96 bytes.
        """
        if version is None:
            self._bus.subscriptions.subscribe_encoded(type_pattern, handler, topic)
        else:
            self._bus.subscriptions.subscribe_encoded(type_pattern, handler, topic, version, handling)

    def publish_encoded(
        self,
        type_name: str,
        version: int,
        data: bytes | bytearray | memoryview,
        *,
        topic: str = "",
        latched: bool = False,
    ) -> bool:
        """Publish an encoded message, such as one from a log; its type needs no class in this program.

        Only the encapsulation is checked. A damaged field is found by the subscriber that decodes it.

        Args:
            type_name: full name of the message's type.
            version: version of that type.
            data: the encoded message (XCDR1, little endian) with its 4 bytes of encapsulation; it is copied.
            topic: the topic to publish on.
            latched: as for `publish`.

        Returns:
            False if the message was refused, as for `publish`.

        Raises:
            DecodeError: the bytes do not encode a message.
            DeclarationError, VersionError: a type cannot have this name or version.
            MessageTooLarge, PublishAfterStop: as for `publish`.
        """
        return self._bus.publish(EncodedMessage(type_name, version, memoryview(data)), topic, latched)

    def now(self) -> Time:
        """Return the run's time as a stamp: `Header(stamp=self.now(), frame_id="laser")`."""
        return Time.from_nanoseconds(self.clock.now_ns())

    def monotonic_s(self) -> float:
        """Return the run's monotonic time in s, to measure how long something takes. It never goes back."""
        return self.clock.monotonic_ns() / 1e9

    def header(self, frame_id: str = "") -> Header:
        """Return a header with the run's time: `LaserScan(header=self.header("laser"), …)`.

        Args:
            frame_id: the frame of what the message holds.
        """
        return Header(stamp=self.now(), frame_id=frame_id)

    def every(self, period_s: float, action: Callable[[], object]) -> Timer:
        """Call a function periodically, as `tick()` is called every `period_s`; there may be several.

            def setup(self) -> None:
                self.every(0.02, self.steer)
                self.every(1.0, self.report)

        The first call comes when all modules are ready, or at once if they are. It runs between two messages
        or ticks, in the same thread. Calls that were missed altogether are skipped. `robbie top` counts calls
        as ticks. In lockstep, calls come exactly in their periods if these have a common divisor of at least
        a tenth of the shortest one; otherwise they are late by at most that tenth.

        Args:
            period_s: time between two calls by the module's clock, in s.
            action: what to call, without arguments.

        Returns:
            The timer; its `stop()` ends the calls.

        Raises:
            InvalidTimer: the period is not a positive time.
            InvalidHandler: there is no function, or it needs arguments, or is `async`.
            WrongThread: this is not the module's main thread.
        """
        self._calls.check_thread()
        return self._calls.timers.add(period_s, action)

    def advertise(self, message_type: type[Message], *, topic: str = "") -> None:
        """Announce that this module may publish messages of a type, before it publishes the first.

        Call this in `setup()` for messages that come rarely, such as alarms. Their subscribers then count as
        connected, and `robbie list topics` shows the topic from the start. For other messages it is not
        needed.

            self.advertise(EmergencyStop, topic="emergency_stop")

        Args:
            message_type: the class of the messages.
            topic: the topic they will be published on.

        Raises:
            NotAMessage: `message_type` is not a class of messages.
            TooManyDeclarations: the module subscribes and publishes too much.
        """
        self._bus.advertise(message_type, topic)

    def publish(self, message: Message, *, topic: str = "", latched: bool = False) -> bool:
        """Publish a message to all its subscribers.

        A latched topic is for what rarely changes and every later subscriber needs, such as a map:

            self.publish(OccupancyGrid(...), topic="map", latched=True)

        The core keeps the newest message of a latched topic. A module that starts or restarts later gets it
        first, even if the publisher has died since. Publish again only when something has changed.

        Args:
            message: the message; later changes to it do not reach the subscribers.
            topic: the topic to publish on.
            latched: make the topic latched for this type; it stays so. With a type that is declared with
                `latched=True`, every topic is.

        Returns:
            False if the message was refused because this module's memory or ring is full. (The core may
            refuse it later, when its tables are full.) Refused messages are counted, and `robbie top` shows
            them.

        Raises:
            NotAMessage: `message` is not a message, but for example a dict.
            InvalidTopic: as for `subscribe`.
            FieldError: a field has the wrong type or shape.
            IllFormed: the message moves something, and is not well formed; see `Message.flaw`.
            MessageTooLarge: the message is larger than this module's memory.
            PublishAfterStop: the module has already been stopped.
        """
        return self._bus.publish(message, topic, latched)

    def loan(
        self, message_type: type[MessageType], *, topic: str = "", latched: bool = False, **fields: object
    ) -> AbstractContextManager[MessageType]:
        """Write a message directly into shared memory; it is published at the end of the `with` block.

        Give the value of every field. For an array that you fill in place, give the number of its elements:

            with self.loan(Image, height=480, width=640, encoding="mono8", step=640, data=480 * 640) as image:
                camera.read_into(image.data)

        If the block raises an exception, the message is not published. You may give arrays names, as in
        `pixels = image.data.reshape(480, 640)`: after the block they can only be read. If your code keeps an
        array anywhere else, the message is copied and a warning is logged.

        Args:
            message_type: the class of the message.
            topic: the topic to publish on.
            latched: as for `publish`.
            fields: the values of the fields; for an array to be filled in place, its number of elements.

        Raises:
            MessageTooLarge, PublishAfterStop, FieldError, NotAMessage: as for `publish`.
        """
        return self._bus.loan(message_type, topic, fields, latched)

    def serve(
        self,
        request_type: Service[RequestType, ReplyType],
        handler: Callable[[RequestType], ReplyType],
        *,
        topic: str = "",
    ) -> None:
        """Serve requests: the handler's reply goes to the module that called. Call this in `setup()`.

            class Planner(Module):
                def setup(self) -> None:
                    self.serve(FindPath, self.on_find_path)

                def on_find_path(self, request: FindPath) -> FoundPath:
                    if not self.is_free(request.x_m, request.y_m):
                        raise CallRefused("the goal is inside a wall")
                    return FoundPath(length_m=self.plan(request.x_m, request.y_m))

        The handler gets each request at most once, whatever is killed. It runs like any other handler, so
        this module waits for it. Any other exception than `CallRefused` ends the process as usual; the client
        gets `ServerDied`.

        Args:
            request_type: the class of the requests; it names the class of the replies.
            handler: gets a request and returns the reply.
            topic: the name of this service, if several modules serve the same type.

        Raises:
            InvalidHandler: `handler` cannot be called with a request, or is `async`.
            ServedTwice: this module already serves this type and topic. If another module does, the one that
                is started later ends with this error when all modules are ready.
            DeclarationError: the class of the requests does not name a class of replies.
            CannotServe: this module runs as a tool.
        """
        self._calls.check_thread()
        check_handler("serve", handler, f"request: {getattr(request_type, '__name__', request_type)}")
        self._calls.server.serve(cast("type[Request[Any]]", request_type), handler, topic)

    def call(
        self,
        request: Request[ReplyType],
        on_reply: Callable[[ReplyType], None],
        on_error: Callable[[CallError], None] | None = None,
        *,
        timeout_s: float = 5.0,
        topic: str = "",
    ) -> None:
        """Send a request to the module that serves it, and return at once; the reply comes later.

            self.call(FindPath(x_m=2.0, y_m=1.0), self.on_path, self.on_no_path)

        Exactly one of the two functions is called, exactly once, after this handler or tick has returned,
        whatever is killed meanwhile. Only if this module itself is stopped or killed, neither is.

        Args:
            request: the request; what the server returns for it is the reply.
            on_reply: called with the reply.
            on_error: called with the error instead: `NoServer`, `ServerDied`, `CallLost`, `CallTimedOut`,
                `CallRefused` or `CallNotSent`. By default the error is logged.
            timeout_s: time on the module's clock after which the call ends with `CallTimedOut`.
            topic: the name of the service, as given to `serve`.

        Raises:
            TooManyCalls: 1000 calls of this module have not ended.
            InvalidTimeout: the timeout is not a positive number.
            WrongThread: this is not the module's main thread.
            CalledInSetup: not every module is ready; call from the first message or tick on.
            FieldError, MessageTooLarge, PublishAfterStop: as for `publish`.
        """
        self._calls.check_begun()
        self._calls.client.call(request, reply_type(type(request)), on_reply, on_error, timeout_s, topic)

    def serve_goals(
        self,
        goal_type: Action[GoalType, FeedbackType, ResultType],
        on_goal: Callable[[ActiveGoal[GoalType, FeedbackType, ResultType]], None],
        on_cancel: Callable[[ActiveGoal[GoalType, FeedbackType, ResultType], str], None] | None = None,
        *,
        topic: str = "",
    ) -> None:
        """Serve goals: work that takes longer than a handler may. Call this in `setup()`.

            class Wheels(Module):
                period_s = 0.1

                def setup(self) -> None:
                    self.active: ActiveGoal[DriveTo, Driven, Arrived] | None = None
                    self.serve_goals(DriveTo, self.on_goal)

                def on_goal(self, active: ActiveGoal[DriveTo, Driven, Arrived]) -> None:
                    if self.active is not None and self.active.is_active:
                        raise CallRefused("one goal at a time")
                    self.active = active

                def tick(self) -> None:
                    if self.active is not None and self.active.is_active:
                        self.active.feedback(Driven(left_m=self.left_m()))
                        if self.left_m() < 0.1:
                            self.active.succeed(Arrived())

        Keep the `ActiveGoal`, and end it sooner or later. If this module dies meanwhile, its clients get
        `ServerDied`, unless the next process continues the goal with `resume_goal`.

        Args:
            goal_type: the class of the goals; it names the classes of feedback and result.
            on_goal: gets each goal; it refuses the goal by raising `CallRefused`, or accepts it by returning.
            on_cancel: gets a goal that its client cancels, and the client's reason; it ends the goal now or
                later. By default the goal ends at once.
            topic: as for `serve`.

        Raises:
            InvalidHandler, ServedTwice, DeclarationError, CannotServe: as for `serve`.
        """
        self._calls.check_thread()
        check_handler("serve_goals", on_goal, "active: ActiveGoal")
        if on_cancel is not None:
            check_handler("serve_goals", on_cancel, "active: ActiveGoal", "reason: str")
        self._calls.server.serve_goals(cast("type[Goal[Any, Any]]", goal_type), on_goal, on_cancel, topic)

    def resume_goal(
        self, goal_type: Action[GoalType, FeedbackType, ResultType], memory: dict[str, Any]
    ) -> ActiveGoal[GoalType, FeedbackType, ResultType]:
        """Continue a goal that an earlier process of this module had accepted. Call this in `setup()`.

        Its client notices nothing of the restart.

        Args:
            goal_type: the class of the goal.
            memory: `ActiveGoal.memory`, from a checkpoint.
        """
        self._calls.check_thread()
        return self._calls.server.resume(cast("type[Goal[Any, Any]]", goal_type), memory)

    def send_goal(
        self,
        goal: Goal[FeedbackType, ResultType],
        on_result: Callable[[ResultType], None],
        on_error: Callable[[CallError], None] | None = None,
        on_feedback: Callable[[FeedbackType], None] | None = None,
        *,
        timeout_s: float | None = None,
        topic: str = "",
    ) -> SentGoal:
        """Send a goal to the module that serves it, and return at once.

            self.goal = self.send_goal(DriveTo(x_m=2.0, y_m=1.0), self.on_arrived, self.on_not_arrived)

        Exactly one of `on_result` and `on_error` is called, exactly once, as for `call`.

        Args:
            goal: the goal.
            on_result: called with the result if the goal is reached.
            on_error: called with the error instead: one of those of `call`, or `GoalCancelled`, `GoalAborted`
                or `GoalPreempted`. By default the error is logged.
            on_feedback: called with each feedback until then.
            timeout_s: time after which the goal is cancelled and ends with `CallTimedOut`; None: any.
            topic: the name of the service, as given to `serve_goals`.

        Returns:
            What you need to cancel the goal.

        Raises:
            TooManyCalls, InvalidTimeout, WrongThread, CalledInSetup: as for `call`.
            FieldError, MessageTooLarge, PublishAfterStop: as for `call`.
        """
        self._calls.check_begun()
        feedbacks, results = goal_types(type(goal))
        client, feed = self._calls.client, on_feedback or _ignore
        number = client.call(goal, results, on_result, on_error, timeout_s, topic, feedbacks, feed)
        return SentGoal(client, number)

    def checkpoint(self, state: object) -> bool:
        """Save state outside this process: after a crash the next process finds it in `restored`.

        Each checkpoint replaces the last one as soon as it is complete. Everything between the last
        checkpoint and a crash is lost: messages handled in that time are not delivered again. A checkpoint
        copies every array once, so its cost grows with the size of the state.

        Args:
            state: None, bool, int, float, str, bytes, numpy arrays and numbers, in lists, tuples and dicts.

        Returns:
            False if there is not enough memory; the last checkpoint stays, and a warning is logged.

        Raises:
            UnsupportedState: the state contains anything else.
            CheckpointTooLarge: the state is larger than the profile's `memory.checkpoint_bytes`.
        """
        return self._checkpoints.save(state)

    @contextmanager
    def result_file(self, name: str | Path) -> Iterator[BinaryIO]:
        """Yield a new file, which at the end takes the place of a file or link in the folder for results.

        Other users cannot read it. If it does not get complete, the earlier file stays.

        Args:
            name: its name in `output_directory`.

        Raises:
            ResultNotWritten: the system does not let it be written.
        """
        path = self.output_directory / name
        try:
            with replacing(path) as file:
                yield file
        except OSError as error:
            raise ResultNotWritten(f"cannot write the result {path}: {error.strerror or error}") from error

    def write_result(self, name: str, content: str | bytes) -> None:
        """Write a file into the folder for results, as `result_file` does.

        Args:
            name: its name in `output_directory`.
            content: what it will hold.

        Raises:
            ResultNotWritten: the system does not let it be written.
        """
        with self.result_file(name) as file:
            file.write(content.encode() if isinstance(content, str) else content)

    @property
    def incarnation(self) -> int:
        """Number of this module's process in the run, from 1: what that one restores is of an earlier run."""
        return self._bus.peers.incarnation

    @property
    def envelope(self) -> Envelope:
        """Topic, sender, sequence and time of the message being handled.

        Raises:
            LookupError: no message is being handled.
        """
        return self._bus.envelope()

    @property
    def ill_formed(self) -> Refusals:
        """The ill-formed messages that this module has refused; `robbie top` shows how many.

        No handler gets an ill-formed message. A module that lets messages of others in asks `admits` before
        it publishes them.
        """
        return self._bus.subscriptions.refusals

    @property
    def outstanding(self) -> int:
        """Number of this module's messages that subscribers still wait for or hold; slow down as it grows.

        The core keeps the newest message of each latched topic, which counts, too.
        """
        return self._bus.outstanding

    def wake_after_freed(self, messages: int) -> None:
        """Run `tick()` early, as soon as a number of outstanding messages have been released.

        Args:
            messages: how many.
        """
        self._bus.wake_after_freed(messages)

    def tick_soon(self) -> None:
        """Run `tick()` as soon as this module has nothing else to do; any thread may call this.

        A thread that waits for a device or a network hands over what has come, and then calls this:

            def on_packet(self, packet: bytes) -> None:  # in another thread
                self.packets.append(packet)
                self.tick_soon()

        The module needs a `period_s`. In lockstep and in a `ModuleHarness`, this has no effect.
        """
        self._is_tick_awaited = True
        self._wake()

    @property
    def status(self) -> str:
        """One line on how the module is doing, shown by `robbie top`; at most 256 bytes of UTF-8.

        What is no text, such as a number, is shown as `str` makes it: no robot falls over a status.
        """
        return self._status

    @status.setter
    def status(self, line: str) -> None:
        line = str(line)
        if line != self._status:
            self._status = line
            self._show_status(line)

    @property
    def degraded(self) -> str:
        """Why this module runs but cannot do its work, such as "the laser is unplugged"; '' if it can.

        As long as it is set, `robbie run`, `robbie top` and the operator's page show the module as DEGRADED,
        with this reason. The log gets one line when that begins and one when it ends, however often you set
        it:

            self.degraded = "" if self.arm.answers else "the arm does not answer"
        """
        return self._degraded

    @degraded.setter
    def degraded(self, reason: str) -> None:
        reason = reason if isinstance(reason, str) else _text_of(reason)
        if reason != self._degraded:
            self._degraded = reason
            self._health.degrade("itself", reason) if reason else self._health.recover("itself")

    def show_state(self, state: object, machine: str = "") -> None:
        """Show the state of a state machine in `robbie top`, beside the status.

        Args:
            state: the state, such as "DRIVE", or a member of an Enum, whose name is shown.
            machine: the name of the state machine, if the module has several.
        """
        name = state.name if isinstance(state, Enum) else str(state)
        if self._states.get(machine) != name:
            self._states[machine] = name
            self._show_states(
                ", ".join(f"{key}: {value}" if key else value for key, value in self._states.items())
            )

    def show_first_states(self) -> None:
        """Show the state of a machine that shows its states, and has not changed it yet; after `setup()`."""
        machines = [one for one in vars(self).values() if isinstance(one, StateMachine)]
        for machine in [] if self._states else machines:
            if machine.on_change == self.show_state:
                self.show_state(machine.state)

    def stop(self) -> None:
        """Stop this module in good order, after the handler or tick that calls this returns."""
        self.stop_requested = True


def period_flaw(cls: type, period_s: object) -> str:
    """Return what to write in place of a time between ticks that is none."""
    return (
        f"{cls.__name__}.period_s is {period_s!r}; it must be greater than 0, at most 1e9, in s, or "
        "None for a module that only reacts to messages"
    )


def tick_without_period(cls: type) -> str:
    """Return what to write in a class with a `tick()` that nothing calls."""
    return (
        f"{cls.__name__} has a tick(), but nothing sets period_s, so tick() would never run; "
        "write `period_s = 0.1` in the class for ten ticks per second, or `period_s = None` if a handler "
        "sets it later"
    )


def check_period(module: Module) -> None:
    """Check `period_s` after `setup()`.

    Raises:
        InvalidPeriod: it is no positive time, or the module has a `tick()` and no class sets a period.
    """
    cls = type(module)
    period_s = module.period_s
    if period_s is not None and not is_span(period_s):
        raise InvalidPeriod(period_flaw(cls, period_s))
    own = [module, *(base for base in cls.__mro__ if base is not Module)]
    is_set = any("period_s" in vars(one) for one in own if one is not object)
    if cls.tick is not Module.tick and not is_set:
        raise InvalidPeriod(tick_without_period(cls))


def _ignore(_feedback: object) -> None:
    """Do nothing with feedback."""


def tick_is_awaited(module: Module) -> bool:
    """Whether a module has called `tick_soon` since this was last asked, for the loop that runs it."""
    is_awaited, module._is_tick_awaited = module._is_tick_awaited, False
    return is_awaited


def health_of(module: Module) -> Health:
    """Return a module's health, for what runs it."""
    return module._health


def calls_of(module: Module) -> Calls:
    """Return a module's calls and services, for the loop that runs it."""
    return module._calls
