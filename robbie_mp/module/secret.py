"""A secret setting: a token, a password, a key.

A profile does not contain the secret itself, but where it is kept: `file:PATH` or `environment:NAME`. Only
the module's process reads it. Everything that shows, stores or records settings sees only that place, because
`str` of a `Secret` returns nothing else.
"""

import os
import stat
from pathlib import Path

from robbie_mp.base.errors import RobbieError

FILE = "file"
ENVIRONMENT = "environment"
MAX_SECRET_BYTES = 4096


class SecretError(RobbieError, ValueError):
    """A secret is given in clear text, or cannot be read.

    Example scenarios:
      - `--set operator.operator_token=…` contains the token itself, which every user can read with `ps`
      - other users can read the file
      - the environment has no variable of this name
    """


class Secret:
    """A secret text, which only `reveal` returns.

    Args:
        text: the secret.
        source: where it is kept, as written in a profile.
    """

    __slots__ = ("_source", "_text")

    def __init__(self, text: str, source: str = "(secret)"):
        self._text = text
        self._source = source

    def reveal(self) -> str:
        """Return the secret itself; do not log, publish or store it."""
        return self._text

    def __str__(self) -> str:
        return self._source

    def __repr__(self) -> str:
        return f"Secret({self._source})"


def reveal(secret: Secret | None) -> str:
    """Return the text of an optional secret; '' if it is None."""
    return "" if secret is None else secret.reveal()


def read_secret(value: object, folder: Path | None = None) -> Secret:
    """Read a secret from the place that a profile names.

    Args:
        value: `file:PATH`, `environment:NAME`, or a Secret that has already been read.
        folder: relative paths start from this folder; the current directory by default.

    Raises:
        SecretError: `value` has another form, or there is no usable secret at this place. The error never
            contains `value` if that could be the secret itself.
    """
    if isinstance(value, Secret):
        return value
    kind, colon, place = value.partition(":") if isinstance(value, str) else ("", "", "")
    place = place.strip()
    if colon and place and kind == FILE:
        return _read_file(place, folder)
    if colon and place and kind == ENVIRONMENT:
        return _read_environment(place)
    raise SecretError(
        "expected where the secret is kept, as file:PATH or environment:NAME; got something else, which is "
        "not shown. Other users can read profiles and command lines: write the secret to a file that only "
        "you can read (chmod 600) and name that file"
    )


def _read_file(place: str, folder: Path | None) -> Secret:
    try:
        path = (folder or Path.cwd()) / Path(place).expanduser()
    except RuntimeError:  # "~name" of an unknown user
        raise SecretError(f"there is no home folder for {place}") from None
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        raise SecretError(f"cannot read the secret's file {path}: {_reason(error)}") from None
    try:
        if problem := _file_problem(os.fstat(fd)):
            raise SecretError(f"the secret's file {path} {problem}")
        content = os.read(fd, MAX_SECRET_BYTES + 1)
    except OSError as error:
        raise SecretError(f"cannot read the secret's file {path}: {_reason(error)}") from None
    finally:
        os.close(fd)
    if len(content) > MAX_SECRET_BYTES:
        raise SecretError(f"the secret's file {path} is longer than {MAX_SECRET_BYTES} bytes")
    try:
        text = content.decode().removesuffix("\n").removesuffix("\r")
    except UnicodeDecodeError:
        raise SecretError(f"the secret's file {path} is not UTF-8 text") from None
    if not text:
        raise SecretError(f"the secret's file {path} is empty")
    return Secret(text, f"{FILE}:{path}")


def _file_problem(found: os.stat_result) -> str:
    """Return why a file may not hold a secret; '' if it may."""
    if not stat.S_ISREG(found.st_mode):
        return "is not a regular file"
    if found.st_uid not in (os.geteuid(), 0):
        return f"belongs to user {found.st_uid}, which is neither you ({os.geteuid()}) nor root"
    if found.st_mode & 0o077:
        return f"has mode {stat.S_IMODE(found.st_mode):04o}, so other users can read it; run chmod 600 on it"
    return ""


def _read_environment(name: str) -> Secret:
    text = os.environ.get(name, "")
    if not text:
        raise SecretError(f"the environment has no variable {name}, or it is empty")
    return Secret(text, f"{ENVIRONMENT}:{name}")


def _reason(error: OSError | ValueError) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
