"""Sees to it that all processes of a run mean the same by a version of a message type.

A process that starts again imports the robot's code as it is now. If somebody has changed the fields of a
message meanwhile and left its version, the new process and those that run on would take the same bytes for
different fields.
"""

import logging
import threading
from collections.abc import Iterable
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.messages import Message, SchemaError, schema_parser
from robbie_mp.messages.descriptions import TypeDescription
from robbie_mp.messages.schema import schema_text
from robbie_mp.messages.stock.registry import is_stock
from robbie_mp.messages.versions import layout_difference
from robbie_mp.module.class_check import place_of
from robbie_mp.run.learnt_types import Entry, learn_type, learnt_schema


class ChangedType(RobbieError, TypeError):
    """A class of messages has other fields than the run knows for its name and version.

    Example scenarios:
      - the class was edited while the robot ran, and a module with it was started again
      - a script attaches with an older or newer copy of the robot's code
    """


class DeclaredTypes:
    """The message types of a run, against which a process checks its classes. Any thread may use it.

    Args:
        folder: the run's folder.
        planned: the types in the run's plan.
    """

    def __init__(self, folder: Path, planned: Iterable[Entry]):
        self._folder = folder
        self._known = {(name, version): schema for name, version, schema, _ in planned}
        self._lock = threading.Lock()
        self._log = logging.getLogger("robbie.types")

    def declare(self, message_type: type[Message]) -> None:
        """Check a class that a module is about to exchange; the run learns a type that it does not know.

        Raises:
            ChangedType: the run knows this version of the type with other fields.
        """
        key = message_type.type_name, message_type.version
        if key not in self._known and not is_stock(message_type):
            with self._lock:
                self._learn(message_type)
        self.check(message_type)

    def check(self, message_type: type[Message]) -> None:
        """Check a class that a tool is about to exchange.

        Raises:
            ChangedType: the run knows this version of the type with other fields.
        """
        if flaw := self.flaw(message_type):
            file, line = place_of(message_type)
            raise ChangedType(f"{file}:{line}: {flaw}" if file and line else flaw)

    def flaw(self, message_type: type[Message]) -> str:
        """Return in what a class differs from the type that the run knows; '' if it does not, or is new."""
        name, version = message_type.type_name, message_type.version
        if is_stock(message_type):
            return ""
        schema = self._known.get((name, version))
        if schema is None and (schema := learnt_schema(self._folder, name, version)) is None:
            return ""
        self._known[name, version] = schema
        try:
            difference = layout_difference(message_type, schema)
        except SchemaError as error:  # such as a default that is too long to be read again
            is_same = _declarations(schema) == _declarations(schema_text(message_type))
            difference = "" if is_same else str(error)
        if not difference:
            return ""
        return (
            f"{name}, version {version}, has other fields than in this run: {difference}; raise `version=` "
            "when you change a message, or one nested in it, and declare an upgrade, or restart the robot"
        )

    def _learn(self, message_type: type[Message]) -> None:
        if message_type.__module__ == schema_parser.__name__:
            return  # who made it has learnt it
        try:
            learn_type(self._folder, TypeDescription.of(message_type))
        except OSError as error:
            self._log.warning("recorders and tools do not learn %s: %s", message_type.type_name, error)


def _declarations(schema: str) -> list[list[str]]:
    """Return types and names of the lines of a schema, without the defaults."""
    return [line.split(" ")[:2] for line in schema.split("\n")]
