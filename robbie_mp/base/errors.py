"""The root of every error that Robbie-MP raises.

Each package declares its own errors next to the code that raises them; each is a `RobbieError` and also the
built-in it resembles, so that `except ValueError` works without knowing these classes.
"""

from types import FunctionType
from typing import Any

from typing_extensions import Self


class RobbieError(Exception):
    """Something that Robbie-MP refuses or cannot do; the text says what, where, and what to do about it.

    Example scenarios:
      - a profile names a module class that does not exist
      - a message is larger than a segment can hold
    """

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to copy the error without its constructor, which would build the text again."""
        if not isinstance(type(self).__init__, FunctionType):
            return super().__reduce__()  # type: ignore[return-value]
        return self._rebuilt, (self.args, self.__dict__)

    @classmethod
    def _rebuilt(cls, args: tuple[Any, ...], attributes: dict[str, Any]) -> Self:
        error = cls.__new__(cls, *args)
        error.args = args
        error.__dict__.update(attributes)
        return error
