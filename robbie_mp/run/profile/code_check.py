"""Finds mistakes in the code of a module that would only show when it runs, each with its file and line."""

import ast
import builtins
import inspect
import os
import re
import sys
import textwrap
import traceback
from collections.abc import Callable, Iterator
from types import FunctionType, MethodType
from typing import Any, NamedTuple

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages.descriptions import own_classes
from robbie_mp.messages.errors import DuplicateType
from robbie_mp.messages.registry import TypeRegistry
from robbie_mp.messages.stock.registry import stock_registry
from robbie_mp.module.handlers import handler_flaw
from robbie_mp.module.module import Module
from robbie_mp.module.settings import settings_of
from robbie_mp.module.wiring import InvalidTopic, check_topic

MISTAKES = (SyntaxError, NameError, RobbieError)
"""What an import raises because of a mistake in the code, and never because of the place where it runs."""
HOOKS = {"setup": (), "tick": (), "teardown": (), "setting_changed": ("name: str",)}
"""What the framework calls, and the parameters."""
CALLED = {
    "subscribe": (1, "handler", ("message",)),
    "subscribe_encoded": (1, "handler", ("message",)),
    "serve": (1, "handler", ("request",)),
    "every": (1, "action", ()),
}
"""Methods of a module that are given a function: at which place, by which keyword, and its arguments."""
CARRYING = ("subscribe", "publish", "loan", "advertise")
"""Methods of a module that are given the name of a topic."""
_OURS = os.path.dirname(os.path.dirname(os.path.dirname(__file__)))


class CodeFlaw(NamedTuple):
    """A mistake in a file of code."""

    file: str
    line: int
    text: str


def import_flaw(error: BaseException) -> CodeFlaw | None:
    """Return the mistake that ended an import; None if the code may be right.

    Args:
        error: what the import raised.
    """
    if isinstance(error, SyntaxError) and error.filename:
        line = f" in `{error.text.strip()}`" if error.text else ""
        return CodeFlaw(error.filename, error.lineno or 0, f"{type(error).__name__}: {error.msg}{line}")
    frames = [one for one in traceback.extract_tb(error.__traceback__) if _is_of_author(one.filename)]
    if not frames or not (isinstance(error, MISTAKES) or _misses_a_name(error)):
        return None
    text = f"{type(error).__name__}: {error}".split(" (/")[0] + _nearest(error)
    return CodeFlaw(frames[-1].filename, frames[-1].lineno or 0, text)


def _misses_a_name(error: BaseException) -> bool:
    """Whether an import wants a name that a file of the workspace or of Robbie-MP does not have."""
    roots = (_OURS, os.path.abspath(sys.path[0]))
    return type(error) is ImportError and (error.path or "").startswith(roots)


def _nearest(error: BaseException) -> str:
    """Suggest a name for one that does not exist."""
    if isinstance(error, NameError) and error.__traceback__ is not None:
        *_, (frame, _) = traceback.walk_tb(error.__traceback__)
        return did_you_mean(error.name or "", [*frame.f_globals, *dir(builtins)])
    wanted = re.match(r"cannot import name '(\w+)'", str(error))
    return did_you_mean(wanted[1], dir(sys.modules.get(getattr(error, "name", "")))) if wanted else ""


def _is_of_author(file: str) -> bool:
    return os.path.exists(file) and not file.startswith(_OURS + os.sep)


def type_flaws() -> Iterator[CodeFlaw]:
    """Find different message classes of one name among all that have been imported."""
    registry = TypeRegistry(stock_registry())
    for message_type in own_classes(all_of_a_name=True):
        try:
            registry.add(message_type)
        except DuplicateType as error:
            yield CodeFlaw(*_place_of(message_type), f"{error}; give one of them another name")


def class_flaws(cls: type) -> Iterator[CodeFlaw]:
    """Find mistakes in a class of modules and in the author's classes that it is derived from."""
    if not issubclass(cls, Module):
        return
    own = [one for one in cls.__mro__[: cls.__mro__.index(Module)] if _is_of_author(_place_of(one)[0])]
    yield from _flaws_of_constructor(cls)
    for name, parameters in HOOKS.items():
        hook = getattr(cls, name)
        if hook is not getattr(Module, name) and (flaw := handler_flaw(_bound(cls, name), *parameters)):
            yield CodeFlaw(*_place_of(hook), flaw)
    for name, declared in settings_of(cls).items():
        if name in vars(Module) and name != "period_s":
            text = f"the setting {name} hides Module.{name}; give it another name"
            yield CodeFlaw(*_place_of(declared.owner), text)
    source = "\n".join(_source(one) for one in own)
    for one in own:
        yield from _flaws_of_calls(cls, one, source)


def _flaws_of_constructor(cls: type) -> Iterator[CodeFlaw]:
    """Say how to write a constructor that does not do its part, or better none."""
    constructor = cls.__init__  # type: ignore[misc]
    if constructor is Module.__init__ or not isinstance(constructor, FunctionType):
        return
    advice = "put what it does into `def setup(self)`, which runs when the settings are known"
    if handler_flaw(MethodType(constructor, object()), "context"):
        yield CodeFlaw(*_place_of(constructor), f"__init__ is called with the module's context; {advice}")
    elif "__init__" not in constructor.__code__.co_names:
        yield CodeFlaw(*_place_of(constructor), f"__init__ does not call super().__init__(context); {advice}")


def _flaws_of_calls(cls: type, own: type, source: str) -> Iterator[CodeFlaw]:
    """Find handlers and topics in a class body that cannot be used."""
    file, first = _place_of(own)
    for node in ast.walk(ast.parse(_source(own))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and _is_self(node.func.value):
            verb = node.func.attr
            if getattr(cls, verb, None) is not getattr(Module, verb, verb):
                continue
            texts = [_flaw_of_handler(cls, verb, node, source), _flaw_of_topic(verb, node)]
            yield from (CodeFlaw(file, first + node.lineno - 1, f"{verb}: {text}") for text in texts if text)


def _flaw_of_handler(cls: type, verb: str, call: ast.Call, source: str) -> str:
    at, keyword, parameters = CALLED.get(verb, (0, "", ()))
    given = [word.value for word in call.keywords if word.arg == keyword] or call.args[at : at + 1]
    match given if keyword else []:
        case [ast.Constant(value)]:
            return handler_flaw(value)
        case [ast.Call(ast.Attribute(ast.Name("self"), name), [], [])] if hasattr(cls, name):
            return _flaw_of_result(cls, name)
        case [ast.Attribute(ast.Name("self"), name)] if hasattr(cls, name):
            return handler_flaw(_bound(cls, name), *_parameters(verb, call, parameters))
        case [ast.Attribute(ast.Name("self"), name)] if f"self.{name} = " not in source:
            return _no_such_method(cls, name)
    return ""


def _parameters(verb: str, call: ast.Call, names: tuple[str, ...]) -> Iterator[str]:
    """Yield the parameters of a handler with the type of the message, if its name is written there."""
    kind = "EncodedMessage" if verb == "subscribe_encoded" else call.args and ast.unparse(call.args[0])
    return (f"{name}: {kind}" if kind else name for name in names)


def _flaw_of_result(cls: type, name: str) -> str:
    """Return the flaw of a handler that is called instead of given, if it returns nothing."""
    annotations = getattr(getattr(cls, name), "__annotations__", {})
    if "return" in annotations and annotations["return"] in (None, "None"):
        return f"self.{name}() calls the handler at once; write self.{name}, without parentheses"
    return ""


def _no_such_method(cls: type, name: str) -> str:
    methods = [known for known, value in vars(cls).items() if callable(value)]
    return f"{cls.__name__} has no method {name!r}{did_you_mean(name, methods)}"


def _flaw_of_topic(verb: str, call: ast.Call) -> str:
    for word in call.keywords:
        if verb in CARRYING and word.arg == "topic" and isinstance(word.value, ast.Constant):
            try:
                check_topic(word.value.value)
            except InvalidTopic as error:
                return str(error)
    return ""


def _bound(cls: type, name: str) -> Callable[..., Any]:
    """Return a method as it is of an object of the class."""
    found: Any = inspect.getattr_static(cls, name)
    return MethodType(found, object()) if isinstance(found, FunctionType) else getattr(cls, name)


def _is_self(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id == "self"


def _source(cls: type) -> str:
    try:
        return textwrap.dedent(inspect.getsource(cls))
    except (OSError, TypeError):  # it was made by a program
        return ""


def _place_of(made: Any) -> tuple[str, int]:
    """Return file and first line of a class or function; ('', 0) if it was made by a program."""
    try:
        return inspect.getsourcefile(made) or "", max(1, inspect.getsourcelines(made)[1])
    except (OSError, TypeError):
        return getattr(sys.modules.get(made.__module__), "__file__", None) or "", 0
