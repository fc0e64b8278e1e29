"""Checks a plain value, as YAML or JSON holds it, against a declared type and limits."""

import math
import reprlib
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from robbie_mp.base.amount import SIZES, BadAmount, plain_amount
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.stock_robots import stock_path
from robbie_mp.module.secret import Secret, SecretError, read_secret


class ValueMismatch(RobbieError, ValueError):
    """A value does not fit its declaration; the text says what was expected and what was found."""


@dataclass(frozen=True)
class ValueLimits:
    """Limits of a value, besides its type; in lists and maps they apply to every element."""

    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[object, ...] = ()
    must_exist: bool = False
    """A path must name an existing file or folder."""
    finite: bool = True
    """Refuse infinity and not-a-number."""


NO_LIMITS = ValueLimits()


def check_value(
    declared: Any,
    value: object,
    limits: ValueLimits = NO_LIMITS,
    folder: Path | None = None,
    name: str = "",
) -> Any:
    """Return `value` as the declared type: an int becomes a float, a str a path; containers are copied.

    Args:
        declared: bool, int, float, str, Path, Secret, a StrEnum, X | None, list[X] or dict[str, X].
        value: the value as written.
        limits: limits of the value, or of each element.
        folder: relative paths start from this folder; the current directory by default.
        name: of the value; if it ends with a unit, as `period_s`, numbers may be texts such as `20ms`.

    Raises:
        ValueMismatch: the value has another type, or is outside the limits.
        TypeError: `declared` is none of the types above.
    """
    origin, arguments = get_origin(declared), get_args(declared)
    if origin in (Union, UnionType):
        if value is None:
            return None
        return check_value(_without_none(declared), value, limits, folder, name)
    if origin is list:
        if not isinstance(value, list):
            raise _mismatch(describe(declared), value, secret=holds_secret(declared))
        return [
            _element(f"element {index}", arguments[0], element, limits, folder, name)
            for index, element in enumerate(value)
        ]
    if origin is dict:
        if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
            raise _mismatch(describe(declared), value, secret=holds_secret(declared))
        return {
            key: _element(f"key {key!r}", arguments[1], element, limits, folder, name)
            for key, element in value.items()
        }
    if declared in (int, float) and isinstance(value, str):
        value = _number(declared, value, limits, name)
    return _check_scalar(declared, value, limits, folder, name)


def describe(declared: Any) -> str:
    """Return the declared type in words, for an error text.

    Raises:
        TypeError: a value from YAML cannot have the declared type.
    """
    origin, arguments = get_origin(declared), get_args(declared)
    if origin in (Union, UnionType):
        return f"{describe(_without_none(declared))} or null"
    if origin is list:
        return f"list of {describe(arguments[0])}"
    if origin is dict and arguments[0] is str:
        return f"map of str to {describe(arguments[1])}"
    if _is_text_enum(declared):
        return _one_of(tuple(declared))
    if declared is Secret:
        return "secret, as file:PATH or environment:NAME"
    if declared in _SCALARS:
        return "path" if declared is Path else str(declared.__name__)
    raise TypeError(
        f"a setting cannot have the type {declared!r}; use bool, int, float, str, pathlib.Path, Secret, a "
        f"StrEnum, X | None, list[X] or dict[str, X]"
    )


def holds_secret(declared: Any) -> bool:
    """Return whether values of a declared type are or contain secrets."""
    return declared is Secret or any(map(holds_secret, get_args(declared)))


def outline(declared: Any, limits: ValueLimits) -> dict[str, Any]:
    """Return a type and its limits as plain data, for input forms.

    Returns:
        `kind`: bool, int, float, str, path, secret or map; for a list, the kind of its elements.
        `is_list`: whether it is a list. `choices`: all allowed values (of each element); [] for any.
        `minimum`, `maximum`: None if there are none.
    """
    origin, arguments = get_origin(declared), get_args(declared)
    if origin in (Union, UnionType):
        return outline(_without_none(declared), limits)
    if origin is list:
        return outline(arguments[0], limits) | {"is_list": True}
    is_enum = _is_text_enum(declared)
    if origin is dict:
        kind = "map"
    elif is_enum:
        kind = "str"
    else:
        kind = "secret" if declared is Secret else describe(declared)
    choices = [one.value for one in declared] if is_enum else list(limits.choices)
    return {
        "kind": kind,
        "is_list": False,
        "choices": choices,
        "minimum": limits.minimum,
        "maximum": limits.maximum,
    }


def _without_none(declared: Any) -> Any:
    others = [argument for argument in get_args(declared) if argument is not NoneType]
    if len(others) != 1 or len(get_args(declared)) != 2:
        raise TypeError(f"a setting cannot have the type {declared!r}; the only unions are X | None")
    return others[0]


def _element(
    where: str, declared: Any, value: object, limits: ValueLimits, folder: Path | None, name: str
) -> Any:
    try:
        return check_value(declared, value, limits, folder, name)
    except ValueMismatch as mismatch:
        raise ValueMismatch(f"{where}: {mismatch}") from None


def _number(declared: Any, text: str, limits: ValueLimits, name: str) -> object:
    """Return the number that a time or size stands for; the text itself if the name has no such unit."""
    try:
        number = plain_amount(name, text)
    except BadAmount:
        example = "300M" if name.endswith("bytes") else "20ms"
        expected = f"{describe(declared)}{describe_limits(limits, name)}, or with its unit, as in {example}"
        raise _mismatch(expected, text) from None
    if number is None:
        return text
    return int(number) if declared is int and number == int(number) else number


def _check_scalar(declared: Any, value: object, limits: ValueLimits, folder: Path | None, name: str) -> Any:
    if declared is Secret:
        try:
            return read_secret(value, folder)
        except SecretError as error:
            raise ValueMismatch(str(error)) from None
    expected = describe(declared) + describe_limits(limits, name)
    if _is_text_enum(declared):
        if not isinstance(value, str) or value not in list(declared):
            raise _mismatch(expected, value)
        return declared(value)
    if not _SCALARS[declared](value):
        raise _mismatch(expected, value)
    if declared is Path:
        return _check_path(Path(str(value)), limits, folder)
    if declared is float:
        value = _to_float(value, expected)
        if limits.finite and not math.isfinite(value):
            raise _mismatch(f"{expected}, finite", value)
    if isinstance(value, int | float) and not _within(value, limits):
        raise _mismatch(expected, value)
    if limits.choices and value not in limits.choices:
        raise _mismatch(expected, value)
    return value


def _to_float(value: Any, expected: str) -> float:
    try:
        return float(value)
    except OverflowError:
        raise ValueMismatch(f"expected {expected}; got an int that no float can hold") from None


def _check_path(path: Path, limits: ValueLimits, folder: Path | None) -> Path:
    try:
        absolute = (folder or Path.cwd()) / stock_path(path).expanduser()
    except RuntimeError:  # "~name" of nobody
        raise _mismatch("path", str(path)) from None
    try:
        is_there = not limits.must_exist or absolute.exists()
    except OSError as error:  # you may not look there, or its name is too long
        raise ValueMismatch(f"expected path of a file or folder; {absolute}: {error.strerror}") from None
    if not is_there:
        raise ValueMismatch(f"expected path of an existing file or folder; there is no {absolute}")
    return absolute


def _within(value: float, limits: ValueLimits) -> bool:
    """Return whether a number is inside the bounds; not-a-number is inside none."""
    return (limits.minimum is None or value >= limits.minimum) and (
        limits.maximum is None or value <= limits.maximum
    )


def describe_limits(limits: ValueLimits, name: str = "") -> str:
    """Return limits in words, to follow those of a type; "" if there are none.

    Args:
        limits: the limits.
        name: of the value; if it ends with `bytes`, limits are shown as people write sizes.
    """
    if limits.choices:
        return ", " + _one_of(limits.choices)
    is_size = name.rpartition("_")[2] == "bytes"
    bounds = [f"at least {_bound(limits.minimum, is_size)}"] if limits.minimum is not None else []
    bounds += [f"at most {_bound(limits.maximum, is_size)}"] if limits.maximum is not None else []
    return ", " + " and ".join(bounds) if bounds else ""


def _bound(value: float, is_size: bool) -> str:
    """Return a limit as people write it: `256T`, `1000000`, `1e12`."""
    for letter in "TGMK" if is_size else "":
        unit = int(SIZES[letter.lower()])
        if value >= unit and value % unit == 0:
            return f"{value / unit:.10g}{letter}"
    digits, e, exponent = f"{value:.10g}".partition("e")
    return f"{digits}{e}{int(exponent)}" if e else digits


def _is_text_enum(declared: Any) -> bool:
    """Whether a type is a StrEnum, or what one is in Python 3.10: an Enum of str."""
    return isinstance(declared, type) and issubclass(declared, str) and issubclass(declared, Enum)


def _one_of(choices: tuple[object, ...]) -> str:
    words = [choice.value if isinstance(choice, Enum) else repr(choice) for choice in choices]
    return "one of " + ", ".join(words)


def _mismatch(expected: str, value: object, *, secret: bool = False) -> ValueMismatch:
    shown = "" if secret else f"{reprlib.repr(value)} "
    got = "null" if value is None else f"{shown}({type(value).__name__})"
    return ValueMismatch(f"expected {expected}; got {got}")


_SCALARS: dict[Any, Callable[[object], bool]] = {
    bool: lambda value: isinstance(value, bool),
    int: lambda value: isinstance(value, int) and not isinstance(value, bool),
    float: lambda value: isinstance(value, int | float) and not isinstance(value, bool),
    str: lambda value: isinstance(value, str),
    Path: lambda value: isinstance(value, Path) or (isinstance(value, str) and value != ""),
}
