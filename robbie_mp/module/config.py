"""Typed access to the configuration shared by all modules of a robot."""

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
    """The profile does not set the requested key, and there is no default."""


class ConfigType(RobbieError, TypeError):
    """The value of a key has another type than requested."""


class Config:
    """The `config` of a profile: dotted keys with values of type bool, int, float or str; read-only.

    If the profile does not set the key, every getter returns its `default`, or raises `ConfigMissing` if you
    gave no default. If the value has another type, the getter raises `ConfigType`.
    """

    def __init__(self, values: Mapping[str, object]) -> None:
        self.values: Mapping[str, object] = MappingProxyType(dict(values))

    def get_bool(self, key: str, default: bool | _NoDefault = _NO_DEFAULT) -> bool:
        """Return a bool.

        Args:
            key: dotted key, as "robot.has_arm".
            default: returned if the profile does not set the key.

        Raises:
            ConfigMissing: the key is not set, and there is no default.
            ConfigType: the value has another type.
        """
        return self._get(key, bool, default)

    def get_int(self, key: str, default: int | _NoDefault = _NO_DEFAULT) -> int:
        """Return an int; arguments and errors as for `get_bool`."""
        return self._get(key, int, default)

    def get_float(self, key: str, default: float | _NoDefault = _NO_DEFAULT) -> float:
        """Return a float; an int is converted. Arguments and errors as for `get_bool`."""
        return self._get(key, float, default)

    def get_string(self, key: str, default: str | _NoDefault = _NO_DEFAULT) -> str:
        """Return a str; arguments and errors as for `get_bool`."""
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
