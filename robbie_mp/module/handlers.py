"""What may be called with messages: found to be wrong when it is given, not when the first message comes."""

import inspect
from collections.abc import Callable
from types import FunctionType

from robbie_mp.base.errors import RobbieError

_WORDS = ("no argument", "one argument", "two arguments")


class InvalidHandler(RobbieError, TypeError):
    """A function cannot be called as a handler.

    Example scenarios:
      - it is None, because its name was written with parentheses: `self.subscribe(LaserScan, self.on_scan())`
      - it takes no argument, but gets the message
      - it is an `async def`, which would never run
    """


def check_handler(verb: str, handler: object, *arguments: str) -> None:
    """Check that a function can be called.

    Args:
        verb: what it is given to, such as "subscribe".
        handler: the function.
        arguments: what it is called with, as parameters in Python.

    Raises:
        InvalidHandler: it cannot.
    """
    if flaw := handler_flaw(handler, *arguments):
        raise InvalidHandler(f"{verb}: {flaw}")


def handler_flaw(handler: object, *arguments: str) -> str:
    """Return why a function cannot be called, and what to write instead; '' if it can.

    Args:
        handler: the function.
        arguments: what it is called with, as parameters in Python, such as "message: LaserScan".
    """
    if not callable(handler):
        return (
            f"the handler is {handler!r:.60}; give a function by its name, without parentheses: "
            "self.on_message, not self.on_message()"
        )
    name = getattr(handler, "__name__", type(handler).__name__)
    if inspect.iscoroutinefunction(handler) or inspect.isasyncgenfunction(handler):
        return f"{name} is an `async def`, which would never run; write `def {name}`"
    if not _takes(handler, len(arguments)):
        parameters = ", ".join(("self", *arguments))
        return f"{name} is called with {_WORDS[len(arguments)]}; write `def {name}({parameters})`"
    return ""


def _takes(handler: Callable[..., object], count: int) -> bool:
    """Whether a function takes a number of arguments; True if nobody can say, as with some of C."""
    try:
        inspect.signature(handler).bind(*[None] * count)
    except ValueError:
        return not isinstance(getattr(handler, "__func__", None), FunctionType)  # a method without `self`
    except TypeError:
        return False
    return True
