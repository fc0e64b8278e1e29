"""Message types as text, for programs that cannot import the classes, and classes made from such texts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages import schema_parser
from robbie_mp.messages.calls import GOAL_SUFFIX, REQUEST_SUFFIX
from robbie_mp.messages.errors import UnknownType
from robbie_mp.messages.message import Message
from robbie_mp.messages.registry import full_name
from robbie_mp.messages.schema import schema_text
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.messages.stock.registry import stock_registry


class TypeDescription(NamedTuple):
    """A message type as text."""

    name: str
    version: int
    schema: str
    """Its ros2msg text, with the texts of the types in it."""
    python_module: str = ""
    """Where its class is declared; '' if only its text is known."""

    @classmethod
    def of(cls, message_type: type[Message]) -> TypeDescription:
        """Describe a class."""
        name, version = message_type.type_name, message_type.version
        return cls(name, version, schema_text(message_type), message_type.__module__)


def own_types() -> list[TypeDescription]:
    """Describe all message types that this process has declared so far, except the stock types."""
    return [TypeDescription.of(one) for one in own_classes()]


def own_classes(*, all_of_a_name: bool = False) -> list[type[Message]]:
    """Return all message classes that this process has declared so far, except the stock types.

    Args:
        all_of_a_name: also those whose name has been declared again later.
    """
    stock = set(stock_registry())
    own = [
        one for one in _subclasses(Message) if one not in stock and one.__module__ != schema_parser.__name__
    ]
    return own if all_of_a_name else [one for _, one in sorted({one.type_name: one for one in own}.items())]


def _subclasses(message_type: type[Message]) -> Iterator[type[Message]]:
    for one in message_type.__subclasses__():
        if getattr(one, "type_name", ""):
            yield one
        yield from _subclasses(one)


class KnownTypes:
    """The stock types, and a robot's types given by their descriptions.

    Args:
        descriptions: the robot's own types; of one with several versions, the newest goes by the name.
    """

    def __init__(self, descriptions: Iterable[TypeDescription] = ()):
        self._stock = stock_registry()
        own = [one for one in descriptions if one.name not in self._stock]
        self._own = {one.name: one for one in sorted(own, key=lambda one: one.version)}
        self._versions = {(one.name, one.version): one.schema for one in own}

    def names(self) -> list[str]:
        """All names, in full, sorted."""
        return sorted([*self._own, *(one.type_name for one in self._stock)])

    def find(self, name: str) -> str:
        """Return the full name of a type; `name` is full, or `package/Type`, or only `Type`.

        Raises:
            UnknownType: there is no such type, or there are several.
        """
        names = self.names()
        full = full_name(name)
        if full in names:
            return full
        same = [
            known for known in names if known.rpartition("/")[2].lower() == full.rpartition("/")[2].lower()
        ]
        if "/" not in name and len(same) == 1:
            return same[0]
        if not same and "/" not in name:
            names = [known.rpartition("/")[2] for known in names]
            full = name
        near = f"; did you mean {' or '.join(map(repr, same))}?" if same else did_you_mean(full, names)
        raise UnknownType(f"no message type is called {name!r}{near}")

    def find_request(self, service: str) -> str:
        """Return the full name of the type of a service's requests, or of an action's goals.

        Args:
            service: type of the service: `package/srv/Name`, `package/Name` or `Name`; for an action, with
                `action` instead of `srv`.

        Raises:
            UnknownType: no service has this type, or several do.
        """
        bases = {
            name: name.removesuffix(suffix)
            for name in self.names()
            for suffix, folder in ((REQUEST_SUFFIX, "srv"), (GOAL_SUFFIX, "action"))
            if name.endswith(suffix) and f"/{folder}/" in name
        }
        for shape in (str, _short, _last):
            found = [name for name, base in bases.items() if shape(base) == service]
            if len(found) == 1:
                return found[0]
            if found:
                raise UnknownType(f"{service!r} may be {' or '.join(bases[name] for name in found)}")
        near = did_you_mean(service, [_last(base) for base in bases.values()])
        raise UnknownType(f"no module of this robot declares a service {service!r}{near}")

    def describe(self, name: str) -> TypeDescription:
        """Return the description of a type; names as for `find`."""
        found = self.find(name)
        return self._own.get(found) or TypeDescription.of(self._stock.get(found))

    def schema(self, name: str, version: int) -> str | None:
        """Return the ros2msg text of a version of a type; None if it is not known.

        Args:
            name: in full.
            version: the version.
        """
        if name not in self._stock:
            return self._versions.get((name, version))
        stock = self._stock.get(name)
        return schema_text(stock) if stock.version == version else None

    def get(self, name: str, version: int | None = None) -> type[Message]:
        """Return the class of a type; for a robot's type, a class made from its description.

        Args:
            name: as for `find`.
            version: the version of the class; None: the newest.

        Raises:
            UnknownType: as for `find`, or this version is not known.
            SchemaError: the description is not understood.
        """
        found = self.find(name)
        newest = self.describe(found).version
        if version not in (None, newest):
            if schema := self._versions.get((found, version)):
                return message_type_from_schema(found, schema, version)
            raise UnknownType(f"version {version} of {found} is not known here, only version {newest}")
        if own := self._own.get(found):
            return message_type_from_schema(own.name, own.schema, own.version)
        return self._stock.get(found)


def _short(base: str) -> str:
    return base.replace("/srv/", "/").replace("/action/", "/")


def _last(base: str) -> str:
    return base.rpartition("/")[2]
