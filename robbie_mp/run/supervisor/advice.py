"""What helps against mistakes whose error Python and numpy do not explain."""

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages import Message
from robbie_mp.module.module import Module

READ_ONLY = "; all subscribers share the arrays of a message: change a copy, as in message.ranges.copy()"
NO_TERMINAL = "; a module has no terminal, so input() cannot ask: send it a message with `robbie pub`"


def advice(error: BaseException) -> str:
    """Return what to do about an exception that ended a module, to add to its text; '' if that says it."""
    if isinstance(error, ValueError) and "read-only" in str(error):
        return READ_ONLY
    if isinstance(error, AttributeError) and isinstance(error.obj, Message | Module):
        known = {*dir(type(error.obj)), *getattr(error.obj, "__dict__", ())}
        return did_you_mean(error.name or "", sorted(name for name in known if not name.startswith("_")))
    if isinstance(error, EOFError) and "reading a line" in str(error):
        return NO_TERMINAL
    return ""
