"""The form of a capsule: a zip with descriptions in JSON, and all messages as a log in MCAP.

    capsule.json     a `Manifest`
    crash.txt        the crash report, to read
    events.jsonl     what the module handled and was told, in order: an `Event` in each line
    messages.mcap    what it received and published; events say which message they mean
    code.diff        what git found changed in the workspace

Nothing in it is ever executed or unpickled.
"""

from typing import Any

import msgspec

FORMAT = 1
MANIFEST, REPORT, EVENTS, MESSAGES, DIFF = (
    "capsule.json",
    "crash.txt",
    "events.jsonl",
    "messages.mcap",
    "code.diff",
)


class ChannelForm(msgspec.Struct, frozen=True):
    """Type, version and topic of messages; of a subscription, perhaps patterns."""

    type_name: str
    version: int
    topic: str
    is_subscription: bool = False
    handler: str = ""


class StartForm(msgspec.Struct):
    """What the module began with, as it wrote it itself."""

    module: str
    class_path: str = msgspec.field(name="class")
    settings: dict[str, Any] = {}
    topics: dict[str, str] = {}
    namespace: str = ""
    run: str = ""
    profile: str = ""
    workspace: str = ""
    incarnation: int = 1
    seed: int | None = None
    hash_seed: str = "random"
    lost: int = 0
    is_restored: bool = False
    lockstep: bool = False
    process_bytes: int | None = None
    address_space_bytes: int = 0
    started_ns: int = 0
    monotonic_ns: int = 0
    robbie: str = ""
    python: str = ""
    files: dict[str, list[int]] = {}

    @property
    def more_bytes(self) -> int | None:
        """The address space that it could take from its start on; None: there was no limit."""
        return None if self.process_bytes is None else self.process_bytes - self.address_space_bytes


class CodeFile(msgspec.Struct):
    """One imported file of the workspace."""

    sha256: str
    has_changed: bool = False
    """Whether it was changed after the module had imported it."""


class Manifest(msgspec.Struct):
    """The file `capsule.json`.

    Attributes:
        start: what the module began with.
        report: the crash report, as `CrashReport.from_json` reads it.
        is_whole: whether the events are all since the module's start; if not, they are the newest ones.
        damage: what was wrong with the module's memory; '' if nothing.
        channels, declarations: by their numbers in events.
        senders: names of modules by their slots.
        left_out: messages that were too large to be kept.
        code: the files of the workspace that it had imported.
        commit: what git says of the workspace; '' if it is no repository.
        packages: versions of packages that matter.
        environment: variables that matter, and the machine.
        variables: those that its code names.
    """

    format: int
    start: StartForm
    report: dict[str, Any]
    is_whole: bool
    damage: str = ""
    channels: dict[str, ChannelForm] = {}
    declarations: dict[str, ChannelForm] = {}
    senders: dict[str, str] = {}
    left_out: int = 0
    code: dict[str, CodeFile] = {}
    commit: str = ""
    packages: dict[str, str] = {}
    environment: dict[str, str] = {}
    variables: dict[str, str] = {}


class EventForm(msgspec.Struct, omit_defaults=True):
    """One line of `events.jsonl`; the values are those of `robbie_mp.bus.transport.history.Event`.

    Attributes:
        kind: the name of the event.
        number: counts since the module's start.
        time_ns: by the machine's monotonic clock; 0: not noted.
        values: numbers.
        size: of the data.
        message: which message of the log holds the data.
        data: the data themselves, if they are no message; None: there are none, or they were too large.
    """

    kind: str
    number: int
    time_ns: int = 0
    values: tuple[int, int, int, int] = (0, 0, 0, 0)
    size: int = 0
    message: int | None = None
    data: bytes | None = None
