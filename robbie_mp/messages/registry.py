"""Message types by name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages.errors import DuplicateType, UnknownType
from robbie_mp.messages.message import Message
from robbie_mp.messages.schema import nested_types, schema_text


class TypeRegistry:
    """Knows message types by their ROS names.

    Args:
        message_types: the types that it knows from the start, with the types nested in them.
    """

    def __init__(self, message_types: Iterable[type[Message]] = ()):
        self._types: dict[str, type[Message]] = {}
        for message_type in message_types:
            self.add(message_type)

    def add(self, message_type: type[Message]) -> None:
        """Add a type and the types nested in it.

        Raises:
            DuplicateType: another type with this name has other fields or another version.
        """
        for one in (message_type, *nested_types(message_type)):
            known = self._types.setdefault(one.type_name, one)
            if known is not one and (known.version, schema_text(known)) != (one.version, schema_text(one)):
                raise DuplicateType(
                    f"{one.type_name}: {one.__module__}.{one.__qualname__} (version {one.version}) is not "
                    f"{known.__module__}.{known.__qualname__} (version {known.version}) of that name"
                )

    def get(self, name: str) -> type[Message]:
        """Return the type of a name such as `sensor_msgs/msg/LaserScan`, or short `sensor_msgs/LaserScan`.

        Raises:
            UnknownType: there is no such type.
        """
        found = self._types.get(full_name(name))
        if found is None:
            near = did_you_mean(full_name(name), self._types) or self._same_last_part(name)
            raise UnknownType(f"no message type is called {name!r}{near}")
        return found

    def _same_last_part(self, name: str) -> str:
        last_part = name.rpartition("/")[2].lower()
        same = [known for known in self._types if known.rpartition("/")[2].lower() == last_part]
        return f"; did you mean {' or '.join(map(repr, same))}?" if same else ""

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and full_name(name) in self._types

    def __iter__(self) -> Iterator[type[Message]]:
        return iter(self._types.values())

    def __len__(self) -> int:
        return len(self._types)


def full_name(name: str) -> str:
    """Return the full form of a type name: `std_msgs/msg/Header` for `std_msgs/Header`."""
    return name.replace("/", "/msg/") if name.count("/") == 1 else name
