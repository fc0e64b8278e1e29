"""Attaches scripts and notebooks to a run.

    import robbie_mp
    from robbie_mp.messages import LaserScan

    with robbie_mp.attach() as run:
        for scan in run.listen(LaserScan):
            print(scan.ranges.min())

A loop in a script may take its time, and a notebook does nothing between two cells. But a tool that leaves
its messages for a second is detached. So a thread of each listener takes them, and copies them into a queue
of this process.
"""

import math
import os
import threading
import time
from collections import deque
from contextlib import closing
from types import TracebackType
from typing import Any, Generic
from weakref import WeakSet, finalize

from typing_extensions import Self

from robbie_mp.attached.tool.message_stream import MessageStream
from robbie_mp.attached.tool.parameters import Parameters
from robbie_mp.attached.tool.tool import LONGEST_WAIT_S, Detached, Received, RunEnded, Tool, attach_again
from robbie_mp.attached.tool.tool_bus import ToolBus
from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.transport.declarations import read_declarations
from robbie_mp.bus.transport.segment import SegmentMissing
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages import Message, MessageError, check_well_formed
from robbie_mp.messages.calls import ReplyType, Request, reply_type
from robbie_mp.module.calls.errors import CallError
from robbie_mp.module.envelope import Envelope, MessageType
from robbie_mp.run.live_runs import choose_run
from robbie_mp.run.run_directory import KnownRun
from robbie_mp.run.supervisor.states import state_name

MAX_WAITING = 100
"""Default limit of the messages that wait for a loop."""
PURPOSE = "script"


class NothingHeard(RobbieError, TimeoutError):
    """No message arrived in time."""


class NotAttached(RobbieError, RuntimeError):
    """A script uses a run after the end of its `with` block, after `close()`, or in a forked process."""


def attach(run: str | None = None) -> "AttachedRun":
    """Attach this program to a running robot, to listen, publish, call, and read and change parameters.

        with robbie_mp.attach() as run:
            scan = run.latest(LaserScan)
            run.publish(String(data="docked"), topic="notes")

    It works in scripts and in notebooks, installs no signal handlers, and needs no event loop. A program may
    attach more than once. The robot does not wait for it.

    Args:
        run: the run, by its profile, its folder, or its id or the beginning of it; by default what the
            environment variable ROBBIE_RUN names, or the run of this workspace, or the only run.

    Raises:
        NoSuchRun: no run, or more than one, matches; the text names them.
        RunNotControlled: the run is just starting, or has just ended.
    """
    return AttachedRun(choose_run(run, "attach(…)"))


class AttachedRun:
    """A run that this program is attached to; see `attach`. Any thread may use it.

    Each loop over `listen`, each call while it waits, and publishing, takes one of the places for tools that
    the profile has (`tools.count`). They become free at the end of the loop, of the `with` block, or of the
    process.

    Attributes:
        run_id: the id of the run.
        parameters: the settings of its modules, by MODULE.SETTING.
    """

    def __init__(self, run: KnownRun):
        self.run_id = run.run_id
        self.parameters = Parameters(run)
        self._run = run
        self._pid = os.getpid()
        self._lock = threading.RLock()
        self._publisher: Tool | None = None
        self._listeners: WeakSet[Listener[Any]] = WeakSet()
        self._is_open = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Detach: end all loops over `listen`. Messages already published are still delivered."""
        if os.getpid() != self._pid:
            return
        with self._lock:
            self._is_open = False
            publisher, self._publisher = self._publisher, None
            if publisher is not None:
                publisher.close()
            for listener in list(self._listeners):
                listener.close()

    def listen(
        self,
        message_type: type[MessageType],
        topic: str = "",
        *,
        timeout_s: float | None = None,
        duration_s: float | None = None,
        max_waiting: int = MAX_WAITING,
    ) -> "Listener[MessageType]":
        """Return an iterator over messages, from now on, until the run ends.

            for scan in run.listen(LaserScan, "laser/front", timeout_s=5):
                ...

            scans = list(run.listen(LaserScan, duration_s=10))

        The messages are copies: you may keep them, and their arrays, for as long as you like. If your loop is
        too slow, the oldest of more than `max_waiting` messages go, and `missed` counts them.

        Args:
            message_type: the class of the messages.
            topic: the topic; '' for all.
            timeout_s: maximum time to wait for each message; None: any.
            duration_s: the loop ends after this time; None: it goes on.
            max_waiting: limit of the messages that wait for the loop.

        Raises:
            NotAttached: `close()` was called.
            ChangedType: the robot has this version of the type with other fields.
            ControlRefused: the profile allows no further tools.
            RunEnded, RunNotControlled: the run has ended, or is just starting.
        """
        self._check_process()
        with self._lock:
            self._check_open()
            listener = Listener(self._run, message_type, topic, timeout_s, duration_s, max_waiting)
            self._listeners.add(listener)
            return listener

    def latest(
        self, message_type: type[MessageType], topic: str = "", *, timeout_s: float | None = 5.0
    ) -> MessageType:
        """Wait for the next message and return it.

        Args:
            message_type: the class of the message.
            topic: the topic; '' for all.
            timeout_s: maximum time to wait; None: any.

        Raises:
            NothingHeard: none arrived in time.
            RunEnded: the run has ended.
            ControlRefused, NotAttached, RunNotControlled: as for `listen`.
        """
        with closing(self.listen(message_type, topic, timeout_s=timeout_s, max_waiting=1)) as listener:
            for message in listener:
                return message
        raise RunEnded(f"run {self.run_id} has ended")

    def publish(self, message: Message, topic: str = "") -> bool:
        """Publish a message to all its subscribers.

        Args:
            message: the message.
            topic: the topic to publish on.

        Returns:
            False if it was refused because this program's memory or ring is full.

        Raises:
            FieldError: a field has the wrong type or shape.
            IllFormed: the message is not well formed.
            MessageTooLarge: the message is larger than a tool's memory.
            ControlRefused, NotAttached, RunEnded, RunNotControlled: as for `listen`.
        """
        self._check_process()
        check_well_formed(message)
        with self._lock:
            self._check_open()
            if self._publisher is None:
                self._publisher = Tool(self._run, f"{PURPOSE}: publish")
                self._publisher.ready()
            try:
                self._publisher.wait(0.0)  # it raises an error if this tool was detached or the run has ended
            except Detached:
                old, self._publisher = self._publisher, attach_again(self._run, f"{PURPOSE}: publish")
                old.close()
                self._publisher.ready()
            return self._publisher.publish(message, topic)

    def call(self, request: Request[ReplyType], *, topic: str = "", timeout_s: float = 5.0) -> ReplyType:
        """Send a request to the module that serves it, and wait for the reply.

            path = run.call(FindPath(x_m=2.0, y_m=1.0))

        Args:
            request: the request.
            topic: the name of the service, if the module gave it one.
            timeout_s: time to wait.

        Returns:
            The reply.

        Raises:
            CallError: there is no reply; its class says why: `NoServer`, `ServerDied`, `CallLost`,
                `CallTimedOut`, `CallRefused` or `CallNotSent`.
            InvalidTimeout: the timeout is not a positive number.
            ControlRefused, NotAttached, RunEnded, RunNotControlled: as for `listen`.
        """
        self._check_process()
        self._check_open()
        replies: list[ReplyType] = []
        errors: list[CallError] = []
        with closing(ToolBus(self._run, f"{PURPOSE}: call {type(request).__name__}")) as bus:
            calls = bus.make_calls()
            calls.client.call(
                request, reply_type(type(request)), replies.append, errors.append, timeout_s, topic
            )
            while not (replies or errors):
                bus.work_for(calls)
        if errors:
            raise errors[0]
        return replies[0]

    @property
    def modules(self) -> dict[str, str]:
        """The states of the run's modules, such as RUNNING, by name.

        Raises:
            RunEnded: the run has ended.
        """
        try:
            with closing(RunObserver(self.run_id)) as observer:
                figures = {module.name: module for module in observer.modules()}
        except SegmentMissing as error:
            raise RunEnded(f"run {self.run_id} has ended") from error
        return {name: state_name(figures[name].state) for name in self.parameters.modules}

    def _check_process(self) -> None:
        """Check before the lock is taken: in a forked process, nobody may ever release it."""
        if os.getpid() != self._pid:
            raise NotAttached(f"process {os.getpid()} was forked; call robbie_mp.attach() in it")

    def _check_open(self) -> None:
        if not self._is_open:
            raise NotAttached(f"run {self.run_id}: this attachment is closed; call robbie_mp.attach() again")


class Listener(Generic[MessageType]):
    """Iterates over messages of a run; see `AttachedRun.listen`. It may also be used in a `with` statement.

    Args:
        run: the run.
        message_type: the class of the messages.
        topic: the topic; '' for all.
        timeout_s: maximum time to wait for each message; None: any.
        duration_s: the iteration ends after this time; None: it goes on.
        max_waiting: limit of the messages that wait.
    """

    def __init__(
        self,
        run: KnownRun,
        message_type: type[MessageType],
        topic: str,
        timeout_s: float | None,
        duration_s: float | None,
        max_waiting: int,
    ):
        self._run = run
        self._type = message_type
        self._topic = topic
        self._timeout_s = timeout_s
        self._last: Received | None = None
        self._damaged = 0
        name = ChannelName(message_type.type_name, message_type.version, topic)
        on_topic = f" on {topic}" if topic else ""
        stream = MessageStream(run, [name], f"{PURPOSE}: listen to {message_type.__name__}{on_topic}")
        try:
            stream.check_class(message_type)
        except BaseException:
            stream.close()
            raise
        self._intake = _Intake(stream, max(1, max_waiting))
        self._end_s = math.inf if duration_s is None else time.monotonic() + duration_s
        # The thread does not refer to this object, so it ends when a notebook has forgotten the loop.
        self._finalizer = finalize(self, self._intake.stop)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the iteration and detach; nothing that still waits is returned."""
        self._finalizer()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> MessageType:
        """Return the next message.

        Raises:
            NothingHeard: none arrived within `timeout_s`; the iteration has ended.
            ControlRefused: this tool was detached, and another one has taken its place.
            NotAttached: this process was forked.
        """
        try:
            return self._next()
        except BaseException:  # also Ctrl-C, after which nobody may ever use this object again
            self.close()
            raise

    def _next(self) -> MessageType:
        until_s = math.inf if self._timeout_s is None else time.monotonic() + self._timeout_s
        while (received := self._intake.take(min(until_s, self._end_s))) is not None:
            try:
                message = self._type.decode(received.data)
            except MessageError:
                self._damaged += 1
                continue
            self._last = received
            return message
        error = self._intake.error
        if error is not None and not isinstance(error, RunEnded):
            raise error
        if self._intake.has_ended or time.monotonic() >= self._end_s:
            raise StopIteration
        raise NothingHeard(f"no {self._type.__name__} within {self._timeout_s:g} s{self._describe()}")

    def _describe(self) -> str:
        """Say who publishes such messages."""
        same = [
            entry
            for entry in read_declarations(self._run.run_id)
            if entry.is_publisher and entry.type_name == self._type.type_name
        ]
        if not same:
            return "; no module publishes it"
        fitting = [entry for entry in same if entry.version == self._type.version]
        if not fitting:
            return f"; the robot has version {same[0].version}, this program version {self._type.version}"
        topics = sorted({entry.topic for entry in fitting})
        if self._topic and self._topic not in topics:
            return f"; nothing is published on topic {self._topic!r}, but on {', '.join(map(repr, topics))}"
        return f"; {', '.join(sorted({entry.module for entry in fitting}))} has published none"

    @property
    def envelope(self) -> Envelope:
        """Topic, sender, sequence and time (ns of the machine's monotonic clock) of the last message.

        Raises:
            LookupError: there was none yet.
        """
        last = self._last
        if last is None:
            raise LookupError("there is an envelope only after the first message")
        return Envelope(last.topic, last.sequence, last.sender, last.published_ns)

    @property
    def missed(self) -> int:
        """Messages that this loop was too slow for, or that came while it was detached; up to 0.2 s old."""
        return self._intake.missed + self._damaged


class _Intake:
    """Takes messages in a thread, and keeps the newest of them until a loop asks for them."""

    def __init__(self, stream: MessageStream, max_waiting: int):
        self._stream = stream
        self._waiting: deque[Received] = deque()
        self._max_waiting = max_waiting
        self._changed = threading.Condition()
        self._pid = os.getpid()
        self._dropped = self._missed = 0
        self.has_ended = False
        self.error: RobbieError | None = None
        """Why no more messages come."""
        self._thread = threading.Thread(target=self._take_all, name="robbie listen", daemon=True)
        self._thread.start()

    @property
    def missed(self) -> int:
        """Messages that were dropped here, or by the core."""
        return self._dropped + self._missed

    def _take_all(self) -> None:
        look_s = 0.0
        try:
            while not self.has_ended:
                received = self._stream.receive()
                if received is not None:
                    self._put(received)
                if time.monotonic() >= look_s:
                    look_s = time.monotonic() + LONGEST_WAIT_S
                    self._missed = self._stream.missed
        except RobbieError as error:
            self.error = error
        finally:
            with self._changed:
                self.has_ended = True
                self._changed.notify_all()
            self._stream.close()

    def _put(self, received: Received) -> None:
        with self._changed:
            self._waiting.append(received)
            if len(self._waiting) > self._max_waiting:
                self._waiting.popleft()
                self._dropped += 1
            self._changed.notify()

    def take(self, until_s: float) -> Received | None:
        """Return the next message; None if there is none by then, or none will come."""
        if os.getpid() != self._pid:
            raise NotAttached(f"process {os.getpid()} was forked; call robbie_mp.attach() in it")
        with self._changed:
            while not self._waiting and not self.has_ended:
                left_s = until_s - time.monotonic()
                if left_s <= 0:
                    return None
                self._changed.wait(min(left_s, threading.TIMEOUT_MAX))
            return self._waiting.popleft() if self._waiting else None

    def stop(self) -> None:
        """Stop the thread, which detaches."""
        if os.getpid() != self._pid:
            return
        with self._changed:
            self.has_ended = True
            self._waiting.clear()
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(10 * LONGEST_WAIT_S)
