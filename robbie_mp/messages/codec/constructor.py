"""Makes the constructor, which ensures that every existing message can be encoded.

It also converts values to what a decoder returns (a float32 field holds a float32 value, an integer is an
`int`), so that publisher and subscriber see the same message.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from struct import Struct
from struct import error as StructError
from typing import Any

import numpy as np

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages.errors import UnknownField
from robbie_mp.messages.field_types import Field, FieldType, MessageLayout, Nested, Numbers, Primitive, Text
from robbie_mp.messages.fitting import fit

PLAIN = frozenset((int, float, bool, np.float64, np.float32))
"""Types of numbers that `struct` packs as what they are; others may lose a part of themselves."""
Values = dict[str, Any]
Named = Iterable[tuple[str, Any]]


def constructor(layout: MessageLayout) -> Callable[..., Any]:
    """Return the function `__new__(cls, *, field=default, …)`."""
    defaults = {field.name: field.default for field in layout.fields}
    fit_numbers = _number_fitter(layout, [field for field in layout.fields if _is_number(field)])
    others = [(field, field.name, _holder(field.type)) for field in layout.fields if not _is_number(field)]
    blank, final = layout.blank, layout.final

    def __new__(_cls: type[Any], /, **given: Any) -> Any:
        values = {**defaults, **given}
        if len(values) > len(defaults):
            raise _unknown(final, given.keys() - defaults.keys(), defaults)
        self = blank()
        for name, value in fit_numbers(values):
            setattr(self, name, value)
        for field, name, holds in others:
            value = values[name]
            setattr(self, name, value if holds(value) else _fitted(layout, field, value))
        self.__class__ = final
        return self

    return __new__


def _unknown(message_type: type[Any], names: set[str], known: Iterable[str]) -> UnknownField:
    """Return the error that Python raises for arguments of other names, and the names that there are."""
    name = min(names)
    near = did_you_mean(name, known) or f"; its fields are {', '.join(known)}"
    return UnknownField(f"{message_type.__qualname__}() got an unexpected keyword argument {name!r}{near}")


def _is_number(field: Field) -> bool:
    return isinstance(field.type, Primitive) and field.type.name != "bool"


def _fitted(layout: MessageLayout, field: Field, value: Any) -> Any:
    return fit(f"{layout.type_name}.{field.schema_name}", field.type, value)


def _number_fitter(layout: MessageLayout, fields: Sequence[Field]) -> Callable[[Values], Named]:
    """Return what converts all numbers of a message at once: it packs them and unpacks them again."""
    names = [field.name for field in fields]
    together = Struct("<" + "".join(f.type.code for f in fields if isinstance(f.type, Primitive)))
    pack, unpack = together.pack, together.unpack

    def fit_numbers(values: Values) -> Named:
        given = [values[name] for name in names]
        try:
            if PLAIN.issuperset(map(type, given)):
                return zip(names, unpack(pack(*given)), strict=True)
        except (StructError, OverflowError):
            pass
        return [(field.name, _fitted(layout, field, values[field.name])) for field in fields]

    return fit_numbers if fields else lambda values: ()


def _holder(kind: FieldType) -> Callable[[Any], bool]:
    """Return a fast check of whether a field can hold a value as it is; False: it needs a closer look."""
    match kind:
        case Primitive():
            return lambda value: value is True or value is False
        case Text(max_length=limit):
            return lambda value: (
                type(value) is str
                and value.isascii()
                and "\0" not in value
                and (limit is None or len(value) <= limit)
            )
        case Nested(layout=layout):
            return lambda value: type(value) is layout.final
        case Numbers():
            return _array_holder(kind)
        case _:
            return lambda value: False


def _array_holder(kind: Numbers) -> Callable[[Any], bool]:
    dtype, length, limit, stride = kind.element.dtype, kind.length, kind.max_length, (kind.element.size,)

    def holds(value: Any) -> bool:
        if type(value) is not np.ndarray or value.dtype is not dtype:
            return False
        if length is not None:
            return bool(value.shape == (length,))
        # One stride of one element: one-dimensional and without gaps; an empty array has stride 0.
        return (value.strides == stride or value.shape == (0,)) and (limit is None or len(value) <= limit)

    return holds
