"""Finds mistakes in a class of modules that would only show when it runs, each with its file and line.

A run looks for them before it starts (`robbie_mp.run.profile.preflight`), and so does a `ModuleHarness`.
"""

import ast
import inspect
import os
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partialmethod
from numbers import Real
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any, NamedTuple

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.problem import Problem, SourcePlace
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.module.clock import is_span
from robbie_mp.module.handlers import handler_flaw
from robbie_mp.module.module import Module, period_flaw, tick_without_period
from robbie_mp.module.settings import SettingError, settings_of
from robbie_mp.module.wiring import InvalidTopic, check_topic

HOOKS = {"setup": (), "tick": (), "teardown": (), "setting_changed": ("name: str",)}
"""What the framework calls, and the parameters."""
CALLED = {
    "subscribe": (1, "handler", ("message",)),
    "subscribe_encoded": (1, "handler", ("message",)),
    "serve": (1, "handler", ("request",)),
    "every": (1, "action", ()),
}
"""Methods of a module that are given a function: at which place, by which keyword, and its arguments."""
LOOPS = ("loop", "run", "step", "spin", "update", "execute", "work", "main")
"""What authors call `tick` in other frameworks."""
CARRYING = ("subscribe", "publish", "loan", "advertise")
"""Methods of a module that are given the name of a topic."""
OURS = os.path.dirname(os.path.dirname(__file__))
"""The folder of Robbie-MP, whose code no author of a module can change."""
BINDING = (FunctionType, partialmethod, type(lru_cache(len)))
"""What becomes a method of an object."""
KEPT = 1024
"""Classes whose mistakes are remembered: a test may make a harness of one class many times."""


class InvalidClass(RobbieError, TypeError):
    """A class of modules has mistakes; the text has a line for each.

    Example scenarios:
      - `tick` is an `async def`, which would never run
      - its `__init__` does not take the context of the module
      - a handler does not take the message
    """


class CodeFlaw(NamedTuple):
    """A mistake in a file of code."""

    file: str
    line: int
    text: str


def check_class(cls: Any) -> None:
    """Check a class of modules.

    Raises:
        InvalidClass: it has mistakes, or is no class of modules.
    """
    is_module = isinstance(cls, type) and issubclass(cls, Module)
    if not is_module:
        raise InvalidClass(f"{cls!r:.60} is no class of modules; write `class NAME(robbie_mp.Module)`")
    if flaws := _remembered_flaws(cls):
        problems = (Problem(text, SourcePlace(Path(file), line)) for file, line, text in flaws)
        raise InvalidClass("\n".join(map(str, problems)))


@lru_cache(KEPT)
def _remembered_flaws(cls: type) -> tuple[CodeFlaw, ...]:
    return tuple(class_flaws(cls))


def class_flaws(cls: type) -> Iterator[CodeFlaw]:
    """Find mistakes in a class of modules and in the author's classes that it is derived from."""
    if not issubclass(cls, Module):
        return
    own = [one for one in cls.__mro__[: cls.__mro__.index(Module)] if is_of_author(place_of(one)[0])]
    yield from _flaws_of_constructor(cls)
    for name, parameters in HOOKS.items():
        hook = getattr(cls, name)
        if hook is getattr(Module, name) or not _is_method(cls, name):
            continue
        if flaw := handler_flaw(_bound(cls, name), *parameters):
            yield CodeFlaw(*place_of(hook), flaw)
    for name, declared in settings_of(cls).items():
        if name in vars(Module) and name != "period_s":
            text = f"the setting {name} hides Module.{name}; give it another name"
            yield CodeFlaw(*place_of(declared.owner), text)
        try:
            _ = declared.declared_type
        except SettingError as flaw_of_type:
            yield CodeFlaw(*_place_in(declared.owner, name), str(flaw_of_type))
    may_set = _set_by(cls, own)
    yield from _flaws_of_period(cls, own, may_set)
    for one in own:
        yield from _flaws_of_calls(cls, one, may_set)


def _set_by(cls: type, own: Sequence[type]) -> Callable[[str], bool]:
    """Return a function that says whether a module may set an attribute while it runs."""
    sources = [_source(one) for one in own]
    stored = {
        node.attr
        for one in own
        for node in ast.walk(_tree(one))
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
    }
    is_open = hasattr(cls, "__getattr__") or "" in sources or any("setattr" in source for source in sources)
    return lambda name: is_open or name in stored


def _flaws_of_constructor(cls: type) -> Iterator[CodeFlaw]:
    """Say how to write a constructor that does not do its part, or better none."""
    constructor = cls.__init__  # type: ignore[misc]
    if constructor is Module.__init__ or not isinstance(constructor, FunctionType):
        return
    advice = "put what it does into `def setup(self)`, which runs when the settings are known"
    if handler_flaw(MethodType(constructor, object()), "context"):
        yield CodeFlaw(*place_of(constructor), f"__init__ is called with the module's context; {advice}")
    elif "__init__" not in inspect.unwrap(constructor).__code__.co_names:
        yield CodeFlaw(*place_of(constructor), f"__init__ does not call super().__init__(context); {advice}")
    elif _leaves_out_context(cls, constructor):
        own = [name for name in inspect.signature(constructor).parameters if name not in ("self", "context")]
        more = f"; make {', '.join(own)} a setting" if own else ""
        text = f"__init__ calls super().__init__() without the module's context; {advice}{more}"
        yield CodeFlaw(*place_of(constructor), text)


def _leaves_out_context(cls: type, constructor: FunctionType) -> bool:
    """Whether a constructor calls that of `Module` itself without an argument."""
    owner = next(one for one in cls.__mro__ if vars(one).get("__init__") is constructor)
    following = cls.__mro__[cls.__mro__.index(owner) + 1 :]
    if next(vars(one)["__init__"] for one in following if "__init__" in vars(one)) is not Module.__init__:
        return False
    calls = {
        ast.unparse(call)
        for body in _tree(owner).body
        for one in getattr(body, "body", ())  # not the constructors of classes inside it
        if isinstance(one, ast.FunctionDef) and one.name == "__init__"
        for call in _of_the_module(one, in_method=True)
        if isinstance(call, ast.Call)
    }
    return "super().__init__()" in calls


def _flaws_of_period(
    cls: type[Module], own: Sequence[type], may_set: Callable[[str], bool]
) -> Iterator[CodeFlaw]:
    """Find a time between ticks that is none, unless the module sets another one."""
    for one in own:
        if "period_s" in vars(one) and not may_set("period_s"):
            period_s = vars(one)["period_s"]
            if isinstance(period_s, str | Real) and not is_span(period_s):
                yield CodeFlaw(*_place_in(one, "period_s"), period_flaw(cls, period_s))
            elif one is not cls:
                pass  # the period of a base that some derived classes need, and others do not
            elif period_s is not None and cls.tick is Module.tick and not _uses_period(cls, own, may_set):
                yield CodeFlaw(*_place_in(one, "period_s"), _no_tick(cls, own))
            return
    if cls.tick is not Module.tick and is_of_author(place_of(cls.tick)[0]):
        bases = [one for one in cls.__mro__ if one not in Module.__mro__]  # also mix-ins behind Module
        is_set = any("period_s" in vars(one) for one in bases) or _set_by(cls, bases)("period_s")
        is_set = is_set or _gives_itself_away(bases)
        if not is_set:
            yield CodeFlaw(*place_of(cls.tick), tick_without_period(cls))


def _uses_period(cls: type, own: Sequence[type], may_set: Callable[[str], bool]) -> bool:
    """Whether code of the author's reads `period_s`, has a timer, or sets `tick` while it runs."""
    nodes = [node for one in own for node in ast.walk(_tree(one))]
    names = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    names |= {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}
    names |= {str(node.value) for node in nodes if isinstance(node, ast.Constant)}  # as in getattr
    return may_set("tick") or not names.isdisjoint(("period_s", "every")) or _gives_itself_away(own)


def _gives_itself_away(own: Sequence[type]) -> bool:
    """Whether a method gives `self` to other code, which may set, read and call what it likes."""
    nodes = (node for one in own for node in ast.walk(_tree(one)) if isinstance(node, ast.Call))
    given = (one for node in nodes for one in (*node.args, *(word.value for word in node.keywords)))
    return any(_is_self(one) for one in given)


def _no_tick(cls: type, own: Sequence[type]) -> str:
    methods = [name for one in own for name, value in vars(one).items() if isinstance(value, FunctionType)]
    near = [name for name in methods if name not in HOOKS and (name in LOOPS or "tick" in name.lower())]
    remedy = f"rename {near[0]}() to tick()" if near else "write `def tick(self)`, or leave out period_s"
    return f"{cls.__name__} has a period_s, but no tick() that it could call; {remedy}"


def _place_in(cls: type, name: str) -> tuple[str, int]:
    """Return file and line where a class body gives a name a value; of the class if that is not found."""
    file, first = place_of(cls)
    for node in ast.walk(_tree(cls)):
        targets = [node.target] if isinstance(node, ast.AnnAssign) else getattr(node, "targets", [])
        if any(isinstance(one, ast.Name) and one.id == name for one in targets):
            return file, first + targets[0].lineno - 1
    return file, first


def _of_the_module(parent: ast.AST, *, in_method: bool = False) -> Iterator[ast.AST]:
    """Yield the nodes of a class body in which `self` is the module, unlike in classes inside it."""
    for node in ast.iter_child_nodes(parent):
        is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        has_own_self = is_function and in_method and "self" in {one.arg for one in _parameters_of(node)}
        if not (isinstance(node, ast.ClassDef) or has_own_self):
            yield node
            yield from _of_the_module(node, in_method=in_method or is_function)


def _parameters_of(function: ast.AST) -> Iterator[ast.arg]:
    return (node for node in ast.walk(getattr(function, "args", ast.Pass())) if isinstance(node, ast.arg))


def _flaws_of_calls(cls: type, own: type, may_set: Callable[[str], bool]) -> Iterator[CodeFlaw]:
    """Find handlers and topics in a class body that cannot be used."""
    file, first = place_of(own)
    for node in (node for body in _tree(own).body for node in _of_the_module(body)):
        for method in _methods_replaced_by(cls, own, node):
            text = f"self.{method.attr} is a method of Module, and no place for a value; use another name"
            yield CodeFlaw(file, first + method.lineno - 1, text)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and _is_self(node.func.value):
            verb = node.func.attr
            if getattr(cls, verb, None) is not getattr(Module, verb, verb):
                continue
            texts = [
                _flaw_of_arguments(verb, node) or _flaw_of_handler(cls, verb, node, may_set),
                _flaw_of_topic(verb, node),
            ]
            yield from (CodeFlaw(file, first + node.lineno - 1, f"{verb}: {text}") for text in texts if text)


def _methods_replaced_by(cls: type, own: type, node: ast.AST) -> Iterator[ast.Attribute]:
    """Yield the methods of `Module` that are called in whose place an assignment puts a constant."""
    if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
        for one in node.targets:
            if isinstance(one, ast.Attribute) and _is_self(one.value) and _is_called(cls, own, one.attr):
                yield one


def _is_called(cls: type, own: type, name: str) -> bool:
    """Whether a name is a method of `Module` that the framework or the class calls, and no property."""
    found = inspect.getattr_static(cls, name, None)
    if not isinstance(vars(Module).get(name), FunctionType) or not isinstance(found, FunctionType):
        return False
    calls = (node.func for node in ast.walk(_tree(own)) if isinstance(node, ast.Call))
    return name in HOOKS or any(ast.unparse(one) == f"self.{name}" for one in calls)


def _flaw_of_arguments(verb: str, call: ast.Call) -> str:
    """Return why a method of `Module` cannot be called so; '' if it can, or if only a run can say."""
    method = getattr(Module, verb, None)
    given = [word.arg for word in call.keywords]
    if not isinstance(method, FunctionType) or None in given or _is_spread(call.args):
        return ""
    if (
        topics := [one for one in call.args if _is_text(one)]
        if verb in CARRYING and "topic" not in given
        else []
    ):
        others = [one for one in call.args if one not in topics]
        if len(others) > (verb == "subscribe"):
            words = [*others, *call.keywords, ast.keyword("topic", topics[0])]
            return f"write self.{verb}({', '.join(map(ast.unparse, words))})"
    signature = inspect.signature(method)
    try:
        signature.bind(None, *call.args, **dict.fromkeys(filter(None, given)))
    except TypeError as error:
        parameters = [one for name, one in signature.parameters.items() if name != "self"]
        written = (f"{one.name}=…" if one.kind is one.KEYWORD_ONLY else one.name for one in parameters)
        return f"{error}; write self.{verb}({', '.join(written)})"
    return ""


def _is_spread(arguments: Sequence[ast.expr]) -> bool:
    return any(isinstance(one, ast.Starred) for one in arguments)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _flaw_of_handler(cls: type, verb: str, call: ast.Call, may_set: Callable[[str], bool]) -> str:
    at, keyword, parameters = CALLED.get(verb, (0, "", ()))
    given = [word.value for word in call.keywords if word.arg == keyword] or call.args[at : at + 1]
    match given if keyword else []:
        case [ast.Constant(value)]:
            return handler_flaw(value)
        case [ast.Call(ast.Attribute(ast.Name("self"), name), [], [])] if hasattr(cls, name):
            return _flaw_of_result(cls, name)
        case [ast.Attribute(ast.Name("self"), name)] if may_set(name) or not _is_method(cls, name):
            return ""
        case [ast.Attribute(ast.Name("self"), name)] if hasattr(cls, name):
            return handler_flaw(_bound(cls, name), *_parameters(verb, call, parameters))
        case [ast.Attribute(ast.Name("self"), name)]:
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


def _is_method(cls: type, name: str) -> bool:
    """Whether an attribute is missing, or what it is for an object is known without making one."""
    found = inspect.getattr_static(cls, name, None)
    return not hasattr(found, "__get__") or isinstance(found, (*BINDING, staticmethod, classmethod))


def _bound(cls: type, name: str) -> Callable[..., Any]:
    """Return a method as it is of an object of the class."""
    found: Any = inspect.getattr_static(cls, name)
    kind: Any = type(found)
    is_binding = isinstance(found, BINDING)
    bound: Callable[..., Any] = kind.__get__(found, object(), cls) if is_binding else getattr(cls, name)
    return bound


def _is_self(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id == "self"


def _tree(cls: type) -> ast.Module:
    """Return what a class is made of; nothing if its text alone cannot be read."""
    try:
        return ast.parse(_source(cls))
    except SyntaxError:  # a text in it begins further left than its lines
        return ast.parse("")


def _source(cls: type) -> str:
    """Return the text of a class; '' if it was made by a program, or another class of its name is found."""
    try:
        lines, first = inspect.getsourcelines(cls)
    except (OSError, TypeError):
        return ""
    functions = (inspect.unwrap(one) for one in vars(cls).values() if isinstance(one, FunctionType))
    begins = [one.__code__.co_firstlineno for one in functions]
    is_its_own = not begins or any(first <= begin < first + len(lines) for begin in begins)
    return textwrap.dedent("".join(lines)) if is_its_own else ""


def is_of_author(file: str) -> bool:
    """Whether a file is there, and none of Robbie-MP."""
    return os.path.exists(file) and not file.startswith(OURS + os.sep)


def place_of(made: Any) -> tuple[str, int]:
    """Return file and first line of a class or function; ('', 0) if it was made by a program."""
    try:
        return inspect.getsourcefile(made) or "", max(1, inspect.getsourcelines(made)[1])
    except (OSError, TypeError):
        return getattr(sys.modules.get(getattr(made, "__module__", "")), "__file__", None) or "", 0
