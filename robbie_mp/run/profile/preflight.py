"""Checks the classes and settings of a profile before any process of the robot starts.

A separate process (`robbie_mp.run.profile.check`) imports the classes, so that their code cannot harm the
caller. A missing class or a wrong setting is an error of the profile, and so is code that is wrong wherever
it runs, such as a syntax error or a handler that cannot be called (`code_check.py`,
`robbie_mp.module.class_check`). A run is not started
either if a module cannot import something, such as a library that is not installed, unless the module is
`optional`. Other code that raises, hangs or crashes is no error here: the supervisor starts it, and shows it
as FAILED with its traceback.
"""

import os
import re
import sys
import threading
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from robbie_mp.base.extras import what_to_install
from robbie_mp.base.problem import Problem, ProfileError, SourcePlace
from robbie_mp.messages.descriptions import TypeDescription
from robbie_mp.run.profile.checking_process import PreflightError, check_events
from robbie_mp.run.profile.model import BLACK_BOX, ModuleSpec, Profile

BASE_CLASS = "robbie_mp:Module"
OWN_CODE = "robbie_mp."
HIDEABLE = sys.stdlib_module_names | {"numpy", "robbie_mp", "yaml"}
"""The modules that Robbie-MP may import, or have imported."""


@dataclass
class Preflight:
    """The result of the check."""

    settings: dict[str, dict[str, object]] = field(default_factory=dict)
    """For each module that is not in `failures`: every setting, given or default; paths absolute, as str."""
    failures: dict[str, str] = field(default_factory=dict)
    """For each module whose code failed, its settings unchecked: the traceback, or how the process ended."""
    missing: set[str] = field(default_factory=set)
    """Those of `failures` that could not import something, such as a library that is not installed."""
    forgetful: set[str] = field(default_factory=set)
    """The modules that never call `checkpoint`."""
    deadlines_s: dict[str, float | None] = field(default_factory=dict)
    """`Module.handler_deadline_s` of the modules in `settings`."""
    types: dict[str, TypeDescription] = field(default_factory=dict)
    """The message types that the imported code declares, by name, without the stock types."""

    def add(self, module: str, result: dict[str, Any]) -> None:
        """Add the result of the checking process for a module."""
        self.types |= {name: TypeDescription(name, *rest) for name, *rest in result.get("types", ())}
        if result["failure"]:
            self.failures[module] = result["failure"]
            if result.get("missing"):
                self.missing.add(module)
        else:
            self.settings[module] = result["settings"]
            self.deadlines_s[module] = result.get("handler_deadline_s")
            if not result.get("saves_state"):
                self.forgetful.add(module)


def preflight(
    profile: Profile,
    *,
    only: Collection[str] | None = None,
    timeout_s: float = 10.0,
    base_class: str = BASE_CLASS,
) -> Preflight:
    """Import every class of a profile and check its settings, in another process.

    Args:
        profile: What `load_profile` returned.
        only: Names of the modules to check; None: all.
        timeout_s: How long one import may take; if it takes longer, the module fails.
        base_class: Every class must be derived from this one, written as `package.module:Class`.

    Raises:
        ProfileError: It lists every class that is not a module, every wrong, unknown or missing setting, and
            every mistake in the code that can be seen without running it.
        PreflightError: The checking process failed.
    """
    if hiding := list(_hiding(profile.workspace)):
        raise ProfileError(hiding)  # the checking process could not start either
    findings = Preflight()
    problems: list[Problem] = []
    flaws: dict[Problem, None] = {}
    """Mistakes in the code, each once, in order: several modules may import the same file."""
    # Services come last: they may need the message types that the robot's code declares.
    waiting = sorted(profile.modules, key=lambda module: module.class_path.startswith(OWN_CODE))
    waiting = [module for module in waiting if only is None or module.name in only]
    while waiting:
        current = ""  # the module being imported, or else the last one imported
        with closing(check_events(profile, waiting, timeout_s, base_class)) as events:
            for event in events:
                match event:
                    case {"begin": str(name)}:
                        current = name
                    case {"result": result}:
                        waiting = [module for module in waiting if module.name != current]
                        problems += _problems(profile, current, result["errors"])
                        flaws |= dict.fromkeys(_flaws(result.get("flaws", ())))
                        findings.add(current, result)
                    case {"broken": str(reason)}:
                        waiting = _without_crashed(waiting, current, reason, findings)
                    case {"useless": failure}:
                        raise PreflightError(f"modules cannot be checked; {base_class}:\n{failure}")
    if problems or flaws:
        raise ProfileError([*problems, *flaws])
    return findings


def _hiding(workspace: Path) -> Iterator[Problem]:
    """Find files of a workspace that the robot's processes would import in place of Python's or ours."""
    for name in sorted(HIDEABLE.intersection(sys.modules)):
        file = getattr(sys.modules[name].__spec__, "origin", None) or ""
        for own in (workspace / f"{name}.py", workspace / name / "__init__.py"):
            if os.path.isabs(file) and own.is_file() and not own.samefile(file):
                text = f"hides the module {name}, which Robbie-MP imports; rename it"
                yield Problem(text, SourcePlace(own, 1))


def runnable(profile: Profile, findings: Preflight) -> Profile:
    """Return the profile without the optional modules that cannot be imported, with the classes' deadlines.

    Args:
        profile: what `load_profile` returned.
        findings: what `preflight` returned for it.

    Raises:
        ProfileError: a module that is not optional cannot be imported, no module is left to run, or one may
            use none of its processors here.
    """
    require_processors(profile)
    missing = [module for module in profile.modules if module.name in findings.missing]
    problems = [
        Problem(
            f"modules.{module.name}.class: {module.class_path} cannot be imported: "
            f"{what_failed(findings.failures[module.name])}; "
            f"{what_to_install(findings.failures[module.name])}, "
            "or write `optional: true` into the module to run without it",
            profile.place_of("modules", module.name, "class"),
        )
        for module in missing
        if not module.optional
    ]
    if problems:
        raise ProfileError(problems)
    left_out = {module.name for module in missing}
    if profile.clock.source in left_out:
        text = f"clock.source: {profile.clock.source} cannot be imported, and no other module turns the clock"
        raise ProfileError([Problem(text, profile.place_of("clock", "source"))])
    kept = tuple(
        replace(
            module,
            depends_on=tuple(name for name in module.depends_on if name not in left_out),
            handler_deadline_s=_deadline_s(module, findings),
        )
        for module in profile.modules
        if module.name not in left_out
    )
    if all(module.name == BLACK_BOX for module in kept):
        text = f"profile {profile.name} has no modules to run; list them under `modules:`"
        raise ProfileError([Problem(text, profile.place_of("modules"))])
    return replace(profile, modules=kept)


def require_processors(profile: Profile) -> None:
    """Refuse a profile that binds a process to processors of which it may use none on this machine.

    Raises:
        ProfileError: it lists each of them.
    """
    wanted: dict[tuple[str, ...], list[int]] = {("core",): profile.core.scheduling.cpus}
    wanted |= {("modules", one.name): one.scheduling.cpus for one in profile.modules}
    problems = [
        Problem(
            f"{'.'.join(where)}.scheduling.cpus: {cpus}, of which this machine lets it use none; "
            f"it has {os.cpu_count()} processors, from 0 on",
            profile.place_of(*where, "scheduling", "cpus"),
        )
        for where, cpus in wanted.items()
        if cpus and not _may_use(cpus)
    ]
    if problems:
        raise ProfileError(problems)


def _may_use(cpus: list[int]) -> bool:
    """Try it, in a thread of its own: what this process is bound to now says nothing about it."""
    may_use = []

    def bind() -> None:
        with suppress(OSError, ValueError, OverflowError):
            os.sched_setaffinity(0, cpus)  # of this thread alone
            may_use.append(True)

    thread = threading.Thread(target=bind, name="processors")
    thread.start()
    thread.join()
    return bool(may_use)


def _deadline_s(module: ModuleSpec, findings: Preflight) -> float | None:
    """Return the deadline of the profile, or else of the class."""
    given_s = module.handler_deadline_s
    return findings.deadlines_s.get(module.name) if given_s is None else given_s


def first_problem(result: Mapping[str, Any]) -> str:
    """Return in a line what is wrong with a module, given the result of `check.examine`; '': nothing is."""
    for problem in _flaws(result.get("flaws") or ()):
        return str(problem)
    for key, text in result.get("errors") or ():
        return f"{key[0]}: {text}"
    return what_failed(result.get("failure") or "")


def what_failed(failure: str) -> str:
    """Return the last line of a traceback, with the line of code that it ends with, in brackets."""
    last_line = (failure.strip().splitlines() or [""])[-1]
    places = re.findall(r'File "([^<"]+)", line (\d+)', failure)
    return f"{last_line} ({SourcePlace(Path(places[-1][0]), int(places[-1][1]))})" if places else last_line


def _without_crashed(
    waiting: list[ModuleSpec], crashed: str, reason: str, findings: Preflight
) -> list[ModuleSpec]:
    """Record the failure of the module that ended the process, and of others with code in the same file."""
    if not crashed:
        raise PreflightError(f"the process that checks the profile's classes {reason}")
    file_of = {module.name: module.class_path.partition(":")[0] for module in waiting}
    if crashed not in file_of:  # its check was done: a thread that it left behind has ended the process
        return waiting
    same = [name for name, file in file_of.items() if file == file_of[crashed]]
    findings.failures |= dict.fromkeys(same, f"{file_of[crashed]}: {reason} while it was imported")
    return [module for module in waiting if module.name not in same]


def _problems(profile: Profile, module: str, errors: list[tuple[list[str], str]]) -> list[Problem]:
    """Return a module's errors, each with the place of its key."""
    return [
        Problem(f"modules.{module}.{key[0]}: {text}", profile.place_of("modules", module, *key))
        for key, text in errors
    ]


def _flaws(found: Iterable[tuple[str, int, str]]) -> Iterator[Problem]:
    """Yield the mistakes in a module's code, each with its place."""
    return (Problem(text, SourcePlace(Path(file), line)) for file, line, text in found)
