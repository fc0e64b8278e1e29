"""What the black box must remember beyond the life of its process."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
from typing_extensions import Self

from robbie_mp.base.linux.private_files import private_opener, write_private

MAX_STATE_BYTES = 1 << 20
MAX_TRIGGERS = 50
"""Triggers that a clip names; more are only counted."""
MAX_CLIP_S = 60.0
"""Further triggers make a clip no longer than this after the first one."""
AGAIN_NS = 1_000_000_000
"""A trigger that comes again sooner is only counted."""
MAX_OPEN = 8
CLIP_NAME = re.compile(r"\d{8}T\d{6}Z-[a-z0-9-]{1,60}")


@dataclass
class OpenClip:
    """A clip that is not on the disk yet, or not whole."""

    name: str
    """Of its folder."""
    at_ns: int
    """When its first trigger came, on the machine's monotonic clock."""
    until_ns: int
    """Until when it lasts."""
    first: int
    """Number of its first part in the ring."""
    last: int = -1
    """Number of its last part; -1: not known yet."""
    triggers: list[str] = field(default_factory=list)
    more: int = 0
    """Triggers beyond MAX_TRIGGERS, and those that came again within a second."""
    times_s: list[float] = field(default_factory=list)
    """When the triggers came, seconds since 1970."""
    told_ns: dict[str, int] = field(default_factory=dict)
    """When each trigger was named last, on the machine's monotonic clock."""

    @property
    def count(self) -> int:
        """Number of triggers."""
        return len(self.triggers) + self.more

    def takes(self, now_ns: int) -> bool:
        """Whether a trigger belongs to it; a clip that is over may still collect its messages."""
        return self.last < 0 and now_ns <= self.at_ns + round(MAX_CLIP_S * 1e9)

    def add(self, trigger: str, now_ns: int, time_s: float, after_s: float) -> bool:
        """Add a trigger; return whether more than a count has changed."""
        self.until_ns = min(now_ns + round(after_s * 1e9), self.at_ns + round(MAX_CLIP_S * 1e9))
        is_again = trigger in self.told_ns and now_ns - self.told_ns[trigger] < AGAIN_NS
        if is_again or len(self.triggers) >= MAX_TRIGGERS:
            self.more += 1
            return False
        self.triggers.append(trigger)
        self.times_s.append(time_s)
        self.told_ns[trigger] = now_ns
        return True


@dataclass
class BoxState:
    """The clips that are not finished, and the counts of the run.

    Every trigger is in exactly one of `written`, `missed` and the counts of the open clips.
    """

    open: list[OpenClip] = field(default_factory=list)
    epoch_ns: int = 0
    """Start of the machine's monotonic clock, ns since 1970, for all times of the run; 0: not known."""
    seen: dict[str, tuple[int, int]] = field(default_factory=dict)
    """For each module, the end of a process and the incarnation in FAILED that have been triggers."""
    clips: int = 0
    """Clips on the disk."""
    written: int = 0
    """Triggers whose clip is on the disk."""
    unseen: int = 0
    """Those of `missed` that never reached the black box."""
    missed: dict[str, int] = field(default_factory=dict)
    """Triggers without a clip, or with one that is not whole, by reason."""

    @property
    def triggers(self) -> int:
        """All triggers."""
        return self.written + sum(self.missed.values()) + sum(clip.count for clip in self.open)

    def miss(self, triggers: int, reason: str) -> None:
        """Count triggers without a clip."""
        if triggers:
            self.missed[reason] = self.missed.get(reason, 0) + triggers

    @classmethod
    def load(cls, path: Path) -> tuple[Self, str]:
        """Return what an earlier process has saved, and why nothing can be known; '' if it can.

        The file may have been cut or forged: a name in it is used only if it is one of a clip.
        """
        try:
            with open(path, "rb", opener=private_opener) as file:
                data = file.read(MAX_STATE_BYTES + 1)
            found = msgspec.json.decode(data, type=cls)
        except FileNotFoundError:
            return cls(), ""
        except (OSError, ValueError) as error:
            return cls(), f"{path.name} of an earlier process cannot be read: {error}"
        if len(data) > MAX_STATE_BYTES or len(found.open) > MAX_OPEN:
            return cls(), f"{path.name} of an earlier process is too large"
        if not all(CLIP_NAME.fullmatch(clip.name) and clip.first >= 0 for clip in found.open):
            return cls(), f"{path.name} of an earlier process was changed"
        return found, ""

    def save(self, path: Path) -> None:
        """Save it for the next process.

        Raises:
            OSError: there is no room.
        """
        write_private(path, msgspec.json.encode(self))
