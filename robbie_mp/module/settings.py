"""Settings: values that a profile sets for a module, declared in its class with type, default and meaning.

    class Mapping(Module):
        resolution_m: float = setting(0.05, "edge of a grid cell", minimum=0.001)
        map_file: Path = setting(REQUIRED, "where the map is kept")

A relative path in a profile starts from the workspace; on the command line, from the current directory.
Never give a setting of type `Secret` in clear text; see `robbie_mp.module.secret`.
"""

import inspect
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, Final, TypeVar, get_type_hints, overload

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean, space_missing
from robbie_mp.module.value_check import (
    ValueLimits,
    ValueMismatch,
    check_value,
    describe,
    describe_limits,
    holds_secret,
    outline,
)

T = TypeVar("T")


class Required(Enum):
    """The type of `REQUIRED`."""

    REQUIRED = "required"


REQUIRED: Final = Required.REQUIRED
"""Use it in place of a default: the profile must set the setting."""


class SettingError(RobbieError, ValueError):
    """A setting is missing, unknown or not as its class declares it.

    Attributes:
        setting: Name of the setting, or "" if the error is about several or all.
    """

    def __init__(self, text: str, setting: str = "") -> None:
        super().__init__(text)
        self.setting = setting


class Setting:
    """One declared setting; reading it before the instance has its value raises AttributeError."""

    def __init__(
        self, default: object, description: str, limits: ValueLimits, *, changeable: bool = False
    ) -> None:
        self.changeable = changeable
        self.default = default
        self.description = description
        self.limits = limits
        self.name = ""
        self.owner: type = object

    def __set_name__(self, owner: type, name: str) -> None:
        self.owner, self.name = owner, name

    def __get__(self, instance: object, owner: type | None = None) -> "Setting":
        if instance is None:
            return self
        raise AttributeError(f"{self} is read before the settings are applied; read it in setup()")

    def __str__(self) -> str:
        return f"{self.owner.__name__}.{self.name}"

    @property
    def required(self) -> bool:
        """Whether there is no default."""
        return self.default is REQUIRED

    @property
    def declared_type(self) -> Any:
        """The annotated type.

        Raises:
            SettingError: there is no annotation, or a profile cannot express its type.
        """
        for owner in self.owner.__mro__:
            annotation = inspect.get_annotations(owner).get(self.name)
            if annotation is not None:
                return self._resolve(annotation, owner)
        raise SettingError(f"{self} needs a type, as in `{self.name}: float = setting(…)`", self.name)

    def _resolve(self, annotation: object, owner: type) -> Any:
        # Only this annotation: others in the class may use names that only type checkers see.
        only = {"__annotations__": {self.name: annotation}, "__module__": owner.__module__}
        try:
            declared = get_type_hints(type(owner.__name__, (), only), localns=dict(vars(owner)))[self.name]
            describe(declared)
        except (NameError, TypeError, SyntaxError) as error:
            raise SettingError(f"{self}: {error}", self.name) from None
        if self.changeable and holds_secret(declared):
            # A change is a message, which every tool that attaches to the run can read and record.
            raise SettingError(f"{self}: a secret cannot be changeable", self.name)
        return declared

    def describe(self) -> str:
        """Return type and limits in words, as "float, at least 0.01"."""
        return describe(self.declared_type) + describe_limits(self.limits, self.name)

    def outline(self) -> dict[str, Any]:
        """Return type and limits as plain data; see `value_check.outline`."""
        return outline(self.declared_type, self.limits)

    def check(self, value: object, folder: Path | None = None) -> Any:
        """Return `value` as the declared type.

        Raises:
            SettingError: it has another type, or is outside the declared limits.
        """
        try:
            return check_value(self.declared_type, value, self.limits, folder, self.name)
        except ValueMismatch as mismatch:
            origin = ", its default" if value is self.default else ""
            raise SettingError(f"{self}: {mismatch}{origin}", self.name) from None


@overload
def setting(
    default: Required,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Iterable[object] = (),
    must_exist: bool = False,
    finite: bool = True,
    changeable: bool = False,
) -> Any: ...
@overload
def setting(
    default: T,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Iterable[object] = (),
    must_exist: bool = False,
    finite: bool = True,
    changeable: bool = False,
) -> T: ...
def setting(
    default: object,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Iterable[object] = (),
    must_exist: bool = False,
    finite: bool = True,
    changeable: bool = False,
) -> Any:
    """Declare a setting of a class; the annotation gives its type.

    Args:
        default: Value if the profile gives none; `REQUIRED` if there is no sensible default.
        description: The setting's meaning and unit in one line, without its type.
        minimum: Least allowed number; in a list or map it applies to each element.
        maximum: Greatest allowed number.
        choices: All allowed values.
        must_exist: The path must name an existing file or folder.
        finite: Refuse infinity and not-a-number.
        changeable: The setting may be changed while the module runs; see `Module.setting_changed`.
    """
    limits = ValueLimits(minimum, maximum, tuple(choices), must_exist, finite)
    return Setting(default, description, limits, changeable=changeable)


def settings_of(cls: type) -> dict[str, Setting]:
    """Return the settings of a class and its bases, those of the bases first.

    A derived class that assigns a plain value to the name fixes the setting: a profile can no longer set it.
    """
    found: dict[str, Setting] = {}
    for base in reversed(cls.__mro__):
        for name, attribute in vars(base).items():
            if isinstance(attribute, Setting):
                found[name] = attribute
            else:
                found.pop(name, None)
    return found


def examine_settings(
    cls: type,
    values: Mapping[str, object],
    *,
    folder: Path | None = None,
    folder_of: Mapping[str, Path] | None = None,
    removed: Sequence[str] = (),
) -> tuple[dict[str, object], list[SettingError]]:
    """Return the values that are right, as `check_settings` does, and an error for each that is wrong.

    There must be a setting for each name in `removed`, too.
    """
    settings = settings_of(cls)
    checked: dict[str, object] = {}
    errors = [
        SettingError(f"{cls.__name__} has no setting {name!r}{_known(name, settings)}", name)
        for name in (*values, *removed)
        if name not in settings
    ]
    for name, declared in settings.items():
        value = values.get(name, declared.default)
        if value is REQUIRED:
            errors.append(SettingError(f"{declared}: required, but not set ({declared.description})", name))
            continue
        try:
            checked[name] = declared.check(value, (folder_of or {}).get(name, folder))
        except SettingError as error:
            errors.append(error)
    return checked, errors


def _known(name: str, settings: Mapping[str, Setting]) -> str:
    return space_missing(name) or did_you_mean(name, settings) or f"; it has {', '.join(settings) or 'none'}"


def check_settings(
    cls: type,
    values: Mapping[str, object],
    *,
    folder: Path | None = None,
    folder_of: Mapping[str, Path] | None = None,
) -> dict[str, object]:
    """Return the value of every setting of a class: the given value, or the default.

    Args:
        cls: Any class that declares settings.
        values: The given values, as YAML or JSON would hold them.
        folder: Relative paths start from this folder; the current directory by default.
        folder_of: The same for single settings, by name.

    Raises:
        SettingError: Values are wrong. The text has a line for each: class, setting, what was expected and
            what was found.
    """
    checked, errors = examine_settings(cls, values, folder=folder, folder_of=folder_of)
    if errors:
        raise SettingError("\n".join(map(str, errors)), errors[0].setting if len(errors) == 1 else "")
    return checked


def apply_settings(
    instance: object,
    values: Mapping[str, object],
    *,
    folder: Path | None = None,
    folder_of: Mapping[str, Path] | None = None,
) -> None:
    """Check `values` against the class of `instance`, and set every setting as an attribute of the instance.

    Raises:
        SettingError: as `check_settings`; the instance is then unchanged.
    """
    for name, value in check_settings(type(instance), values, folder=folder, folder_of=folder_of).items():
        setattr(instance, name, value)
