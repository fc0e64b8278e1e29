"""Events in a log that plays, shown above the playback's bar: crashes, marks, and events of panels."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.logs.recording.reader import LoggedMessage, open_log
from robbie_mp.messages import Mark, Message, ModuleState

CRASHED = ("BACKOFF", "FAILED")
MAX_EVENTS = 300
MESSAGES_PER_TURN = 100
"""Number of messages read before other threads get the processor, because serving pages is more urgent."""


@dataclass(frozen=True)
class EventKind:
    """A kind of event that messages of one type describe.

    Attributes:
        name: unique name of the kind, such as "crash".
        message_type: type of the messages.
        make_reader: makes the function that reads one log. It gets every message in order, and returns a text
            for an event, or None.
        icon: name of a Material Icon.
        colour: name of a Quasar colour, such as "red-3".
    """

    name: str
    message_type: type[Message]
    make_reader: Callable[[], Callable[[Any], str | None]]
    icon: str
    colour: str


def crash_of(state: ModuleState) -> str | None:
    """Return the module that crashed, or None."""
    return f"{state.module} is {state.state}: {state.reason}" if state.state in CRASHED else None


def mark_of(mark: Mark) -> str:
    """Return the text of a mark."""
    return mark.text or "mark"


CRASH = EventKind("crash", ModuleState, lambda: crash_of, "heart_broken", "red-3")
MARK = EventKind("mark", Mark, lambda: mark_of, "bookmark", "amber-3")


@dataclass(frozen=True)
class LogEvent:
    """An event at a time of a log."""

    time_ns: int
    kind: EventKind
    text: str


class LogEvents:
    """Reads a log once, in a separate thread.

    Args:
        kinds: the events to find, besides crashes and marks.

    Attributes:
        found: the first events, by time. The tuple is replaced and never changed, because pages read it.
        error: why there are none; '' if there is no error.
    """

    def __init__(self, kinds: Iterable[EventKind] = ()) -> None:
        self.found: tuple[LogEvent, ...] = ()
        self.error = ""
        self._kinds = (CRASH, MARK, *kinds)
        self._file = ""

    def read(self, file: str) -> None:
        """Start to read a log, unless it is the last one read. Always call this in the same thread."""
        if file != self._file:
            self._file, self.found, self.error = file, (), ""
            threading.Thread(target=self._read, args=(file,), name="events of a log", daemon=True).start()

    def _read(self, file: str) -> None:
        found: tuple[LogEvent, ...] = ()
        error = ""
        try:
            with open_log(Path(file)) as log:
                wanted = {(one.message_type.type_name, one.message_type.version) for one in self._kinds}
                channels = [one for one in log.channels if (one.type_name, one.version) in wanted]
                events = events_of(_pausing(log.messages(channels=channels)), self._kinds)
                found = tuple(islice(events, MAX_EVENTS))
        except (RobbieError, OSError) as unreadable:
            error = str(unreadable)
        if file == self._file:
            self.found, self.error = found, error


def _pausing(messages: Iterable[LoggedMessage]) -> Iterator[LoggedMessage]:
    for count, message in enumerate(messages):
        if count % MESSAGES_PER_TURN == 0:
            time.sleep(0.001)
        yield message


def events_of(messages: Iterable[LoggedMessage], kinds: Sequence[EventKind]) -> Iterator[LogEvent]:
    """Yield the events in the order of the messages."""
    readers = [(kind, kind.make_reader()) for kind in kinds]
    for message in messages:
        for kind, describe in readers:
            if kind.message_type.type_name == message.channel.type_name:
                text = describe(kind.message_type.decode(message.data))
                if text is not None:
                    yield LogEvent(message.time_ns, kind, text)
