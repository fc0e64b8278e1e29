"""Converts a ROS 1 or ROS 2 bag to a log; the library rosbags reads the bags of ROS 1, and knows types."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typing_extensions import Self

from robbie_mp.base.balance import Balance
from robbie_mp.base.utc import time_text
from robbie_mp.logs.recording.conversion import NewChannel, converted_log
from robbie_mp.logs.recording.errors import BagUnreadable
from robbie_mp.logs.recording.format import LATCHED_KEY, TOPIC_KEY, VERSION_KEY, ChannelKey
from robbie_mp.logs.recording.reader import has_layout
from robbie_mp.logs.recording.repair import Progress, unwatched
from robbie_mp.logs.recording.ros2_bag import BagTopic, Ros2Bag
from robbie_mp.logs.recording.ros2_types import LITTLE_ENDIAN, Ros2Types, needing_rosbags
from robbie_mp.messages import Header, TypeRegistry, message_type_from_schema, schema_text, stock_registry
from robbie_mp.messages.errors import SchemaError
from robbie_mp.messages.frames import Rename, renamer, unchanged, without_slash

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
"""ROS 2 names of types that have another name in ROS 1."""
BYTE = re.compile(r"^byte\b", re.MULTILINE)


def import_rosbag(source: Path, target: Path, balance: Balance, *, progress: Progress) -> list[str]:
    """Write a log with the messages of a bag, published at the times at which the bag recorded them.

    A type that we have gets our schema if both have the same layout; other types keep their definitions.
    Latched topics stay latched. From a bag of `robbie export`, topics return as they were in the robot.

    Args:
        source: a ROS 1 `.bag` file, or the folder of a ROS 2 bag.
        target: the new file.
        balance: counts messages.
        progress: counts messages.

    Returns:
        Where the bag contradicts itself without a loss, one line each.

    Raises:
        BagUnreadable: the source is not a bag, is damaged, or the library is missing.
        LogNotWritten: the target exists, or cannot be written.
        LeftOut: the balance allows no loss.
    """
    with _opened(source, balance) as bag, converted_log(target, source, balance) as conversion:
        for channel, about, time_ns, data in _converted(bag, balance, progress):
            conversion.add(channel, about, time_ns, data)
    return bag.notes


def describe_bag(source: Path, progress: Progress = unwatched) -> dict[str, str]:
    """Return what a bag holds, and what an import leaves out, as labels with texts. All of it is read.

    Raises:
        BagUnreadable: as `import_rosbag`.
    """
    balance, counts = Balance(), Counter[tuple[str, str]]()
    start_ns = end_ns = 0
    with _opened(source, balance) as bag:
        for channel, _, time_ns, _ in _converted(bag, balance, progress):
            counts[channel.topic, channel.type_name] += 1
            start_ns, end_ns = min(start_ns or time_ns, time_ns), max(end_ns, time_ns)
            balance.use()
    topics = (f"{topic}: {count} {type_name}" for (topic, type_name), count in counts.items())
    left_out = (f"{count} {reason}" for reason, count in balance.left_out.items())
    return {
        "messages": str(balance.read),
        "duration": f"{(end_ns - start_ns) / 1e9:.3f} s",
        "from": f"{time_text(start_ns / 1e9)} to {time_text(end_ns / 1e9)}",
        "topics": "\n".join(topics),
        "import leaves out": "\n".join(left_out) or "nothing",
    } | ({"contradicts itself": "\n".join(bag.notes)} if bag.notes else {})


def _opened(source: Path, balance: Balance) -> "_Ros1Bag | _Ros2Bag":
    return _Ros1Bag(source) if _is_ros1(source) else _Ros2Bag(source, balance)


def _converted(
    bag: "_Ros1Bag | _Ros2Bag", balance: Balance, progress: Progress
) -> Iterator[tuple[NewChannel, dict[str, str], int, bytes]]:
    """Yield the messages as they are in a log: channel, what it says about it, time in ns, and CDR."""
    messages: Iterator[tuple[Any, int, bytes]] = bag.messages()
    for done, (connection, time_ns, data) in enumerate(messages, start=1):
        try:
            converted = (bag.channel(connection), bag.about(connection), time_ns, bag.cdr(connection, data))
        except BagUnreadable as error:
            balance.leave_out(str(error))
        else:
            yield converted
        progress(done, bag.message_count)


def _is_ros1(source: Path) -> bool:
    return source.suffix == ".bag" and not source.is_dir()


class _Ros1Bag:
    """An open bag of ROS 1; turns the library's errors into one error of ours.

    Attributes:
        notes: as `import_rosbag` returns.
    """

    def __init__(self, path: Path):
        with needing_rosbags():
            from rosbags.highlevel import AnyReader  # noqa: PLC0415 - an extra
            from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
        self._path = path
        try:
            self._reader: AnyReader = AnyReader([path], default_typestore=get_typestore(Stores.ROS1_NOETIC))
            self._reader.open()
            self._types: Typestore = self._ros2_types()
        except Exception as error:  # the library raises arbitrary errors for a damaged bag
            raise BagUnreadable(f"{path} cannot be read as a bag of ROS: {error!r}") from error
        self._stock = stock_registry()
        self._channels: dict[int, NewChannel] = {}
        self._renames: dict[int, Rename] = {}
        self.notes: list[str] = []

    @property
    def message_count(self) -> int:
        """Messages in the bag."""
        return self._reader.message_count

    def messages(self) -> Iterator["tuple[Connection, int, bytes]"]:
        """Yield connection, time in ns, and bytes of each message, in time order."""
        try:
            yield from self._reader.messages()
        except Exception as error:
            raise BagUnreadable(f"{self._path} is damaged: {error!r}") from error

    def channel(self, connection: "Connection") -> NewChannel:
        """Return the new channel for a connection."""
        if connection.id not in self._channels:
            type_name = RENAMED.get(connection.msgtype, connection.msgtype)
            schema = self._schema(connection, type_name)
            self._channels[connection.id] = NewChannel(connection.topic, type_name, schema)
            self._renames[connection.id] = _without_slashes(type_name, schema)
        return self._channels[connection.id]

    def about(self, connection: "Connection") -> dict[str, str]:
        """Return the metadata of the new channel for a connection."""
        ext: Any = connection.ext
        return {LATCHED_KEY: "1"} if ext.latching else {}

    def cdr(self, connection: "Connection", data: bytes) -> bytes:
        """Return a message as little-endian CDR."""
        name = connection.msgtype
        try:
            encoded = self._types.ros1_to_cdr(data, name)
            return bytes(self._renames[connection.id](bytes(encoded)))
        except Exception as error:
            raise BagUnreadable(f"messages of {connection.topic} that are no {name}") from error

    def _schema(self, connection: "Connection", type_name: str) -> str:
        try:
            text, _ = self._types.generate_msgdef(connection.msgtype, ros_version=2)
        except Exception as error:
            raise BagUnreadable(f"messages of {connection.topic}, whose type is not known") from error
        schema = _our_schema(self._stock, type_name, text)
        # In ROS 1 a byte is an int8, in ROS 2 an octet.
        return BYTE.sub("int8", schema) if schema is text else schema

    def _ros2_types(self) -> "Typestore":
        """Return the bag's types with the ROS 2 header, to which rosbags converts the ROS 1 header."""
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

        header = get_typestore(Stores.ROS2_HUMBLE).fielddefs[Header.type_name]
        types = get_typestore(Stores.EMPTY)
        types.register({**self._reader.typestore.fielddefs, Header.type_name: header})
        return types

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._reader.close()


class _Ros2Bag(Ros2Bag):
    """An open bag of ROS 2 with what the new log says about its topics."""

    def __init__(self, path: Path, balance: Balance):
        super().__init__(path, balance)
        try:
            self._types = Ros2Types(self.topics, self.distribution)
        except BagUnreadable:
            self.close()
            raise
        self._robot_keys = _robot_keys(self.topics)
        self._channels: dict[BagTopic, NewChannel | BagUnreadable] = {}
        self._stock = stock_registry()

    def channel(self, topic: BagTopic) -> NewChannel:
        """Return the new channel for a topic."""
        if topic not in self._channels:
            try:
                schema = _our_schema(self._stock, topic.type_name, self._types.schema(topic))
                self._channels[topic] = NewChannel(topic.name, topic.type_name, schema)
            except BagUnreadable as error:
                self._channels[topic] = error
        found = self._channels[topic]
        if isinstance(found, BagUnreadable):
            raise found
        return found

    def about(self, topic: BagTopic) -> dict[str, str]:
        """Return the metadata of the new channel for a topic."""
        key = self._robot_keys.get(topic.name)
        return (key.metadata() if key else {}) | ({LATCHED_KEY: "1"} if self.is_latched(topic) else {})

    def cdr(self, topic: BagTopic, data: bytes) -> bytes:
        """Return a message as little-endian CDR."""
        return data if data[:2] == LITTLE_ENDIAN else self._types.little_endian(topic, data)


def _robot_keys(topics: Iterable[BagTopic]) -> dict[str, ChannelKey]:
    """Return what the robot called the topics of a bag of `robbie export`, by their names there."""
    keys: dict[str, set[ChannelKey]] = {}
    for topic in topics:
        about = dict(topic.about)
        if TOPIC_KEY in about and about.get(VERSION_KEY, "").isdecimal():
            key = ChannelKey(topic.type_name, int(about[VERSION_KEY]), about[TOPIC_KEY], "")
            keys.setdefault(topic.name, set()).add(key)
    return {name: found.pop() for name, found in keys.items() if len(found) == 1}


def _without_slashes(type_name: str, schema: str) -> Rename:
    """Return the function that removes the slash that ROS 1 puts before names of frames."""
    try:
        message_type = message_type_from_schema(type_name, schema, 1)
    except SchemaError:  # such messages stay as they are
        return unchanged
    return renamer(message_type, without_slash, is_only_slash=True)


def _our_schema(stock: TypeRegistry, type_name: str, schema: str) -> str:
    """Return our schema of a type if we have one with the same layout, else the given one."""
    if type_name not in stock:
        return schema
    ours = stock.get(type_name)
    return schema_text(ours) if has_layout(ours, schema) else schema
