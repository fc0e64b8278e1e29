"""Writes the constructor, which ensures that every existing message can be encoded.

It also converts values to what a decoder returns (a float32 field holds a float32 value, an integer is an
`int`), so that publisher and subscriber see the same message.
"""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct

import numpy as np

from robbie_mp.messages.codec.source import Source
from robbie_mp.messages.field_types import Field, Items, MessageLayout, Nested, Numbers, Primitive, Text


def write_constructor(source: Source, layout: MessageLayout) -> None:
    """Append the function `__new__(cls, *, field=default, …)`.

    The lines expect a name `_fit`: given the name of a field and a value it returns what the field can hold,
    or raises a FieldError.
    """
    fields = layout.fields
    blank, final = source.name("_Blank", layout.blank), source.name("_message", layout.final)
    parameters = [f"{field.name}={source.name('_default', field.default)}" for field in fields]
    with source.block(f"def __new__({', '.join(['_cls', *(['*', *parameters] if fields else [])])}):"):
        _write_scalars(source, [f for f in fields if isinstance(f.type, Primitive) and f.type.name != "bool"])
        for field in fields:
            _write_check(source, field)
        source.line(f"self = {blank}()")
        for field in fields:
            source.line(f"self.{field.name} = {field.name}")
        source.line(f"self.__class__ = {final}")
        source.line("return self")


def _write_check(source: Source, field: Field) -> None:
    """Append the check of one field; only a value that fails the fast check gets the slow one."""
    fit = f'{field.name} = _fit("{field.name}", {field.name})'
    if isinstance(field.type, Items):
        source.line(fit)
    elif doubt := _doubt(source, field):
        with source.block(f"if {doubt}:"):
            source.line(fit)


def _write_scalars(source: Source, fields: Sequence[Field]) -> None:
    """Append the check of all numbers at once: pack them and unpack them again."""
    if not fields:
        return
    scalars = Struct("<" + "".join(field.type.code for field in fields if isinstance(field.type, Primitive)))
    pack, unpack = source.name("_pack_scalars", scalars.pack), source.name("_unpack_scalars", scalars.unpack)
    names = ", ".join(field.name for field in fields) + ("," if len(fields) == 1 else "")
    with source.block("try:"):
        source.line(f"{names} = {unpack}({pack}({names}))")
    with source.block("except _Exception:"):
        for field in fields:
            source.line(f'{field.name} = _fit("{field.name}", {field.name})')


def _doubt(source: Source, field: Field) -> str:
    """Return the condition under which a value needs the slow check; "" if it has been checked."""
    name, kind = field.name, field.type
    match kind:
        case Primitive(name="bool"):
            return f"{name} is not True and {name} is not False"
        case Text():
            too_long = "" if kind.max_length is None else f" or _len({name}) > {kind.max_length}"
            return f'_type({name}) is not _str or not {name}.isascii() or "\\0" in {name}{too_long}'
        case Nested():
            return f"_type({name}) is not {source.name(f'_{kind.message.__name__}', kind.message)}"
        case Numbers():
            dtype = source.name(f"_{kind.element}", kind.element.dtype)
            array = source.name("_ndarray", np.ndarray)
            if kind.length is not None:
                shape = f"{name}.shape != ({kind.length},)"
            else:  # one stride of one element: one-dimensional and without gaps; an empty array has stride 0
                shape = f"({name}.strides != ({kind.element.size},) and {name}.shape != (0,))"
            too_long = "" if kind.max_length is None else f" or _len({name}) > {kind.max_length}"
            return f"_type({name}) is not {array} or {name}.dtype is not {dtype} or {shape}{too_long}"
        case _:
            return ""
