"""The names that declare fields: `float32`, `uint8`, …, and `Array[float32]`.

A type checker sees them as `float`, `int`, `bool` and `numpy.ndarray`; a message class reads the encoding
from them. Plain `bool` and `str` can be used directly.
"""

from __future__ import annotations

from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages.errors import DeclarationError
from robbie_mp.messages.field_types import Numbers, Primitive

bool_ = Annotated[bool, Primitive("bool", "?", 1, False)]
byte = Annotated[int, Primitive("byte", "B", 1, 0)]
char = Annotated[int, Primitive("char", "B", 1, 0)]
int8 = Annotated[int, Primitive("int8", "b", 1, 0)]
uint8 = Annotated[int, Primitive("uint8", "B", 1, 0)]
int16 = Annotated[int, Primitive("int16", "h", 2, 0)]
uint16 = Annotated[int, Primitive("uint16", "H", 2, 0)]
int32 = Annotated[int, Primitive("int32", "i", 4, 0)]
uint32 = Annotated[int, Primitive("uint32", "I", 4, 0)]
int64 = Annotated[int, Primitive("int64", "q", 8, 0)]
uint64 = Annotated[int, Primitive("uint64", "Q", 8, 0)]
float32 = Annotated[float, Primitive("float32", "f", 4, 0.0)]
float64 = Annotated[float, Primitive("float64", "d", 8, 0.0)]

PRIMITIVES: dict[str, Primitive] = {
    get_args(alias)[1].name: get_args(alias)[1]
    for alias in (
        bool_, byte, char, int8, uint8, int16, uint16, int32, uint32, int64, uint64, float32, float64
    )
}  # fmt: skip


def primitive_of(annotation: object) -> Primitive | None:
    """Return the primitive of an annotation such as `float32` or `bool`; None if it has none."""
    if annotation is bool:
        return PRIMITIVES["bool"]
    if get_origin(annotation) is Annotated:
        return next((note for note in get_args(annotation)[1:] if isinstance(note, Primitive)), None)
    return None


def spelled(annotation: object) -> str:
    """Return an annotation as its author writes it: `float32 | None`, `Array[uint8]`, `Header`."""
    primitive = primitive_of(annotation)
    if primitive is not None:
        return primitive.name
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _spelled_with_notes(arguments[0], arguments[1:])
    if origin in (Union, UnionType):
        return " | ".join(map(spelled, arguments))
    name = getattr(origin or annotation, "__name__", None)
    if not isinstance(name, str) or origin is Literal:
        return repr(annotation)
    name = "None" if annotation is NoneType else name
    return f"{name}[{', '.join(map(spelled, arguments))}]" if arguments else name


def _spelled_with_notes(plain: object, notes: tuple[Any, ...]) -> str:
    numbers = next((note for note in notes if isinstance(note, Numbers)), None)
    if numbers is None:
        return f"Annotated[{spelled(plain)}, {', '.join(map(repr, notes))}]"
    length = "" if numbers.length is None else f", {numbers.length}"
    return f"Array[{numbers.element}{length}]"


if TYPE_CHECKING:
    from typing_extensions import TypeAliasType, TypeVar

    _Element = TypeVar("_Element")
    _Length = TypeVar("_Length", default=Any)
    # Type checkers see an array; the encoding uses element type and length.
    Array = TypeAliasType("Array", NDArray[Any], type_params=(_Element, _Length))
else:

    class Array:
        """A one-dimensional numpy array of primitives: `Array[float32]`, or `Array[float64, Literal[36]]`.

        With a length it is an array of fixed length. `Array[float64, 36]` means the same, but type checkers
        accept a number in a type only as `Literal`.
        """

        def __class_getitem__(cls, parameters: object) -> object:
            """Return the annotation for arrays of the primitive, of fixed length if one is given."""
            element, length = parameters if isinstance(parameters, tuple) else (parameters, None)
            if get_origin(length) is Literal:
                (length,) = get_args(length)
            primitive = primitive_of(element)
            if primitive is None:
                raise DeclarationError(
                    f"Array[{spelled(element)}]: an array holds a primitive such as float32; "
                    "write list[…] for strings and messages"
                )
            return Annotated[np.ndarray, Numbers(primitive, length)]
