"""The definitions of the types in a bag of ROS 2; the library rosbags knows those that a bag leaves out."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from robbie_mp.logs.recording.errors import BagUnreadable
from robbie_mp.logs.recording.format import MESSAGE_ENCODING, SCHEMA_ENCODING
from robbie_mp.logs.recording.ros2_bag import BagTopic
from robbie_mp.messages.service_events import describes_service, event_schema, is_event_type

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore

LITTLE_ENDIAN, BIG_ENDIAN = b"\0\1", b"\0\0"
IDL_ENCODINGS = ("ros2idl", "omgidl")
IDL_SEPARATOR = f"{'=' * 80}\n"
USUAL = "ros2_humble"
"""The distribution of a bag that does not say it: the last one whose bags may have no definitions."""


@contextmanager
def needing_rosbags() -> Iterator[None]:
    """Say how to install the library if an import in this context fails."""
    try:
        yield
    except ImportError as error:
        raise BagUnreadable("reading bags needs the library rosbags: pip install rosbags") from error


class Ros2Types:
    """The types of a bag.

    Args:
        topics: what the bag says about them.
        distribution: of the bag; "" if it does not say.

    Raises:
        BagUnreadable: the library is missing.
    """

    def __init__(self, topics: Iterable[BagTopic], distribution: str):
        with needing_rosbags():
            from rosbags import typesys  # noqa: PLC0415 - an extra
        self._typesys = typesys
        self._distribution = f"ros2_{distribution}"
        self._stores: dict[BagTopic, Typestore] = {}
        """Types of topics with big-endian messages."""
        self._schemas: dict[str, str] = {}
        """Definitions in the bag, by type."""
        for topic in topics:
            if topic.form == SCHEMA_ENCODING and topic.definition and not is_event_type(topic.type_name):
                self._schemas.setdefault(topic.type_name, topic.definition)

    def schema(self, topic: BagTopic) -> str:
        """Return the ros2msg text of a topic's type.

        Raises:
            BagUnreadable: there is none, or it is not understood, or the messages are not CDR.
        """
        if topic.encoding != MESSAGE_ENCODING:
            raise BagUnreadable(f"messages of {topic.name}, whose encoding is {topic.encoding!r}, not CDR")
        try:
            return self._schema(topic)
        except BagUnreadable:
            raise
        except Exception as error:  # the library raises arbitrary errors for wrong definitions
            raise BagUnreadable(
                f"messages of {topic.name}, whose type's definition is not understood: {error}"
            ) from error

    def _schema(self, topic: BagTopic) -> str:
        is_event = is_event_type(topic.type_name)
        if is_event and describes_service(topic.definition or ""):
            return event_schema(topic.type_name, topic.definition or "")
        has_fields = is_event or self._known(topic.type_name) is not None
        if topic.form == SCHEMA_ENCODING and (topic.definition or not has_fields):
            return topic.definition or ""
        if topic.form in IDL_ENCODINGS and topic.definition:
            return self._from_idl(topic.type_name, topic.definition)
        return self._schemas.get(topic.type_name) or self._stored(topic)

    def _from_idl(self, type_name: str, text: str) -> str:
        found: Typesdict = {}
        for part in text.split(IDL_SEPARATOR):
            if part.strip():
                body = part.partition("\n")[2] if part.startswith("IDL: ") else part
                found.update(self._typesys.get_types_from_idl(body))
        return _text(self._store_of(found), type_name)

    def _store_of(self, types: "Typesdict") -> "Typestore":
        store = self._typesys.get_typestore(self._typesys.Stores.EMPTY)
        store.register(types)
        return store

    def _stored(self, topic: BagTopic) -> str:
        store = self._known(topic.type_name)
        if store is None:
            raise BagUnreadable(f"messages of {topic.name}, whose type is not known")
        return _text(store, topic.type_name)

    def _known(self, type_name: str) -> "Typestore | None":
        """Return the types of a distribution that has the type: the bag's, the usual one, or the newest."""
        stores = list(self._typesys.Stores)
        wanted = [one for name in (self._distribution, USUAL) for one in stores if one.value == name]
        others = [one for one in reversed(stores) if one.value.startswith("ros2_")]
        for store in map(self._typesys.get_typestore, (*wanted, *others)):
            if type_name in store.fielddefs:
                return store
        return None

    def little_endian(self, topic: BagTopic, data: bytes) -> bytes:
        """Return a big-endian message as little-endian CDR.

        Raises:
            BagUnreadable: it is no such message.
        """
        name = topic.type_name
        if data[:2] != BIG_ENDIAN:
            raise BagUnreadable(f"messages of {topic.name} in another encoding than CDR: {data[:2].hex()}")
        try:
            if topic not in self._stores:
                types = self._typesys.get_types_from_msg(self.schema(topic), name)
                self._stores[topic] = self._store_of(types)
            store = self._stores[topic]
            message = store.deserialize_cdr(data, name)
            return bytes(store.serialize_cdr(message, name, little_endian=True))
        except Exception as error:
            raise BagUnreadable(f"messages of {topic.name} that are no {name}") from error


def _text(store: "Typestore", type_name: str) -> str:
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    return str(text)
