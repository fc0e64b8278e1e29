"""The station as a module: the source of what pages show, and their way to the robot."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property
from typing import Any, Protocol

from robbie_mp.messages import Goal, Message
from robbie_mp.module.calls.errors import CallError
from robbie_mp.module.envelope import MessageType
from robbie_mp.module.module import MessageHandling, Module, setting
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.run_clock import RunClock
from robbie_mp.run.run_directory import KnownRun, list_runs
from robbie_mp.station.page.requests import Asked, Asking, Requests
from robbie_mp.station.settings import StationSettings
from robbie_mp.station.watch.latest import Latest
from robbie_mp.station.watch.run import log_source


class Publish(Protocol):
    """The type of `Module.publish`."""

    def __call__(self, message: Message, *, topic: str = "") -> bool:
        """Publish a message from any thread. Return False if it was not possible."""


REPLY_S = 3.0
"""Maximum time that an operator waits for the reply to a request."""


class StationModule(StationSettings, Module):
    """Shares each subscription among all panels, and sends what pages ask for in its own thread."""

    period_s: float = setting(0.05, "time between updates of moving parts", minimum=0.01)

    page_address: str = ""
    """Where browsers on other machines find the page; '' until it is served."""

    @cached_property
    def known_run(self) -> KnownRun:
        """The run that the station is part of."""
        return next(run for run in list_runs() if run.run_id == self.run_id)

    @cached_property
    def log_source(self) -> str:
        """Name of the module that plays a log in this run; '' if the run is of a live robot."""
        return log_source(RunPlan.load(self.known_run.folder))

    @cached_property
    def _log_clock(self) -> RunClock | None:
        return RunClock.attach(self.run_id) if self.log_source else None

    def now_s(self) -> float:
        """Return the time in which ages count: that of the log that plays, or else the monotonic clock."""
        return time.monotonic() if self._log_clock is None else self._log_clock.now_ns() / 1e9

    def setup(self) -> None:
        """Begin without subscriptions and requests."""
        self._requests = Requests(self._send)
        self._newest: dict[tuple[str, str], Latest[Any]] = {}
        self._handlers: dict[tuple[str, str], list[Callable[[Any], None]]] = {}

    def tick(self) -> None:
        """Send the requests that wait."""
        self._requests.tick()

    def subscribe(
        self,
        message_type: type[MessageType],
        handler: Callable[[MessageType], None],
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
        *,
        topic: str = "",
        optional: bool = True,
        deadline_s: float | None = None,
        on_late: Callable[[], None] | None = None,
    ) -> None:
        """Subscribe as every module does, but optionally: panels show what there is."""
        super().subscribe(
            message_type,
            handler,
            handling,
            topic=topic,
            optional=optional,
            deadline_s=deadline_s,
            on_late=on_late,
        )

    def newest(self, message_type: type[MessageType], topic: str = "") -> Latest[MessageType]:
        """Return the holder of the newest message of a type and topic. All panels share it.

        Call it only in the module's thread: in `setup`, constructors of panels, and their ticks.
        """
        key = (message_type.type_name, topic)
        if key not in self._newest:
            self._newest[key] = latest = Latest[MessageType](self.now_s)
            if key in self._handlers:
                self.hear(message_type, latest.put, topic)
                return latest
            self.subscribe(message_type, latest.put, MessageHandling.KEEP_ONLY_NEWEST, topic=topic)
        return self._newest[key]

    def hear(
        self, message_type: type[MessageType], handler: Callable[[MessageType], None], topic: str = ""
    ) -> None:
        """Subscribe to every message of a type and topic. Call this before `newest` of the same type.

        Call it in the module's thread, which also runs the handler.
        """
        key = (message_type.type_name, topic)
        if key not in self._handlers:
            handlers: list[Callable[[MessageType], None]] = []
            self._handlers[key] = handlers

            def handle(message: MessageType) -> None:
                for one in handlers:
                    one(message)

            self.subscribe(message_type, handle, topic=topic)
        self._handlers[key].append(handler)

    def ask(self, message: Asking, what: str, topic: str = "", within_s: float | None = None) -> Asked:
        """Send a request or a goal from any thread; see `Page.ask`.

        Args:
            message: the request or goal.
            what: a name for it in texts.
            topic: name of the service, if several modules serve the same type.
            within_s: it is not sent later than this; None: however late.
        """
        return self._requests.ask(message, what, topic, within_s)

    def _send(self, message: Asking, on_end: Callable[[Message | CallError], None], topic: str) -> None:
        if isinstance(message, Goal):
            self.send_goal(message, on_end, on_end, topic=topic)
        else:
            self.call(message, on_end, on_end, timeout_s=REPLY_S, topic=topic)
