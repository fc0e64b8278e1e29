"""A separate connection of the page for the emergency stop, so that nothing else on the page can delay it.

The page sends a question several times a second. Each answer repeats the page's time of its last question. So
the page knows the maximum age of what it shows, even on a slow link. From the robot's time in the answer it
knows how far the robot's clock is ahead of its own. The page names a press in each question until an answer
says that the press is settled.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from starlette.types import Receive, Scope, Send

from robbie_mp.station.stop.requests import MAX_NAME_LENGTH
from robbie_mp.station.web.gate import STOP_PATH
from robbie_mp.station.web.page_json import from_page

if TYPE_CHECKING:
    from robbie_mp.messages import EmergencyStop
    from robbie_mp.station.fleet.stop_all import StopAll
    from robbie_mp.station.stop.requests import StopRequests
    from robbie_mp.station.watch.latest import Latest
    from robbie_mp.station.web.gate import App


MAX_SETTLED = 64
"""Maximum number of robots that a question names."""


@dataclass(frozen=True)
class Question:
    """A page's request."""

    asked_ms: float
    """Time of the question on the page's own clock."""
    press: str
    """Name of a press that, as far as the page knows, is not settled; '' if there is none."""
    press_all: str = ""
    """The same of a press that stops all robots of the team."""
    settled: tuple[str, ...] = ()
    """The robots that have confirmed that press, as far as the page knows."""


def question_of(text: object) -> Question | None:
    """Return a page's question, or None if it is malformed."""
    try:
        sent: Any = from_page(text) if isinstance(text, str) else None
        asked_ms, press = float(sent["asked_ms"]), sent["press"]
        press_all, settled = sent.get("press_all", ""), sent.get("settled", [])
    except (AttributeError, KeyError, TypeError, ValueError):
        return None
    if not isinstance(settled, list) or len(settled) > MAX_SETTLED:
        return None
    names = (press, press_all, *settled)
    if not math.isfinite(asked_ms) or not all(
        isinstance(one, str) and len(one) <= MAX_NAME_LENGTH for one in names
    ):
        return None
    return Question(asked_ms, press, press_all, tuple(settled))


class StopService:
    """Answers the connections of all pages.

    Args:
        requests: passes presses on to the base.
        state: the newest report of the base.
        age_s: returns how old that is, s; None before the first.
        is_of_log: returns whether that report comes from a log, so that no base listens here.

    Attributes:
        team: passes presses on to all robots; None if this robot has no team.
    """

    def __init__(
        self,
        requests: StopRequests,
        state: Latest[EmergencyStop],
        age_s: Callable[[], float | None],
        is_of_log: Callable[[], bool] = lambda: False,
    ):
        self._requests = requests
        self._age_s, self._is_of_log = age_s, is_of_log
        self._state = state
        self._ends = False
        self.team: StopAll | None = None

    def end(self) -> None:
        """Tell all pages that the station ends cleanly, as it does at the end of a run."""
        self._ends = True
        self._requests.tell()

    def beside(self, app: App) -> App:
        """Return an application that serves these connections, and passes other requests to another one."""

        async def answer(scope: Scope, receive: Receive, send: Send) -> None:
            if scope["type"] == "websocket" and scope["path"] == STOP_PATH:
                await _Connection(self, receive, send).serve()
            else:
                await app(scope, receive, send)

        return answer

    def take(self, question: Question) -> None:
        """Stop the robot, or all robots, if a page asks for that."""
        if question.press:
            self._requests.press(question.press)
        if question.press_all and self.team is not None:
            self.team.press(question.press_all, question.settled)

    def answer(self, question: Question) -> str:
        """Return the answer to a page, as JSON."""
        state = self._state.message
        fate = self._requests.fate(question.press)
        return json.dumps(
            {
                "asked_ms": question.asked_ms,
                "press": question.press if fate else "",
                "fate": fate or "",
                "waits_s": self._requests.waits_s,
                "engaged": None if state is None else state.engaged,
                "reason": "" if state is None else state.reason,
                "age_s": self._age_s(),
                "is_of_log": self._is_of_log(),
                "now_s": time.monotonic(),
                "ends": self._ends,
                "press_all": question.press_all,
                "robots": None if self.team is None else self.team.states(question.press_all),
            }
        )

    async def changes(self, changed: asyncio.Event) -> None:
        """Until cancelled, set an event whenever a page should get an answer before its next question."""
        loop = asyncio.get_running_loop()
        engaged: bool | None = None

        def wake() -> None:
            with contextlib.suppress(RuntimeError):  # the page server has just ended
                loop.call_soon_threadsafe(changed.set)

        def look(state: EmergencyStop) -> None:
            nonlocal engaged
            if state.engaged is not engaged:
                engaged = state.engaged
                wake()

        self._requests.listen(wake)
        self._state.listen(look)
        try:
            await loop.create_future()
        finally:
            self._requests.ignore(wake)
            self._state.ignore(look)


class _Connection:
    """One page's connection."""

    def __init__(self, service: StopService, receive: Receive, send: Send):
        self._service = service
        self._receive = receive
        self._send = send
        self._changed = asyncio.Event()
        self._question: Question | None = None
        self._is_gone = False

    async def serve(self) -> None:
        """Serve the connection until the page closes it."""
        await self._receive()  # the connect message, which must be answered first
        await self._send({"type": "websocket.accept"})
        helpers = [
            asyncio.create_task(self._listen()),
            asyncio.create_task(self._service.changes(self._changed)),
        ]
        try:
            while True:
                await self._changed.wait()
                self._changed.clear()
                if self._is_gone:
                    return
                if self._question is not None:
                    text = self._service.answer(self._question)
                    await self._send({"type": "websocket.send", "text": text})
        finally:
            for helper in helpers:
                helper.cancel()

    async def _listen(self) -> None:
        while (message := await self._receive())["type"] == "websocket.receive":
            question = question_of(message.get("text"))
            if question is None:
                continue
            self._service.take(question)
            self._question = question
            self._changed.set()
        self._is_gone = True
        self._changed.set()
