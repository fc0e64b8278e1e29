"""Typed access to the configuration that all modules of a robot share."""

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Final, TypeVar

from robbie_mp.errors import RobbieError
from robbie_mp.module.value_check import ValueMismatch, check_value
from robbie_mp.suggest import did_you_mean

T = TypeVar("T")


class _NoDefault(Enum):
    NO_DEFAULT = "no default"


_NO_DEFAULT: Final = _NoDefault.NO_DEFAULT


class ConfigMissing(RobbieError, LookupError):
    """A key was asked for that the profile does not set."""


class ConfigType(RobbieError, TypeError):
    """The value of a key is of another type than was asked for."""


class Config:
    """The `config` of a profile: flat, dotted key to bool, int, float or text; read-only.

    Every getter returns its `default` if the profile does not set the key. Without a default that is
    `ConfigMissing`; a value of another type is `ConfigType` in any case.
    """

    def __init__(self, values: Mapping[str, object]) -> None:
        self.values: Mapping[str, object] = MappingProxyType(dict(values))

    def get_bool(self, key: str, default: bool | _NoDefault = _NO_DEFAULT) -> bool:
        """Return a true or false."""
        return self._get(key, bool, default)

    def get_int(self, key: str, default: int | _NoDefault = _NO_DEFAULT) -> int:
        """Return a whole number."""
        return self._get(key, int, default)

    def get_float(self, key: str, default: float | _NoDefault = _NO_DEFAULT) -> float:
        """Return a number; a whole number will do."""
        return self._get(key, float, default)

    def get_string(self, key: str, default: str | _NoDefault = _NO_DEFAULT) -> str:
        """Return a text."""
        return self._get(key, str, default)

    def _get(self, key: str, declared: type[T], default: T | _NoDefault) -> T:
        if key not in self.values:
            if isinstance(default, _NoDefault):
                near = did_you_mean(key, self.values) or "; set it in the profile under config:"
                raise ConfigMissing(f"config has no key {key!r}{near}")
            return default
        try:
            value: T = check_value(declared, self.values[key])
        except ValueMismatch as mismatch:
            raise ConfigType(f"config key {key!r}: {mismatch}") from None
        return value
