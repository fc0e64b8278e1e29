"""The messages of a channel as a Parquet file, made by the library Apache Arrow."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, BinaryIO

import numpy as np

from robbie_mp.base.extras import how_to_install
from robbie_mp.logs.recording.errors import LogError
from robbie_mp.messages import Message
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers, Primitive, Text
from robbie_mp.messages.message import fields_of, nested

TIME, SEQUENCE = "time_ns", "sequence"
"""The first two columns. A field of the same name becomes `message.time_ns` or `message.sequence`."""
GROUP_BYTES, MAX_ROWS = 1 << 25, 1 << 16
"""A row group is written once it reaches either limit. Until then, its messages are in memory."""
UNIT = "unit"
"""The key under which a column's metadata has its unit."""
Values = list[Any]
Column = tuple[str, str, FieldType, Callable[[Values], Values]]
"""The column's name, its field's name in Python and type, and what gets its values from messages."""


class NotParquet(LogError, ImportError):
    """Parquet files cannot be written.

    Example scenarios:
      - Apache Arrow is not installed
    """


class ParquetLibrary:
    """Converts fields to arrays of Apache Arrow.

    Raises:
        NotParquet: Apache Arrow is not installed.
    """

    def __init__(self) -> None:
        try:
            import pyarrow  # noqa: PLC0415 - an extra
            import pyarrow.parquet  # noqa: PLC0415
        except ImportError as error:
            raise NotParquet(
                f"Parquet files need the extra `parquet`: {how_to_install('parquet')}"
            ) from error
        self.arrow: Any = pyarrow

    def kind(self, kind: FieldType) -> Any:
        """Return Arrow's type for a type of field."""
        arrow = self.arrow
        match kind:
            case Primitive():
                return arrow.from_numpy_dtype(kind.dtype)
            case Text():
                return arrow.string()
            case Nested():
                inner = [(one.schema_name, self.kind(one.type)) for one in fields_of(kind.message)]
                return arrow.struct(inner) if inner else arrow.null()  # Parquet has no empty structure
            case Numbers(length=None) if kind.element.dtype == np.uint8:
                return arrow.binary()
            case Numbers(length=int(length)):
                return arrow.list_(self.kind(kind.element), length)
            case _:
                return arrow.list_(self.kind(kind.element))

    def array(self, kind: FieldType, values: Values) -> Any:
        """Return the values of a field, one for each message, as an Arrow array."""
        arrow, made = self.arrow, self.kind(kind)
        if isinstance(kind, Nested):
            return self._structures(kind, values)
        if isinstance(kind, Primitive | Text):
            return arrow.array(values, made)
        if arrow.types.is_binary(made):
            return arrow.array([value.tobytes() for value in values], made)
        if isinstance(kind, Items):
            inside = self.array(kind.element, [item for value in values for item in value])
        else:
            elements = np.concatenate([np.empty(0, kind.element.dtype), *values])
            inside = arrow.array(elements, made.value_type)
        if arrow.types.is_fixed_size_list(made):
            return arrow.FixedSizeListArray.from_arrays(inside, type=made)
        return arrow.ListArray.from_arrays(_offsets(values), inside)

    def _structures(self, kind: Nested, values: Values) -> Any:
        """Return nested messages as an Arrow array of structures."""
        fields, made = fields_of(kind.message), self.kind(kind)
        if not fields:
            return self.arrow.nulls(len(values))
        inner = [self.array(one.type, [getattr(value, one.name) for value in values]) for one in fields]
        return self.arrow.StructArray.from_arrays(inner, fields=list(made))


def _offsets(values: Values) -> "np.ndarray[Any, Any]":
    """Return the index of each list's first element in the joined lists, and their total length."""
    return np.cumsum([0, *map(len, values)]).astype(np.int32)


class ParquetTable:
    """Writes messages of one type as rows: time, sequence number, and a column for each field.

    Messages inside messages become columns of dotted names, such as `header.stamp.sec`; lists of messages are
    lists of structures, and sequences of bytes are binary. Use it in a `with` statement.

    Args:
        library: the library.
        message_type: the type.
        file: the new file.
        units: the units of fields by name, which their columns have as metadata.
    """

    def __init__(
        self, library: ParquetLibrary, message_type: type[Message], file: BinaryIO, units: Mapping[str, str]
    ):
        self._library = library
        self._columns = list(_columns(nested(message_type), "", "", list))
        arrow = library.arrow
        fields = [
            arrow.field(
                f"message.{name}" if name in (TIME, SEQUENCE) else name,
                library.kind(kind),
                metadata={UNIT: units[field]} if field in units else None,
            )
            for name, field, kind, _ in self._columns
        ]
        stamps = [arrow.field(TIME, arrow.int64()), arrow.field(SEQUENCE, arrow.uint32())]
        self._schema = arrow.schema([*stamps, *fields])
        self._writer = arrow.parquet.ParquetWriter(file, self._schema)
        self._rows: list[tuple[int, int, Message]] = []
        self._bytes = 0

    def add(self, time_ns: int, sequence: int, message: Message, message_bytes: int) -> None:
        """Add a message, whose encoding has `message_bytes` bytes."""
        self._rows.append((time_ns, sequence, message))
        self._bytes += message_bytes
        if self._bytes >= GROUP_BYTES or len(self._rows) == MAX_ROWS:
            self._write_group()

    def __enter__(self) -> "ParquetTable":
        """Return itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Write what is left, unless there was an error, and the end of the file."""
        try:
            if self._rows and kind is None:
                self._write_group()
            self._writer.close()
        finally:
            self._writer.is_open = False  # after a failure, its destructor would close it again

    def _write_group(self) -> None:
        times, sequences, messages = map(list, zip(*self._rows, strict=True))
        found = [self._library.array(kind, values(messages)) for _, _, kind, values in self._columns]
        arrow = self._library.arrow
        stamps = [arrow.array(times, arrow.int64()), arrow.array(sequences, arrow.uint32())]
        self._writer.write_table(arrow.table([*stamps, *found], schema=self._schema))
        self._rows, self._bytes = [], 0


def _columns(
    kind: FieldType, name: str, field: str, values: Callable[[Iterable[Any]], Values]
) -> Iterable[Column]:
    """Yield the columns that a field becomes: one, or for a nested message those of its fields."""
    if not isinstance(kind, Nested):
        yield name, field, kind, values
        return
    for one in fields_of(kind.message):

        def inner(messages: Iterable[Any], attribute: str = one.name) -> Values:
            return [getattr(value, attribute) for value in values(messages)]

        yield from _columns(
            one.type,
            f"{name}.{one.schema_name}" if name else one.schema_name,
            f"{field}.{one.name}" if field else one.name,
            inner,
        )
