"""Problems of a profile, each with its place."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.base.errors import RobbieError


@dataclass(frozen=True)
class SourcePlace:
    """Where a value was written: a line of a file, or an option of the command line."""

    source: Path | str
    """The file, or the option as typed."""
    line: int = 0
    """Line number from 1; 0 on the command line."""
    via: "SourcePlace | None" = None
    """Where the value of the variable was written, if there is a variable at this place."""

    @property
    def is_typed(self) -> bool:
        """Whether the value was typed on the command line."""
        return isinstance((self.via or self).source, str)

    def __str__(self) -> str:
        """Return file:line, with the file relative to the current directory if it is below it."""
        if isinstance(self.source, str):
            return self.source
        here = Path.cwd()
        file = self.source.relative_to(here) if self.source.is_relative_to(here) else self.source
        return f"{file}:{self.line}" + (f" ({self.via})" if self.via else "")


@dataclass(frozen=True)
class Problem:
    """One error of a profile."""

    text: str
    place: SourcePlace | None = None

    def __str__(self) -> str:
        return f"{self.place}: {self.text}" if self.place else self.text


class ProfileError(RobbieError, ValueError):
    """A profile cannot be used; the text has a line for each problem."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(map(str, self.problems)))


def refuse(text: str, place: SourcePlace | None = None) -> ProfileError:
    """Return the error for a single problem."""
    return ProfileError([Problem(text, place)])
