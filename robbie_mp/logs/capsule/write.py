"""The process that writes a capsule: `python -m robbie_mp.logs.capsule.write NAME=DESCRIPTOR…`.

It reads the dead module's memory by read(2) and not by a map, because a module may have shortened its files.
"""

import hashlib
import json
import os
import platform
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec

from robbie_mp.base.linux.private_files import make_private_folder, replacing
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.board import Board
from robbie_mp.bus.transport.history import Event, FoundHistory, Record, read_history
from robbie_mp.bus.transport.records import Outbound
from robbie_mp.bus.transport.tables import CoreTables, DeclarationRow
from robbie_mp.bus.transport.words import Words
from robbie_mp.logs.capsule.form import (
    DIFF,
    EVENTS,
    FORMAT,
    MANIFEST,
    MESSAGES,
    REPORT,
    ChannelForm,
    CodeFile,
    EventForm,
    Manifest,
    StartForm,
)
from robbie_mp.logs.capsule.variables import named_variables
from robbie_mp.logs.recording.chunk import Chunk, Compression
from robbie_mp.logs.recording.format import ChannelKey
from robbie_mp.logs.recording.part_writer import PartWriter, RecordedChannel
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.run.trace.crash import CrashReport

MOST_BYTES = 2 << 30
MOST_DIFF_BYTES = 1 << 20
GIT_LIMIT_S = 5.0
PACKAGES = ("numpy", "scipy", "opencv-python-headless", "opencv-python", "torch", "onnxruntime", "pyserial")
VARIABLES = ("LANG", "LC_ALL", "TZ", "OMP_NUM_THREADS", "PYTHONPATH", "ROBBIE_PURE_PYTHON", "VIRTUAL_ENV")
SUPERVISOR = "supervisor"


def main(arguments: list[str]) -> int:
    """Write one capsule."""
    os.nice(19)
    files = {what: _read(int(fd)) for what, _, fd in (one.partition("=") for one in arguments)}
    facts = json.loads(files["facts"])
    path = Path(facts["path"])
    try:
        make_private_folder(path.parent)
        write_capsule(path, facts, files)
        _remove_old(path, facts["report"]["module"], facts["keep"])
    except OSError as error:
        print(f"{path}: {error.strerror or error}", file=sys.stderr)
        return 1
    return 0


def _read(fd: int) -> bytes:
    size = min(os.fstat(fd).st_size, MOST_BYTES)
    pieces, at = [], 0
    while at < size and (piece := os.pread(fd, size - at, at)):
        pieces.append(piece)
        at += len(piece)
    return b"".join(pieces)


def _remove_old(path: Path, module: str, keep: int) -> None:
    """Remove the oldest capsules of a module."""
    stamp_length = len(path.stem) - len(module)
    found = [one for one in path.parent.glob(f"*{path.suffix}") if one.stem[:-stamp_length] == module]
    for old in sorted(found, key=lambda one: one.stem[len(module) :])[:-keep]:
        old.unlink(missing_ok=True)


def write_capsule(path: Path, facts: dict[str, Any], files: dict[str, bytes]) -> None:
    """Write a capsule; a file of that name is replaced.

    Args:
        path: where.
        facts: what the supervisor knows.
        files: the memory that the module left, and the run's tables.
    """
    found = read_history(files["history"]) if "history" in files else FoundHistory()
    start = _start(found, facts)
    tables = _Tables(files)
    report = facts["report"]
    with TemporaryDirectory(prefix="robbie-capsule-") as folder:
        log = _MessageLog(Path(folder) / MESSAGES, tables, facts["types"], start, report["module"])
        with log:
            received = [one.number for one in found.records if one.kind is Event.MESSAGE]
            events = [
                log.event(record, files.get("message") if record.number in received[-1:] else None)
                for record in found.records
            ]
        commit, diff = _git(start.workspace)
        manifest = Manifest(
            format=FORMAT,
            start=start,
            report=report,
            is_whole=found.is_whole and not found.damage,
            damage=found.damage if "history" in files else "it died before it kept a history",
            channels={str(number): one for number, one in tables.channels.items()},
            declarations={str(number): one for number, one in tables.declarations.items()},
            senders={str(number): one for number, one in tables.senders.items()},
            left_out=log.left_out,
            code=_code(start),
            commit=commit,
            packages=_packages(),
            environment=_environment(),
            variables=named_variables(map(Path, start.files), os.environ),
        )
        with replacing(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as capsule:
            capsule.writestr(MANIFEST, msgspec.json.format(msgspec.json.encode(manifest), indent=1))
            capsule.writestr(REPORT, "\n".join(_report_lines(report)) + "\n")
            capsule.writestr(EVENTS, b"".join(msgspec.json.encode(event) + b"\n" for event in events))
            capsule.write(log.path, MESSAGES, zipfile.ZIP_STORED)
            if diff:
                capsule.writestr(DIFF, diff)


def _report_lines(report: dict[str, Any]) -> list[str]:
    read = CrashReport.from_json(json.dumps(report))
    return read.lines() if read else []


def _start(found: FoundHistory, facts: dict[str, Any]) -> StartForm:
    """Return what the module wrote about its start, which may be anything; the class is the supervisor's."""
    planned = {"module": facts["report"]["module"], "class": facts["class"], "workspace": facts["workspace"]}
    try:
        return msgspec.convert({**found.start, **planned}, StartForm)
    except msgspec.ValidationError as error:
        found.damage = found.damage or f"what it wrote about its start is damaged: {error}"
        return msgspec.convert(planned, StartForm)


class _Tables:
    """The names of what the numbers in a history mean. Only names that are used are read.

    Args:
        files: the memory.
    """

    def __init__(self, files: dict[str, bytes]):
        self._out, core, board = (_words(files[name]) for name in ("out", "core", "board"))
        self._core = CoreTables.attach(core)
        self._board = Board(board)
        self.channels: dict[int, ChannelForm] = {}
        self.declarations: dict[int, ChannelForm] = {}
        self.senders: dict[int, str] = {}

    def channel(self, number: int) -> ChannelForm | None:
        """Return a channel; None: there is none of this number."""
        if number not in self.channels and number < self._core.sizes.channels:
            self.channels[number] = ChannelForm(*self._core.channel_row(number).name)
        return self.channels.get(number)

    def declaration(self, number: int) -> ChannelForm | None:
        """Return what the module declared; None: there is none of this number."""
        if number not in self.declarations and number < layout.DECLARATION_COUNT:
            row = DeclarationRow.read(self._out, number)
            is_subscription = row.kind == Outbound.SUBSCRIBE
            self.declarations[number] = ChannelForm(*row.name, is_subscription, row.handler)
        return self.declarations.get(number)

    def sender(self, source: int) -> str:
        """Return the name of a publisher."""
        slot = source & layout.SOURCE_SLOT
        if slot not in self.senders:
            self.senders[slot] = self._board.name(slot) if slot < self._board.slots else ""
        return self.senders[slot]


def _words(data: bytes) -> Words:
    return memoryview(data[: len(data) // 8 * 8]).cast("Q")


class _MessageLog:
    """The log of the messages; use it as a context manager."""

    def __init__(self, path: Path, tables: _Tables, types: list[list[Any]], start: StartForm, module: str):
        self.path = path
        self.left_out = 0
        self._tables = tables
        self._types = KnownTypes(TypeDescription(*one) for one in types)
        self._epoch_ns = start.started_ns - start.monotonic_ns
        self._module = module
        self._channels: dict[ChannelKey, RecordedChannel] = {}
        self._count = 0
        self._last_ns = start.monotonic_ns
        self._chunk = Chunk(0)

    def __enter__(self) -> "_MessageLog":
        return self

    def __exit__(self, *_error: object) -> None:
        part = PartWriter(self.path, Compression.ZSTD, "robbie-mp")
        try:
            if self._count:
                part.write(self._chunk, {one.id: one for one in self._channels.values()})
            part.finish()
        finally:
            part.close()

    def event(self, record: Record, last: bytes | None) -> EventForm:
        """Return the event of a record, and add its message to the log.

        Args:
            record: the record.
            last: its bytes, if it is the message that the module was handling when it died.
        """
        event = EventForm(record.kind.name, record.number, record.time_ns, record.values, record.size)
        self._last_ns = record.time_ns or self._last_ns
        channel, sender, data = None, self._module, record.data
        if record.kind is Event.MESSAGE:
            channel = self._tables.channel(record.values[0] & 0xFFFFFFFF)
            self._tables.declaration(record.values[0] >> 32)
            sender = self._tables.sender(record.values[2])
            if data is None and last is not None and len(last) == record.size:
                data = last
        elif record.kind is Event.PUBLISHED:
            channel = self._tables.declaration(record.values[0])
        else:
            event.data = data or None
            return event
        if channel is None or data is None:
            self.left_out += record.kind is Event.MESSAGE
        else:
            event.message = self._add(channel, sender, record.values[1], data)
        return event

    def _add(self, channel: ChannelForm, sender: str, sequence: int, data: bytes) -> int:
        key = ChannelKey(channel.type_name, channel.version, channel.topic, sender)
        known = self._channels.get(key)
        if known is None:
            known = self._channels[key] = RecordedChannel(len(self._channels) + 1, key, self._schema(key))
        time_ns = max(0, self._epoch_ns + self._last_ns)
        self._chunk.add(known.id, sequence, time_ns, data)
        self._count += 1
        return self._count - 1

    def _schema(self, key: ChannelKey) -> str | None:
        return self._types.schema(key.type_name, key.version)


def _code(start: StartForm) -> dict[str, CodeFile]:
    """Return the imported files as they are now, and whether they are still those that were imported."""
    found = {}
    for name, stamp in start.files.items():
        path = Path(name)
        try:
            stat, data = path.stat(), path.read_bytes()
        except OSError:
            continue
        has_changed = [stat.st_mtime_ns, stat.st_size] != stamp
        place = path.relative_to(start.workspace) if path.is_relative_to(start.workspace) else path
        found[str(place)] = CodeFile(hashlib.sha256(data).hexdigest(), has_changed)
    return found


def _git(workspace: str) -> tuple[str, bytes]:
    """Return commit and changes of the workspace; empty if it is no repository."""
    return _git_says(workspace, "rev-parse", "HEAD").decode().strip(), _git_says(
        workspace, "diff", "HEAD", "--no-ext-diff", "--no-textconv", "--", "."
    )[:MOST_DIFF_BYTES]


def _git_says(workspace: str, *arguments: str) -> bytes:
    # No program that the repository's configuration names is run.
    command = ["git", "-C", workspace, "-c", "core.fsmonitor=false", "-c", "core.pager=cat", *arguments]
    try:
        said = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=GIT_LIMIT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return b""
    return said.stdout if said.returncode == 0 else b""


def _packages() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _environment() -> dict[str, str]:
    machine = {"machine": platform.machine(), "system": platform.platform(), "host": platform.node()}
    return machine | {name: os.environ[name] for name in VARIABLES if name in os.environ}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
