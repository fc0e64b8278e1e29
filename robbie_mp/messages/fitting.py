"""Converts a value to the type of a field, or raises an error that says why it cannot.

Constructors handle the common cases themselves and call this for the others.
"""

from __future__ import annotations

import math
import operator
import reprlib
from collections.abc import Sequence
from struct import Struct
from struct import error as StructError
from typing import Any

import numpy as np

from robbie_mp.messages.errors import FieldError, FieldTypeError, FieldValueError
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers, Primitive, Text


def fit(path: str, kind: FieldType, value: Any) -> Any:
    """Return `value` converted to the type of a field.

    Args:
        path: message type and field, for the error text.
        kind: the field's type.
        value: the given value.

    Raises:
        FieldTypeError: the value has a type that the field cannot hold.
        FieldValueError: the value is out of range, too long, or of the wrong shape.
    """
    match kind:
        case Primitive():
            return _fit_primitive(path, kind, value)
        case Text():
            return _fit_text(path, kind, value)
        case Nested():
            if type(value) is not kind.message:
                raise wrong_type(path, f"a {kind.message.__name__}", value)
            return value
        case Numbers():
            return _fit_numbers(path, kind, value)
        case Items():
            return _fit_items(path, kind, value)


def wrong_type(path: str, expected: str, value: Any) -> FieldError:
    """Return the error for a value of another type."""
    return FieldTypeError(f"{path}: expected {expected}, got {reprlib.repr(value)} ({type(value).__name__})")


def _fit_primitive(path: str, kind: Primitive, value: Any) -> bool | int | float:
    if kind.name == "bool":
        if not isinstance(value, bool | np.bool_):
            raise wrong_type(path, "a bool", value)
        return bool(value)
    is_float = kind.code in "fd"
    try:
        _check_scalar(value)
        given = _float(value) if is_float else operator.index(value)
    except OverflowError:
        raise FieldValueError(f"{path}: {reprlib.repr(value)} is too large for {kind}") from None
    except Exception as error:  # whatever a value's own __float__ or __index__ raises
        raise wrong_type(path, str(kind), value) from error
    coding = Struct("<" + kind.code)
    try:
        number: int | float = coding.unpack(coding.pack(given))[0]
    except (StructError, OverflowError):
        if is_float:
            raise FieldValueError(f"{path}: {value} is too large for {kind}") from None
        limits = np.iinfo(kind.dtype)
        raise FieldValueError(f"{path}: {kind} is {limits.min} to {limits.max}, got {given}") from None
    return number


def _check_scalar(value: Any) -> None:
    """Raise TypeError if a value of numpy is not one real number, although Python would convert it."""
    if isinstance(value, np.generic | np.ndarray) and (
        value.ndim or value.dtype.kind not in "bfiu" or np.ma.is_masked(value)
    ):
        raise TypeError


def _float(value: Any) -> float:
    """Return a value as a float.

    Raises:
        TypeError: it is no number; or whatever it raises itself.
        OverflowError: it is finite and too large.
    """
    number = float(value) if hasattr(value, "__float__") else operator.index(value)
    if math.isinf(number) and value != number:
        raise OverflowError
    return number


def _fit_text(path: str, kind: Text, value: Any) -> str:
    if not isinstance(value, str):
        raise wrong_type(path, "a str", value)
    text = str.__str__(value)  # the value itself: `str` of an Enum may be its name
    if "\0" in text:
        raise FieldValueError(
            f"{path}: NUL ends a string in CDR and cannot be inside, got {reprlib.repr(value)}"
        )
    try:
        size = len(text.encode())
    except UnicodeEncodeError as error:
        raise FieldValueError(f"{path}: {reprlib.repr(value)} is not UTF-8: {error.reason}") from None
    _check_length(path, size, kind.max_length, "bytes")
    return text


def _fit_items(path: str, kind: Items, value: Any) -> list[Any]:
    try:
        given = None if isinstance(value, str | bytes) else iter(value)
    except TypeError:  # also of an array without a dimension
        given = None
    if given is None:
        raise wrong_type(path, f"a list for {kind}", value)
    items = [fit(f"{path}[{index}]", kind.element, item) for index, item in enumerate(given)]
    if kind.length is not None and len(items) != kind.length:
        raise FieldValueError(f"{path}: expected {kind.length} elements, got {len(items)}")
    _check_length(path, len(items), kind.max_length, "elements")
    return items


def _fit_numbers(path: str, kind: Numbers, value: Any) -> np.ndarray[Any, Any]:
    array = _as_array(path, kind, value)
    if array.ndim != 1 or (kind.length is not None and array.shape != (kind.length,)):
        expected = "(N,)" if kind.length is None else f"({kind.length},)"
        raise FieldValueError(
            f"{path}: expected an array of shape {expected}, got {array.shape}; see numpy's reshape"
        )
    _check_length(path, len(array), kind.max_length, "elements")
    return np.ascontiguousarray(_cast(path, kind.element, array))


def _as_array(path: str, kind: Numbers, value: Any) -> np.ndarray[Any, Any]:
    if isinstance(value, bytes | bytearray) and kind.element.code == "B":
        return np.frombuffer(value, np.uint8)
    if isinstance(value, bool | int | float | str):
        hint = "; an int as the number of elements works only in a loan" if isinstance(value, int) else ""
        raise FieldTypeError(
            f"{path}: expected an array for {kind}, got {value!r} ({type(value).__name__}){hint}"
        )
    if np.ma.is_masked(value):
        raise FieldValueError(f"{path}: expected an array for {kind}, got one with masked elements")
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise FieldValueError(f"{path}: expected an array for {kind}: {error}") from None
    if array.dtype.kind in ("f", "O") and _has_only_integers(value):
        return _large_integers(path, kind.element, value)
    return array if array.size or array.ndim != 1 else array.astype(kind.element.dtype)


def _has_only_integers(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(type(one) is int for one in value)


def _large_integers(path: str, element: Primitive, value: Sequence[int]) -> np.ndarray[Any, Any]:
    """Return integers as an array that numpy would make floats, or has no type for: 1 and 2^64 - 1."""
    if element.dtype.kind == "f":
        try:
            return np.array(value, np.float64)
        except OverflowError:
            raise FieldValueError(f"{path}: some numbers are too large for {element}") from None
    _check_limits(path, element, min(value), max(value))
    return np.array(value, element.dtype)


ACCEPTED_KINDS = {"b": "b", "i": "iu", "u": "iu", "f": "fiu"}
"""Kinds of numpy arrays that a field of a kind takes: no fractions for integers, only truth for truth."""


def _cast(path: str, element: Primitive, array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    dtype = element.dtype
    if array.dtype == dtype:
        return array
    if array.dtype.kind not in ACCEPTED_KINDS[dtype.kind]:
        raise FieldTypeError(f"{path}: expected an array of {element}, got one of {array.dtype}")
    if dtype.kind in "iu" and array.size:
        _check_limits(path, element, int(array.min()), int(array.max()))
    try:
        with np.errstate(over="raise"):
            return array.astype(dtype)
    except FloatingPointError:
        raise FieldValueError(f"{path}: some numbers are too large for {element}") from None


def _check_limits(path: str, element: Primitive, low: int, high: int) -> None:
    limits = np.iinfo(element.dtype)
    if low < limits.min or high > limits.max:
        raise FieldValueError(f"{path}: {element} is {limits.min} to {limits.max}, got {low} to {high}")


def _check_length(path: str, length: int, limit: int | None, unit: str) -> None:
    if limit is not None and length > limit:
        raise FieldValueError(f"{path}: at most {limit} {unit} fit, got {length}")
