"""The data about a run that a recorder of the run needs."""

import platform
import re
import socket
import time
from pathlib import Path

from robbie_mp.base.utc import file_stamp
from robbie_mp.base.version import installed_version
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.channels import latched_channels
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.bus.transport.words import Words
from robbie_mp.logs.recording.format import RunMetadata
from robbie_mp.logs.recording.newest import KeepLimits
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.run_clock import RunClock
from robbie_mp.run.run_directory import PROFILE_FILE

UNSAFE = re.compile(r"[^A-Za-z0-9_.-]+")


class RecordedRun:
    """One run, as its recorder sees it.

    Args:
        folder: the folder of the run.

    Attributes:
        begin: the sequence number of the last message that the core had routed when this object was made.
    """

    def __init__(self, folder: Path):
        self.plan = RunPlan.load(folder)
        self.folder = folder
        self._types = _types(self.plan)
        self._clock = RunClock.attach(self.plan.run_id) if self.plan.clock.source is not None else None
        self._core = Segment.attach(names.core(self.plan.run_id), SegmentKind.CORE)
        self.begin = self._core.words[layout.CORE_LAST_SEQUENCE]
        self.epoch_ns = time.time_ns() - time.monotonic_ns()

    @property
    def core(self) -> Words:
        """The core segment."""
        return self._core.words

    def latched(self) -> set[ChannelName]:
        """Return the channels whose newest message the core keeps for later subscribers."""
        return latched_channels(self._core.words)

    @property
    def keep_limits(self) -> KeepLimits:
        """How many of these messages a recording keeps for its next part: as many as the core."""
        return KeepLimits(self.plan.core.latched_messages, self.plan.core.latched_bytes)

    def time_ns(self, machine_ns: int) -> int:
        """Return the run's time at a moment of the machine's monotonic clock, in ns since the epoch.

        A run without its own clock uses the machine's clock as it is set when recording starts. Message times
        then advance evenly even if the machine's clock is set during the recording.
        """
        return self.epoch_ns + machine_ns if self._clock is None else self._clock.at(machine_ns)

    def schema(self, type_name: str, version: int) -> str | None:
        """Return the ros2msg text of a type; None if that version of it is not known."""
        found = self._types.schema(type_name, version)
        if found is None:
            self._types = _types(RunPlan.load(self.folder))  # the run may have learnt it
            found = self._types.schema(type_name, version)
        return found

    def metadata(self) -> RunMetadata:
        """Return the metadata that the parts of its recordings hold about the run."""
        try:
            profile = (self.folder / PROFILE_FILE).read_text()
        except OSError:
            profile = ""
        return RunMetadata(
            run_id=self.plan.run_id,
            profile=self.plan.profile_name,
            host=socket.gethostname(),
            version=installed_version(),
            python=platform.python_version(),
            part=0,
            first_sequence=0,
            started_ns=0,
            clock="system" if self._clock is None else str(self.plan.clock.source),
            profile_yaml=profile,
        )

    def recording_folder(self, folder: Path, recorder: str) -> Path:
        """Return the folder for a recording of this run, below a folder of recordings.

        Args:
            folder: the folder of recordings.
            recorder: name of the recorder; if an earlier process of it has started a recording, it continues
                there.
        """
        ending = f"{recorder}-{self.plan.run_id}"
        for begun in sorted(folder.glob(f"*-{ending}")):
            return begun
        profile = UNSAFE.sub("_", self.plan.profile_name)
        return folder / f"{file_stamp()}-{profile}-{ending}"

    def close(self) -> None:
        """Unmap the core segment and the run's clock."""
        self._core.close()
        if self._clock is not None:
            self._clock.close()


def _types(plan: RunPlan) -> KnownTypes:
    return KnownTypes(TypeDescription(*one) for one in plan.types)
