"""Other code or settings for one module of a profile: what `robbie module swap` and `robbie shadow` run."""

import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec as PythonSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec

from robbie_mp.base.errors import RobbieError
from robbie_mp.run.profile.model import ModuleSpec

TRIAL_S = 3.0
"""A swapped module keeps its new code when it has been RUNNING for this long."""
VARIABLE = "ROBBIE_VARIANT"
"""By this variable of its environment, the process of a module learns that it runs a variant."""


class InvalidVariant(RobbieError, ValueError):
    """What is said to be the variant of a module cannot be one.

    Example scenarios:
      - there is no such folder or file
      - the file is no Python file
    """


@dataclass(frozen=True)
class Variant:
    """What of a module differs from the run's profile.

    Attributes:
        code: folder in which its code is looked for first, or the file that takes the place of the one with
            its class; absolute; '' for the code of the profile.
        class_path: its class, as in a profile; '' for that of the profile.
        settings: the settings that differ; None: that setting has the default of the class.
        fresh_start: the number of the process that begins without a checkpoint; 0: none does.
    """

    code: str = ""
    class_path: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    fresh_start: int = 0

    @classmethod
    def of(cls, value: object) -> "Variant":
        """Check what came from another process.

        Raises:
            InvalidVariant: it is no variant.
        """
        try:
            found = msgspec.convert(value, cls)
        except msgspec.ValidationError as error:
            raise InvalidVariant(f"this is no variant of a module: {error}") from None
        check_code(found.code)
        return found

    def applied(self, spec: ModuleSpec) -> ModuleSpec:
        """Return what the profile would say about the module if it said this."""
        settings = {**spec.settings, **self.settings}
        return replace(
            spec,
            class_path=self.class_path or spec.class_path,
            settings={name: value for name, value in settings.items() if value is not None},
            code=self.code,
        )

    def environment(self) -> dict[str, str]:
        """Return the environment by which the module's process learns of it."""
        return {VARIABLE: json.dumps(asdict(self))}

    def __str__(self) -> str:
        """Say what differs."""
        parts = [f"the code of {self.code}"] if self.code else []
        parts += [f"class {self.class_path}"] if self.class_path else []
        parts += [f"{name}={value}" for name, value in self.settings.items()]
        return ", ".join(parts) or "the code and settings of the profile"


def variant_of_environment() -> Variant | None:
    """Return the variant that this process is to run, and forget it, so that no program it starts gets it."""
    text = os.environ.pop(VARIABLE, None)
    return None if text is None else Variant.of(json.loads(text))


def check_code(code: str) -> None:
    """Check that code can be taken from a place.

    Raises:
        InvalidVariant: it cannot.
    """
    path = Path(code)
    if not code or path.is_dir():
        return
    if not path.is_file():
        raise InvalidVariant(f"there is no folder or file {code}")
    if path.suffix != ".py":
        raise InvalidVariant(f"{code} is no Python file; name the file with the class, or a folder")


def put_first(code: str, class_path: str) -> None:
    """Let imports find a variant's code first, from now on.

    Args:
        code: see `Variant`.
        class_path: the class; a file takes the place of the Python module that the class is in.
    """
    if not code:
        return
    if Path(code).is_dir():
        sys.path.insert(0, code)
    else:
        sys.meta_path.insert(0, _OneFile(class_path.partition(":")[0], code))


class _OneFile(MetaPathFinder):
    """Finds one Python module in a file of any name."""

    def __init__(self, name: str, file: str):
        self._name, self._file = name, file

    def find_spec(
        self, fullname: str, _path: Sequence[str] | None, _target: ModuleType | None = None
    ) -> PythonSpec | None:
        """Return where the module is; None for all others."""
        return spec_from_file_location(fullname, self._file) if fullname == self._name else None
