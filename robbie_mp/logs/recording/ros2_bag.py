"""Reads bags of ROS 2: a folder of rosbag2, or one of its files, in MCAP or SQLite.

The files decide: `metadata.yaml` only helps where they say nothing. So a topic is read even if that file is
missing, is older than the bag, or describes the topic in another way (the library rosbags drops it then).
Source: rosbag2's `rosbag2_storage_sqlite3` and `rosbag2_storage_mcap`, and `metadata_io.cpp`.
"""

import shutil
import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Protocol

import yaml
import zstandard
from typing_extensions import Self

from robbie_mp.base.balance import Balance
from robbie_mp.base.problem import ProfileError
from robbie_mp.base.yaml_reader import read_file
from robbie_mp.logs.recording.errors import BagUnreadable
from robbie_mp.logs.recording.format import BAG_METADATA, BAG_PART_NAME, QOS_KEY, SCHEMA_ENCODING
from robbie_mp.logs.recording.limits import READ_LIMITS
from robbie_mp.logs.recording.part import LogPart
from robbie_mp.logs.recording.reader import NO_CHANNEL, REPAIRED_SUFFIX, TRANSIENT_LOCAL
from robbie_mp.logs.recording.repair import repaired_name
from robbie_mp.logs.recording.scan import LOST_DESCRIPTIONS
from robbie_mp.messages.service_events import is_event_type

MCAP, SQLITE, ZSTD = ".mcap", ".db3", ".zstd"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""The start of a message that rosbag2 has compressed; CDR starts with a zero byte."""
LAST_TIME_NS = 2**64 - 1


class BagTopic(NamedTuple):
    """A topic of a bag.

    Attributes:
        name: its name, with a leading slash.
        type_name: as `std_msgs/msg/String`; "" if the bag does not say.
        encoding: of its messages.
        form: how its type is defined: `ros2msg`, `ros2idl`, or anything else.
        definition: the definition; None if there is none.
        is_latched: whether late subscribers get the newest message.
        about: what the file says about its channel.
    """

    name: str
    type_name: str
    encoding: str
    form: str
    definition: str | None
    is_latched: bool
    about: tuple[tuple[str, str], ...] = ()


BagMessage = tuple[BagTopic, int, bytes]


class Storage(Protocol):
    """A file of a bag.

    Attributes:
        count: the messages in it.
        topics: what it describes.
    """

    count: int
    topics: list[BagTopic]

    def messages(self, balance: Balance) -> Iterator[BagMessage]:
        """Yield topic, time in ns and bytes of each message; count those that it cannot yield."""

    def close(self) -> None:
        """Close the file."""


class _McapStorage:
    """A file in MCAP."""

    def __init__(self, path: Path):
        self._part = LogPart(path, READ_LIMITS)
        contents = self._part.contents
        self.count = contents.message_count
        self._topics: dict[int, BagTopic] = {}
        for id_, channel in contents.channels.items():
            schema = contents.schemas.get(channel.schema_id)
            text = schema.data.decode(errors="replace") if schema else ""
            has_text = schema is not None and (text or schema.encoding == SCHEMA_ENCODING)
            self._topics[id_] = BagTopic(
                channel.topic,
                schema.name if schema else "",
                channel.message_encoding,
                schema.encoding if schema else "",
                text if has_text else None,
                TRANSIENT_LOCAL.search(channel.metadata.get(QOS_KEY, "")) is not None,
                tuple(channel.metadata.items()),
            )
        self.topics = list(self._topics.values())

    def messages(self, balance: Balance) -> Iterator[BagMessage]:
        for message in self._part.messages():
            topic = self._topics.get(message.channel_id)
            if topic is None:
                balance.leave_out(NO_CHANNEL)
            else:
                yield topic, message.time_ns, message.data
        for damage in self._part.contents.damage:
            if not damage.endswith(LOST_DESCRIPTIONS):
                balance.leave_out(f"the part of {self._part.path.name} that is damaged: {damage}")

    def close(self) -> None:
        self._part.close()


class _SqliteStorage:
    """A file in SQLite."""

    def __init__(self, path: Path):
        self._path = path
        # A database that was not closed has newer messages in a file beside it.
        beside = path.with_name(f"{path.name}-wal")
        mode = "mode=ro" if beside.exists() and beside.stat().st_size else "immutable=1"
        try:
            self._base = sqlite3.connect(f"{path.resolve().as_uri()}?{mode}", uri=True)
        except sqlite3.Error as error:
            raise BagUnreadable(f"{path} cannot be read: {error}") from error
        self._base.text_factory = lambda data: data.decode(errors="replace")
        try:
            ((self.count,),) = self._base.execute("SELECT count(*) FROM messages")
            definitions = self._definitions()
            self._topics = {int(row["id"]): _topic_of(row, definitions) for row in self._rows("topics")}
        except (sqlite3.Error, KeyError, ValueError, TypeError) as error:
            self._base.close()
            raise BagUnreadable(f"{path} is no bag of ROS 2, or is damaged: {error!r}") from error
        self.topics = list(self._topics.values())
        self._cursor = self._base.cursor()

    def _rows(self, table: str) -> list[dict[str, Any]]:
        with closing(self._base.execute(f"SELECT * FROM {table}")) as rows:
            names = [column[0] for column in rows.description]
            return [dict(zip(names, row, strict=True)) for row in rows]

    def _definitions(self) -> dict[str, tuple[str, str]]:
        """Return form and text of each type's definition; before ROS 2 Iron there is none."""
        try:
            rows = self._rows("message_definitions")
        except sqlite3.OperationalError:
            return {}
        return {
            str(row["topic_type"]): (str(row["encoding"]), str(row["encoded_message_definition"]))
            for row in rows
        }

    def messages(self, balance: Balance) -> Iterator[BagMessage]:
        done = 0
        try:
            query = "SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"
            self._cursor.execute(query)
            for id_, time_ns, data in self._cursor:
                done += 1
                topic = self._topics.get(id_)
                if topic is None:
                    balance.leave_out(NO_CHANNEL)
                elif not isinstance(data, bytes) or not isinstance(time_ns, int):
                    balance.leave_out(f"messages of {topic.name} that are no bytes with a time")
                else:
                    yield topic, time_ns, data
        except sqlite3.Error as error:
            left = max(self.count - done, 1)
            balance.leave_out(f"the part of {self._path.name} that is damaged: {error}", left)

    def close(self) -> None:
        self._cursor.close()  # an unfinished one would keep the file open
        self._base.close()


def _topic_of(row: Mapping[str, Any], definitions: Mapping[str, tuple[str, str]]) -> BagTopic:
    type_name = str(row["type"])
    service = type_name.removesuffix("_Event") if is_event_type(type_name) else type_name
    form, text = definitions.get(type_name) or definitions.get(service) or ("", None)
    latched = TRANSIENT_LOCAL.search(str(row.get("offered_qos_profiles", ""))) is not None
    has_text = text or form == SCHEMA_ENCODING
    encoding = str(row["serialization_format"])
    return BagTopic(str(row["name"]), type_name, encoding, form, text if has_text else None, latched)


STORAGES: dict[str, type[_McapStorage | _SqliteStorage]] = {MCAP: _McapStorage, SQLITE: _SqliteStorage}


def _storage(file: Path, stack: ExitStack) -> Storage:
    kind = STORAGES.get(_plain_suffix(file))
    if kind is None:
        raise BagUnreadable(f"{file} is no {MCAP} or {SQLITE} file, nor a folder of a bag")
    if not file.exists():
        raise BagUnreadable(f"{file} does not exist")
    return kind(_decompressed(file, stack))


class Ros2Bag:
    """An open bag of ROS 2; use it as a context manager.

    Args:
        path: its folder, or one file.
        balance: counts the messages that the bag has and that cannot be read.

    Attributes:
        topics: of all files.
        message_count: the messages in all files that can be opened.
        distribution: the distribution of ROS that recorded it; "" if the bag does not say.
        notes: where `metadata.yaml` and the files differ, one line each.

    Raises:
        BagUnreadable: there is no bag, or none of its files can be read.
    """

    def __init__(self, path: Path, balance: Balance):
        self._balance = balance
        self.notes: list[str] = []
        self._metadata = _metadata(path, self.notes) if path.is_dir() else {}
        self.distribution = str(self._metadata.get("ros_distro") or "")
        with ExitStack() as stack:
            self._storages = self._open(path, _files(path, self._metadata, self.notes), stack)
            self._opened = stack.pop_all()
        self.topics = [topic for storage in self._storages for topic in storage.topics]
        self.message_count = sum(storage.count for storage in self._storages)
        self._latched = _latched_topics(self._metadata)

    def _open(self, path: Path, files: list[Path], stack: ExitStack) -> list[Storage]:
        found: list[Storage] = []
        problems: list[str] = []
        for file in files:
            if len(files) > 1 and file.exists() and not file.stat().st_size:
                self.notes.append(f"{file.name} is empty")
                continue
            try:
                storage = _storage(file, stack)
            except (OSError, ValueError, zstandard.ZstdError) as error:  # our errors are one of these
                problems.append(str(error))
                self._balance.leave_out(f"the messages of {file.name}: {error}", self._stated(file))
            else:
                stack.callback(storage.close)
                found.append(storage)
        if not found:
            why = problems[0] if problems else f"there is no {MCAP} or {SQLITE} file"
            raise BagUnreadable(f"{path} cannot be read as a bag of ROS: {why}")
        return found

    def _stated(self, file: Path) -> int:
        """Return how many messages a file has that cannot be opened; at least one."""
        for about in _list(self._metadata.get("files")):
            if isinstance(about, dict) and PurePath(str(about.get("path"))).name == file.name:
                return max(_whole(about.get("message_count")), 1)
        return 1

    def is_latched(self, topic: BagTopic) -> bool:
        """Return whether late subscribers get the newest message of a topic."""
        return topic.is_latched or topic.name in self._latched

    def messages(self) -> Iterator[BagMessage]:
        """Yield topic, time in ns and bytes of each message, file by file."""
        counts: Counter[str] = Counter()
        for storage in self._storages:
            for topic, time_ns, data in storage.messages(self._balance):
                counts[topic.name] += 1
                if not 0 <= time_ns <= LAST_TIME_NS:
                    self._balance.leave_out(f"messages of {topic.name} with a time before 1970")
                elif (unpacked := _unpacked(data)) is None:
                    self._balance.leave_out(f"messages of {topic.name} that cannot be decompressed")
                else:
                    yield topic, time_ns, unpacked
        self.notes += _differences(self._metadata, counts)

    def close(self) -> None:
        """Close the files."""
        self._opened.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


def _metadata(folder: Path, notes: list[str]) -> dict[str, Any]:
    """Return what `metadata.yaml` says; {} if it is missing or cannot be read."""
    if not (folder / BAG_METADATA).exists():
        notes.append(f"{folder} has no {BAG_METADATA}; its files are read without it")
        return {}
    try:
        content = read_file(folder / BAG_METADATA).plain()
    except ProfileError as error:
        notes.append(f"{folder / BAG_METADATA} cannot be read, and is ignored: {error}")
        return {}
    about = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(about, dict):
        notes.append(f"{folder / BAG_METADATA} does not describe a bag, and is ignored")
        return {}
    return about


def _files(path: Path, metadata: Mapping[str, Any], notes: list[str]) -> list[Path]:
    """Return the files of a bag: those listed, also if they are missing, and the other parts of their name.

    Raises:
        BagUnreadable: nothing is listed, and the folder has files of several names.
    """
    if not path.is_dir():
        return [path]
    listed = [path / PurePath(str(one)).name for one in _list(metadata.get("relative_file_paths"))]
    listed = [file for file in listed if _plain_suffix(file) in STORAGES]
    others = {file for file in path.iterdir() if _plain_suffix(file) in STORAGES}.difference(listed)
    others = {file for file in others if not file.name.endswith(REPAIRED_SUFFIX)}
    names = {_part(file)[0] for file in listed or others}
    if not listed and len(names) > 1:
        raise BagUnreadable(f"{path} has several bags ({', '.join(sorted(names))}); name a file")
    parts = sorted((file for file in others if _part(file)[0] in names), key=_part)
    notes += [
        f"{file} is no part of the bag; import it by itself" for file in sorted(others.difference(parts))
    ]
    if listed:
        notes += [
            f"{file.name} is not in {BAG_METADATA}, but a part of the bag; it is read" for file in parts
        ]
    repaired = {file: repaired_name(file) for file in listed + parts}
    return [better if better.exists() else file for file, better in repaired.items()]


def _part(file: Path) -> tuple[str, int]:
    """Return the name of the bag and the number of the part in the name of a file."""
    name = PurePath(file.name.removesuffix(ZSTD))
    match = BAG_PART_NAME.fullmatch(name.stem + MCAP)
    return (match["name"], int(match["number"])) if match else (name.stem, -1)


def _plain_suffix(file: Path) -> str:
    return PurePath(file.name.removesuffix(ZSTD)).suffix


def _decompressed(file: Path, stack: ExitStack) -> Path:
    """Return a file of a bag, or a copy of it if rosbag2 has compressed the whole file."""
    if file.suffix != ZSTD:
        return file
    copy = Path(stack.enter_context(TemporaryDirectory()), file.stem)
    with file.open("rb") as packed, copy.open("wb") as plain:
        reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
        shutil.copyfileobj(reader, plain, 1 << 20)
    return copy


def _unpacked(data: bytes) -> bytes | None:
    """Return a message as it was before rosbag2 compressed it; None if it cannot be."""
    if data[:4] != ZSTD_MAGIC:
        return data
    try:
        reader = zstandard.ZstdDecompressor().stream_reader(data)
        plain = reader.read(READ_LIMITS.chunk_bytes + 1)
    except zstandard.ZstdError:
        return None
    return plain if len(plain) <= READ_LIMITS.chunk_bytes else None


def _topic_rows(metadata: Mapping[str, Any]) -> Iterator[tuple[dict[str, Any], int]]:
    """Yield what `metadata.yaml` says about each topic, and its count of messages."""
    for row in _list(metadata.get("topics_with_message_count")):
        about = row.get("topic_metadata") if isinstance(row, dict) else None
        if isinstance(about, dict):
            yield about, _whole(row.get("message_count"))


def _latched_topics(metadata: Mapping[str, Any]) -> set[str]:
    """Return the topics that are latched according to `metadata.yaml`; its version 9 has lists, not texts."""
    found = set()
    for about, _ in _topic_rows(metadata):
        quality = about.get("offered_qos_profiles") or ""
        text = quality if isinstance(quality, str) else yaml.safe_dump(quality)
        if TRANSIENT_LOCAL.search(text):
            found.add(str(about.get("name")))
    return found


def _differences(metadata: Mapping[str, Any], counts: Mapping[str, int]) -> Iterator[str]:
    """Yield a line for each topic of which `metadata.yaml` counts other messages than there are."""
    if not metadata:
        return
    stated: Counter[str] = Counter()
    for about, count in _topic_rows(metadata):
        stated[str(about.get("name"))] += count
    for name in sorted(stated.keys() | counts.keys()):
        count = counts.get(name, 0)
        if stated[name] != count:
            yield f"{BAG_METADATA} counts {stated[name]} messages of {name}, the files hold {count}"


def _list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _whole(value: object) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) else 0
