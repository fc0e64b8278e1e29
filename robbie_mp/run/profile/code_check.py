"""Finds mistakes in the code of a profile that end its import, or would only show when it runs."""

import builtins
import os
import re
import sys
import traceback
from collections.abc import Iterator

import robbie_mp
from robbie_mp import messages
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages.descriptions import own_classes
from robbie_mp.messages.errors import DuplicateType
from robbie_mp.messages.registry import TypeRegistry
from robbie_mp.messages.stock.registry import stock_registry
from robbie_mp.module.class_check import OURS, CodeFlaw, is_of_author, place_of

MISTAKES = (SyntaxError, NameError, RobbieError)
"""What an import raises because of a mistake in the code, and never because of the place where it runs."""


def import_flaw(error: BaseException) -> CodeFlaw | None:
    """Return the mistake that ended an import; None if the code may be right.

    Args:
        error: what the import raised.
    """
    if isinstance(error, SyntaxError) and error.filename:
        source = (error.text or "").strip()
        line = f" in `{source}`" if source else ""
        return CodeFlaw(error.filename, error.lineno or 0, f"{type(error).__name__}: {error.msg}{line}")
    frames = [one for one in traceback.extract_tb(error.__traceback__) if is_of_author(one.filename)]
    if not frames or not (isinstance(error, MISTAKES) or _misses_a_name(error) or _misuses_ours(error)):
        return None
    text = f"{type(error).__name__}: {error}".split(" (/")[0] + _nearest(error)
    return CodeFlaw(frames[-1].filename, frames[-1].lineno or 0, text)


def _misses_a_name(error: BaseException) -> bool:
    """Whether an import wants a name that a file of the workspace or of Robbie-MP does not have."""
    roots = (OURS, os.path.abspath(sys.path[0]))
    return type(error) is ImportError and (error.path or "").startswith(roots)


def _misuses_ours(error: BaseException) -> bool:
    """Whether an import calls a function or class of Robbie-MP with wrong arguments, as in `setting(1.0)`."""
    called = re.match(r"(\w+)(\.\w+)*\(\) ", str(error))
    return isinstance(error, TypeError) and called is not None and called[1] in robbie_mp.__all__


def _nearest(error: BaseException) -> str:
    """Suggest a name for one that does not exist."""
    if isinstance(error, NameError) and error.__traceback__ is not None:
        *_, (frame, _) = traceback.walk_tb(error.__traceback__)
        return did_you_mean(error.name or "", [*frame.f_globals, *dir(builtins)])
    wanted = re.match(r"cannot import name '(\w+)'", str(error))
    if wanted and getattr(error, "name", "") == "robbie_mp" and wanted[1] in messages.__all__:
        return f"; it is a stock message: write `from robbie_mp.messages import {wanted[1]}`"
    return did_you_mean(wanted[1], dir(sys.modules.get(getattr(error, "name", "")))) if wanted else ""


def type_flaws() -> Iterator[CodeFlaw]:
    """Find different message classes of one name among all that have been imported."""
    registry = TypeRegistry(stock_registry())
    for message_type in own_classes(all_of_a_name=True):
        try:
            registry.add(message_type)
        except DuplicateType as error:
            yield CodeFlaw(*place_of(message_type), f"{error}; give one of them another name")
