"""What somebody may look for in a log that plays: crashes, marks and victims."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from robbie_mp.errors import RobbieError
from robbie_mp.messages import Mark, ModuleState, VictimFound
from robbie_mp.recording.reader import LoggedMessage, open_log
from robbie_mp.station.victim_watch import STATES

CRASHED = ("BACKOFF", "FAILED")
TYPES = {(one.type_name, one.version) for one in (Mark, ModuleState, VictimFound)}
MOST_EVENTS = 300
AT_ONCE = 100
"""Messages that are looked at before others may go on: the pages come first."""


@dataclass(frozen=True)
class LogEvent:
    """Something that happened at a moment of a log."""

    time_ns: int
    kind: str
    """"crash", "mark" or "victim"."""
    text: str


class LogEvents:
    """Reads a log through, once, in a thread of its own.

    Attributes:
        found: the first events, by time; replaced and never changed, for pages look at it meanwhile.
        error: why there are none; '' if that is not known.
    """

    def __init__(self) -> None:
        self.found: tuple[LogEvent, ...] = ()
        self.error = ""
        self._file = ""

    def read(self, file: str) -> None:
        """Begin to read a log, if it is another one than before; always called by the same thread."""
        if file != self._file:
            self._file, self.found, self.error = file, (), ""
            threading.Thread(target=self._read, args=(file,), name="events of a log", daemon=True).start()

    def _read(self, file: str) -> None:
        found: tuple[LogEvent, ...] = ()
        error = ""
        try:
            with open_log(Path(file)) as log:
                channels = [one for one in log.channels if (one.type_name, one.version) in TYPES]
                events = events_of(_in_peace(log.messages(channels=channels)))
                found = tuple(islice(events, MOST_EVENTS))
        except (RobbieError, OSError) as unreadable:
            error = str(unreadable)
        if file == self._file:
            self.found, self.error = found, error


def _in_peace(messages: Iterable[LoggedMessage]) -> Iterator[LoggedMessage]:
    for count, message in enumerate(messages):
        if count % AT_ONCE == 0:
            time.sleep(0.001)
        yield message


def events_of(messages: Iterable[LoggedMessage]) -> Iterator[LogEvent]:
    """Yield what happened: marks, modules that crashed, and victims whenever their state was another one."""
    states: dict[int, int] = {}
    for message in messages:
        name = message.channel.type_name
        if name == Mark.type_name:
            mark = Mark.decode(message.data)
            yield LogEvent(message.time_ns, "mark", mark.text or "mark")
        elif name == ModuleState.type_name:
            state = ModuleState.decode(message.data)
            if state.state in CRASHED:
                text = f"{state.module} is {state.state}: {state.reason}"
                yield LogEvent(message.time_ns, "crash", text)
        else:
            victim = VictimFound.decode(message.data)
            if states.get(victim.id) != victim.state:
                states[victim.id] = victim.state
                text = f"{victim.name or victim.id} {STATES.get(victim.state, victim.state)}"
                yield LogEvent(message.time_ns, "victim", text)
