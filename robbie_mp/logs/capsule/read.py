"""Reads capsules. One may be damaged or forged: everything is checked, and nothing in it is executed."""

import json
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.regular_file import open_regular
from robbie_mp.bus.transport.history import Event
from robbie_mp.logs.capsule.form import EVENTS, FORMAT, MANIFEST, MESSAGES, ChannelForm, EventForm, Manifest
from robbie_mp.logs.recording.errors import LogError
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.run.trace.crash import CrashReport

MOST_BYTES = 1 << 30
"""Of the members of a capsule together, unpacked."""
MOST_TEXT_BYTES = 256 << 20


class CapsuleUnreadable(RobbieError, ValueError):
    """A file is no capsule that this version can read.

    Example scenarios:
      - it was truncated when the disk was full, or while it was copied
      - a newer Robbie-MP wrote it
      - it is a crash report: the capsule lies beside it
    """


@dataclass
class Step:
    """One thing that the module did, and what it was told and published meanwhile.

    Attributes:
        kind: MESSAGE, TICK, CALLS, BEGUN or TEARDOWN; PADDING for everything before, which is its setup.
        event: the event; None for the setup.
        channel: of a message.
        subscription: of a message, what the module subscribed to.
        sender: of a message.
        data: of a message; None: it was too large to be kept, and no other stands in for it.
        told: the events of clocks, other modules and ports, in order.
        published: channel and bytes of each publication, in order. Without a channel it was refused; without
            bytes it was too large.
        checkpoint: image of the checkpoint that it saved last meanwhile.
    """

    kind: Event
    event: EventForm | None = None
    channel: ChannelForm | None = None
    subscription: ChannelForm | None = None
    sender: str = ""
    data: bytes | None = None
    told: list[tuple[Event, EventForm]] = field(default_factory=list)
    published: list[tuple[ChannelForm | None, bytes | None]] = field(default_factory=list)
    checkpoint: bytes | None = None

    @property
    def title(self) -> str:
        """Describe it in a few words."""
        if self.kind is Event.MESSAGE and self.channel is not None:
            topic = f" on {self.channel.topic}" if self.channel.topic else ""
            return f"{self.channel.type_name}{topic} from {self.sender}"
        return "setup" if self.kind is Event.PADDING else self.kind.name.lower()


@dataclass
class Capsule:
    """A capsule as read.

    Attributes:
        path: the file.
        manifest: what it says about itself.
        report: the crash report.
        steps: what the module did, from `base` on.
        base: image of the checkpoint from which the steps begin; None: from the module's start.
        warnings: why a replay may differ.
    """

    path: Path
    manifest: Manifest
    report: CrashReport
    steps: list[Step]
    base: bytes | None = None
    warnings: list[str] = field(default_factory=list)


_STEPS = {Event.MESSAGE, Event.TICK, Event.CALLS, Event.BEGUN, Event.TEARDOWN}
_TOLD = {Event.CLOCK, Event.ANSWER, Event.PORT, Event.RANDOM}


def read_capsule(path: Path) -> Capsule:
    """Read a capsule.

    Raises:
        CapsuleUnreadable: it is none, or it is damaged.
    """
    try:
        with open_regular(path) as opened, zipfile.ZipFile(opened) as file:
            file.filename = str(path)
            return _read(path, file)
    except CapsuleUnreadable:
        raise
    except OSError as error:
        raise CapsuleUnreadable(f"{path} cannot be read: {error.strerror or error}") from error
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError, EOFError) as error:
        raise CapsuleUnreadable(f"{path} is no capsule, or it is damaged: {error}") from error


def _read(path: Path, file: zipfile.ZipFile) -> Capsule:
    if sum(one.file_size for one in file.infolist()) > MOST_BYTES:
        raise CapsuleUnreadable(f"{path} holds more than {MOST_BYTES} bytes")
    head = msgspec.json.decode(_member(file, MANIFEST))
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise CapsuleUnreadable(f"{path} has a format that this Robbie-MP does not read: {MANIFEST}")
    manifest = msgspec.convert(head, Manifest)
    report = CrashReport.from_json(json.dumps(manifest.report))
    if report is None:
        raise CapsuleUnreadable(f"{path}: its crash report is damaged")
    events = [msgspec.json.decode(line, type=EventForm) for line in _member(file, EVENTS).splitlines()]
    steps = _Steps(manifest, _messages(path, file)).of(events)
    capsule = Capsule(path, manifest, report, steps)
    _stand_in(capsule)
    _choose_base(capsule, events)
    return capsule


def _stand_in(capsule: Capsule) -> None:
    """Let the nearest message that was kept stand in for each that was too large, as for an image.

    So what counts messages counts right, and what crashes over such a message does so.
    """
    received = [step for step in capsule.steps if step.kind is Event.MESSAGE and step.channel is not None]
    count = 0
    for steps in (received, received[::-1]):  # rather an earlier one
        newest: dict[ChannelForm | None, bytes] = {}
        for step in steps:
            if step.data is not None:
                newest[step.channel] = step.data
            elif step.channel in newest:
                step.data = newest[step.channel]
                count += 1
    if capsule.manifest.left_out:
        capsule.warnings.append(
            f"{capsule.manifest.left_out} messages were too large to be kept, for {count} of which others "
            "of their topic stand in; raise memory.history_bytes to keep them"
        )


def _member(file: zipfile.ZipFile, name: str) -> bytes:
    try:
        with file.open(name) as member:
            data = member.read(MOST_TEXT_BYTES + 1)
    except KeyError as error:
        raise CapsuleUnreadable(f"{file.filename} is no capsule: it has no {name}") from error
    if len(data) > MOST_TEXT_BYTES:
        raise CapsuleUnreadable(f"{file.filename}: {name} is larger than {MOST_TEXT_BYTES} bytes")
    return data


def _messages(path: Path, file: zipfile.ZipFile) -> list[bytes]:
    with TemporaryDirectory(prefix="robbie-capsule-") as folder:
        place = Path(folder) / MESSAGES
        try:
            with file.open(MESSAGES) as member, place.open("wb") as copy:
                left = MOST_BYTES
                while left > 0 and (piece := member.read(min(left, 1 << 20))):
                    copy.write(piece)
                    left -= len(piece)
            with open_log(place) as log:
                found = [message.data for message in log.messages()]
                damage = log.damage
        except (KeyError, LogError) as error:
            raise CapsuleUnreadable(f"{path}: its messages are damaged: {error}") from error
    if damage:
        raise CapsuleUnreadable(f"{path}: its messages are damaged: {damage[0]}")
    return found


class _Steps:
    def __init__(self, manifest: Manifest, messages: list[bytes]):
        self._manifest = manifest
        self._messages = messages

    def of(self, events: list[EventForm]) -> list[Step]:
        """Group the events: each belongs to the step that was under way."""
        steps = [Step(Event.PADDING)]
        for event in events:
            kind = Event.__members__.get(event.kind)
            if kind is None:
                raise CapsuleUnreadable(f"there is no event {event.kind!r}")
            if kind in _STEPS:
                steps.append(self._step(kind, event))
            elif kind in _TOLD:
                steps[-1].told.append((kind, event))
            elif kind is Event.PUBLISHED:
                channel = self._manifest.declarations.get(str(event.values[0]))
                steps[-1].published.append((channel, self._data(event)))
            elif kind is Event.REFUSED:
                steps[-1].published.append((None, None))
            elif kind is Event.CHECKPOINT:
                steps[-1].checkpoint = event.data
        return steps

    def _step(self, kind: Event, event: EventForm) -> Step:
        if kind is not Event.MESSAGE:
            return Step(kind, event)
        place, source = event.values[0], event.values[2]
        return Step(
            kind,
            event,
            self._manifest.channels.get(str(place & 0xFFFFFFFF)),
            self._manifest.declarations.get(str(place >> 32)),
            self._manifest.senders.get(str(source & 0xFFFF), ""),
            self._data(event),
        )

    def _data(self, event: EventForm) -> bytes | None:
        if event.message is None:
            return None
        if not 0 <= event.message < len(self._messages):
            raise CapsuleUnreadable(f"there is no message {event.message}")
        return self._messages[event.message]


def _choose_base(capsule: Capsule, events: list[EventForm]) -> None:
    """Begin at the module's start if its whole history is there, else at its last checkpoint."""
    manifest, steps, warnings = capsule.manifest, capsule.steps, capsule.warnings
    if manifest.damage:
        warnings.append(f"the module's history is damaged: {manifest.damage}")
    if manifest.is_whole:
        restored = [one for one in events if one.kind == Event.RESTORED.name]
        if restored:
            capsule.base = restored[0].data
            if capsule.base is None:
                warnings.append("the checkpoint that it restored was too large to be kept")
        return
    saved = [number for number, step in enumerate(steps) if step.checkpoint is not None]
    setup = Step(Event.PADDING)
    if saved:
        capsule.base = steps[saved[-1]].checkpoint
        capsule.steps = [setup, Step(Event.BEGUN), *steps[saved[-1] + 1 :]]
        warnings.append("the history was too long to be kept: it begins at the last checkpoint")
    elif manifest.damage != "it died before it kept a history":
        capsule.steps = [setup, Step(Event.BEGUN), *steps[1:]]
        warnings.append(
            "the history was too long to be kept, and there is no checkpoint: only the newest part"
        )


def handled(capsule: Capsule) -> Iterator[tuple[int, Step]]:
    """Yield the steps after the setup, with their numbers as `--until` takes them."""
    return ((number, step) for number, step in enumerate(capsule.steps) if number)
