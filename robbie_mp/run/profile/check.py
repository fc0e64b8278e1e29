"""The process that imports a profile's classes and checks their settings.

`robbie_mp.run.profile.preflight` runs it as `python -m robbie_mp.run.profile.check`. A team's code may print,
hang, start threads or crash when it is imported, and none of that may harm the caller. The request is one
JSON document on standard input; the answer is one JSON event per line on the original standard output.
"""

import importlib
import json
import os
import pkgutil
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO, TypeVar

from robbie_mp.base.linux.prctl import die_with_parent
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages.descriptions import TypeDescription, own_types
from robbie_mp.module.class_check import CodeFlaw, class_flaws
from robbie_mp.module.clock import AGES_S
from robbie_mp.module.settings import SettingError, examine_settings
from robbie_mp.run.profile.code_check import import_flaw, type_flaws
from robbie_mp.run.supervisor.tracebacks import leave_out_our_frames
from robbie_mp.run.variant import put_first

Class = TypeVar("Class")


class NotAModule(Exception):
    """The profile names a class that does not exist, or that is not a module class."""


MODULE_FILE = "robbie_mp.module.module"
"""Where `checkpoint` is defined."""


def main() -> None:
    """Check every module of the request and exit, even if the imported code has started threads."""
    request = json.load(sys.stdin)
    die_with_parent(request["asked_by"])
    events = _keep_output_for_events()
    sys.path.insert(0, request["workspace"])
    this_process = os.getpid()
    try:
        base = load_class(request["base_class"], object)
    except Exception:
        _emit(events, {"useless": traceback.format_exc()})
        raise
    _emit(events, {"ready": True})
    for module in request["modules"]:
        # If the caller is killed, only this ends the process in an import that hangs.
        signal.setitimer(signal.ITIMER_REAL, request["timeout_s"] + 1)
        _emit(events, {"begin": module["name"]})
        others = [name for name in request["names"] if name != module["name"]]
        result = examine(module, base, Path(request["workspace"]), others)
        if os.getpid() != this_process:  # the imported code has forked
            os._exit(0)
        _emit(events, {"result": result})
    _emit(events, {"end": True})
    os._exit(0)


def _keep_output_for_events() -> TextIO:
    """Return a private stream to standard output, and discard what imported code prints."""
    events = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(nowhere, descriptor)
    os.close(nowhere)
    return events


def _emit(events: TextIO, event: dict[str, object]) -> None:
    events.write(json.dumps(event, default=str) + "\n")
    events.flush()


def examine(module: dict[str, Any], base: type, workspace: Path, others: list[str]) -> dict[str, object]:
    """Return a module's errors and its complete settings, or the failure of its code."""
    errors: list[tuple[tuple[str, ...], str]] = []
    settings: dict[str, object] = {}
    further: list[TypeDescription] = []
    flaws: list[CodeFlaw] = []
    failure = ""
    is_missing = saves_state = False
    deadline_s: float | None = None
    put_first(module["code"], module["class_path"])
    try:
        cls: type = load_class(module["class_path"], base)
        saves_state = _saves_state(cls)
        deadline_s = getattr(cls, "handler_deadline_s", None)
        if not (deadline_s is None or (isinstance(deadline_s, int | float) and 0 <= deadline_s <= AGES_S)):
            text = f"{cls.__name__}.handler_deadline_s is {deadline_s!r}; it must be None, or in s at least 0"
            errors.append((("class",), text))
        flaws += class_flaws(cls)
        folder_of = {name: Path(folder) for name, folder in module["folder_of"].items()}
        settings, found = examine_settings(
            cls,
            module["settings"],
            folder=workspace,
            folder_of=folder_of,
            removed=module.get("removed", ()),
        )
        said = {flaw.text for flaw in flaws}
        errors += [(("settings", error.setting), str(error)) for error in found if str(error) not in said]
        if not errors:
            _hook(cls, "check")(dict(settings))
            further += _hook(cls, "further_types")(dict(settings), others) or ()
    except SettingError as error:
        errors.append((("settings", error.setting), str(error)))
    except NotAModule as error:
        errors.append((("class",), str(error)))
    except BaseException as error:  # even sys.exit: the fault is in the code, not in the profile
        leave_out_our_frames(error)
        failure = "".join(traceback.format_exception(error))
        is_missing = isinstance(error, ImportError)
        flaws += filter(None, [import_flaw(error)])
    flaws += type_flaws()
    known = own_types()
    known += [one for one in further if one.name not in {declared.name for declared in known}]
    return {
        "errors": errors,
        "flaws": flaws,
        "settings": settings,
        "failure": failure,
        "missing": is_missing,
        "saves_state": saves_state,
        "handler_deadline_s": deadline_s,
        "types": known,
    }


def _saves_state(cls: type) -> bool:
    """Whether a method of the class, or of one that it is derived from, calls `checkpoint`."""
    methods = (one for base in cls.__mro__ if base.__module__ != MODULE_FILE for one in vars(base).values())
    codes = (getattr(one, "__code__", None) for one in methods)
    return any(code is not None and "checkpoint" in code.co_names for code in codes)


def _hook(cls: type, name: str) -> Callable[..., Any]:
    """Return a method of a module's class; one that does nothing if the class has none."""
    found: Callable[..., Any] = getattr(cls, name, lambda *_: None)
    return found


def load_class(class_path: str, base: type[Class]) -> type[Class]:
    """Import the class named by `package.module:Class`.

    Raises:
        NotAModule: there is no such module or class, or the class is not derived from `base`.
        BaseException: anything that the imported code raises.
    """
    module_name, _, class_name = class_path.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        # Only if the named module or a package around it is missing; otherwise one of its imports failed.
        if error.name and (module_name + ".").startswith(error.name + "."):
            near = did_you_mean(error.name, _siblings(error.name))
            raise NotAModule(f"there is no Python module {error.name!r}{near}") from None
        raise
    found: Any = getattr(module, class_name, None)
    if found is None:
        classes = [name for name, value in vars(module).items() if isinstance(value, type)]
        raise NotAModule(f"{module_name} has no class {class_name!r}{did_you_mean(class_name, classes)}")
    if not (isinstance(found, type) and issubclass(found, base)):
        face = f"{base.__module__}.{base.__qualname__}".replace(f"{MODULE_FILE}.", "robbie_mp.")
        raise NotAModule(f"{class_path} is not derived from {face}")
    checked: type[Class] = found
    return checked


def _siblings(module_name: str) -> list[str]:
    """Return the names of the modules in the package where a module should be."""
    package_name, dot, _ = module_name.rpartition(".")
    workspace = sys.path[:1]
    folders = list(getattr(sys.modules.get(package_name), "__path__", [])) if dot else workspace
    return [package_name + dot + module.name for module in pkgutil.iter_modules(folders)]


if __name__ == "__main__":
    main()
