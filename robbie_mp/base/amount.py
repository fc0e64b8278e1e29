"""Times and sizes as people write them: `300ms`, `2min`, `1h30min`, `64K`, `300M`."""

import re
from decimal import Decimal

from robbie_mp.base.errors import RobbieError

NUMBER = r"\d+(?:\.\d*)?(?:e[+-]?\d{1,2})?|\.\d+"
AMOUNT = re.compile(rf"(?:(?:{NUMBER})\s*[a-zµ]+\s*)+", re.IGNORECASE | re.ASCII)
PART = re.compile(rf"({NUMBER})\s*([a-zµ]+)", re.IGNORECASE)
TIMES_S = {
    "ns": Decimal("1e-9"),
    "us": Decimal("1e-6"),
    "µs": Decimal("1e-6"),
    "ms": Decimal("1e-3"),
    "s": Decimal(1),
    "min": Decimal(60),
    "h": Decimal(3600),
    "d": Decimal(86400),
}
SIZES = {"b": Decimal(1)} | {
    spelling: Decimal(base) ** power
    for power, letter in enumerate("kmgt", start=1)
    for base, spelling in ((1024, letter), (1024, f"{letter}ib"), (1000, f"{letter}b"))
}
"""`300M` is 300 · 1024² bytes, as `robbie top` shows sizes; `MiB` is the same, and `MB` is 1000² bytes."""


class BadAmount(RobbieError, ValueError):
    """A text is no time, or no size.

    Example scenarios:
      - `2m`: minutes are `min`
      - `300 Mbit`
    """


def seconds_of(text: str) -> float:
    """Return a time in s; a number without a unit is in s.

    Raises:
        BadAmount: it is no time.
    """
    return float(_sum(text, TIMES_S, "a time such as 300ms, 2s, 1.5min, 1h30min or 2d"))


def bytes_of(text: str) -> int:
    """Return a size in bytes; a number without a unit is in bytes. A part of a byte is left out.

    Raises:
        BadAmount: it is no size.
    """
    return int(_sum(text, SIZES, "a size such as 4096, 64K, 300M or 1.5G"))


def _sum(text: str, units: dict[str, Decimal], expected: str) -> Decimal:
    text = text.strip()
    if re.fullmatch(rf"[+-]?(?:{NUMBER})", text, re.IGNORECASE):
        return Decimal(text)
    parts = PART.findall(text) if AMOUNT.fullmatch(text) else []
    if not parts or any(unit.lower() not in units for _, unit in parts):
        raise BadAmount(f"expected {expected}; got {text!r:.60}")
    return sum((Decimal(number) * units[unit.lower()] for number, unit in parts), Decimal(0))


def plain_amount(name: str, text: str) -> float | int | None:
    """Return the number that a time or size stands for, in the unit with which the name of a value ends.

    Args:
        name: of a setting or key, such as `period_s`, `slice_ms`, `limit_bytes` or `bytes`.
        text: such as `20ms`.

    Returns:
        None if the name ends with no unit of time or size.

    Raises:
        BadAmount: it is no time, or no size.
    """
    unit = name.rpartition("_")[2]
    if unit == "bytes":
        return bytes_of(text)
    if unit in ("s", "ms", "us", "ns") and unit != name:
        return float(Decimal(str(seconds_of(text))) / TIMES_S[unit])
    return None
