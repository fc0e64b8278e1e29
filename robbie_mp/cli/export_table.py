"""The messages of a channel as rows of numbers and texts, with their arrays in numpy files."""

from collections.abc import Callable, Iterator
from operator import attrgetter
from typing import Any, BinaryIO

import numpy as np

from robbie_mp.attached.views.message_text import FieldPath, to_json
from robbie_mp.logs.recording.columns import LENGTHS
from robbie_mp.messages import Message
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers
from robbie_mp.messages.message import fields_of, nested

MAX_COLUMNS = 64
"""Elements of an array of fixed length that are columns; a longer one is in a file."""


class ArrayFile:
    """A numpy file that grows: the elements of the arrays of all messages, one after the other.

    Args:
        file: the new file.
        kind: the type of the arrays.
    """

    def __init__(self, file: BinaryIO, kind: Numbers):
        self._file, self._dtype = file, kind.element.dtype
        self._row = () if kind.length is None else (kind.length,)
        self._count = 0
        self.finish()

    def add(self, array: "np.ndarray[Any, Any]") -> None:
        """Write an array."""
        self._file.write(np.ascontiguousarray(array, self._dtype).data)
        self._count += 1 if self._row else len(array)

    def finish(self) -> None:
        """Write the header; numpy leaves room in it for any count."""
        self._file.seek(0)
        about = {"descr": self._dtype.str, "fortran_order": False, "shape": (self._count, *self._row)}
        np.lib.format.write_array_header_1_0(self._file, about)


class ChannelTable:
    """Turns messages of a type into rows.

    Args:
        message_type: the type.
        opened: opens a new file for the array of that name.

    Attributes:
        names: of the columns, each with the name of the field whose unit it has; "" if it has none.
    """

    def __init__(self, message_type: type[Message], opened: Callable[[str], BinaryIO]):
        self.names: list[tuple[str, str]] = []
        self._cells: list[Callable[[Message], list[Any]]] = []
        self._arrays: list[ArrayFile] = []
        for name, kind in _fields(nested(message_type), ""):
            if not isinstance(kind, Numbers):
                self._add_cell(message_type, name, kind)
            elif kind.length is not None and kind.length <= MAX_COLUMNS:
                self._add_columns(name, kind.length)
            else:
                self._add_array(name, kind, ArrayFile(opened(name), kind))

    def row(self, message: Message) -> list[Any]:
        """Return the cells of a message, and write its arrays."""
        return [cell for cells in self._cells for cell in cells(message)]

    def finish(self) -> None:
        """Finish the files of the arrays."""
        for array in self._arrays:
            array.finish()

    def _add_cell(self, message_type: type[Message], name: str, kind: FieldType) -> None:
        field = FieldPath(message_type, name)
        self.names.append((name, name))
        if isinstance(kind, Items):
            self._cells.append(lambda message: [to_json(field.value(message))])
        else:
            self._cells.append(lambda message: [field.value(message)])

    def _add_columns(self, name: str, length: int) -> None:
        value = attrgetter(name)
        self.names += [(f"{name}[{index}]", name) for index in range(length)]
        self._cells.append(lambda message: list(value(message).tolist()))

    def _add_array(self, name: str, kind: Numbers, file: ArrayFile) -> None:
        value = attrgetter(name)
        self._arrays.append(file)
        if kind.length is None:
            self.names.append((name + LENGTHS, ""))

        def write(message: Message) -> list[Any]:
            array = value(message)
            file.add(array)
            return [] if kind.length else [len(array)]

        self._cells.append(write)


def _fields(kind: FieldType, name: str) -> Iterator[tuple[str, FieldType]]:
    if isinstance(kind, Nested):
        for field in fields_of(kind.message):
            yield from _fields(field.type, f"{name}.{field.name}" if name else field.name)
    else:
        yield name, kind
