"""What happened, as triggers of clips say it: the kind of each, and one list for all clips of a run."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from strenum import StrEnum

from robbie_mp.logs.black_box.clip_folder import SavedClip


class HappeningKind(StrEnum):
    """What kind of thing happened."""

    FAILED = "FAILED"
    CRASH = "crash"
    HANG = "hang"
    STOP = "stop"
    BUMPER = "bumper"
    VICTIM = "victim"
    MARK = "mark"
    OTHER = "limit"


_KINDS = (
    (HappeningKind.VICTIM, re.compile(r"mark: victim\b")),
    (HappeningKind.MARK, re.compile("mark: ")),
    (HappeningKind.STOP, re.compile(r"EmergencyStop\.")),
    (HappeningKind.BUMPER, re.compile(r"Bumper\.")),
    (HappeningKind.FAILED, re.compile(r"\S+ is FAILED: ")),
    (HappeningKind.HANG, re.compile(r"\S+ ended: .*(\bfor \d+\.\d s\b|\bhung\b|not ready within)")),
    (HappeningKind.CRASH, re.compile(r"\S+ ended: |the supervisor was killed$")),
)
_TEXTS = {
    "EmergencyStop.engaged == true": "the emergency stop was engaged",
    "Bumper.pressed != []": "the bumper was pressed",
}


@dataclass(frozen=True)
class Happening:
    """Something that happened, and the clip that shows it."""

    time_s: float
    """Seconds since 1970."""
    kind: HappeningKind
    text: str
    clip: str
    """Name of the clip's folder; '' if there is none."""


def kind_of(trigger: str) -> HappeningKind:
    """Return the kind of a trigger; a field against a limit of the profile is none of the others."""
    return next((kind for kind, form in _KINDS if form.match(trigger)), HappeningKind.OTHER)


def text_of(trigger: str) -> str:
    """Return a trigger in words."""
    return _TEXTS.get(trigger, trigger.removeprefix("mark: "))


def happenings_of(clips: Iterable[SavedClip]) -> list[Happening]:
    """Return what the triggers of some clips say, by time; of a clip without a description, nothing."""
    found = [
        Happening(time_s, kind_of(trigger), text_of(trigger), clip.folder.name)
        for clip in clips
        if clip.about is not None
        for trigger, time_s in zip(clip.about.triggers, clip.about.times_s, strict=False)
    ]
    return sorted(found, key=lambda one: one.time_s)
