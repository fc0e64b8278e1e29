"""Check the classes and settings of a profile before any process of the robot starts.

The classes are imported in a process of their own (`robbie_mp.profile.check`), so that nothing they do can
harm the caller. A class that is not there or whose settings are wrong is an error of the profile. Code that
raises, hangs or crashes is not: the supervisor will start it, and show it as FAILED with its traceback.
"""

from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

from robbie_mp.messages.descriptions import TypeDescription
from robbie_mp.profile.checking_process import PreflightError, check_events
from robbie_mp.profile.model import ModuleSpec, Profile
from robbie_mp.profile.problem import Problem, ProfileError

BASE_CLASS = "robbie_mp:Module"
OWN_CODE = "robbie_mp."


@dataclass
class Preflight:
    """What the check has found out."""

    settings: dict[str, dict[str, object]] = field(default_factory=dict)
    """By module that is not in `failures`: every setting, given or default; absolute paths, as text."""
    failures: dict[str, str] = field(default_factory=dict)
    """By module whose code failed, its settings unchecked: the traceback, or how the process ended."""
    types: dict[str, TypeDescription] = field(default_factory=dict)
    """By name: the message types that the imported code declares, without the stock types."""

    def add(self, module: str, result: dict[str, Any]) -> None:
        """Take in what the checking process says of a module."""
        self.types |= {name: TypeDescription(name, *rest) for name, *rest in result.get("types", ())}
        if result["failure"]:
            self.failures[module] = result["failure"]
        else:
            self.settings[module] = result["settings"]


def preflight(profile: Profile, *, timeout_s: float = 10.0, base_class: str = BASE_CLASS) -> Preflight:
    """Import every class of a profile and check its settings, in another process.

    Args:
        profile: What `load_profile` returned.
        timeout_s: How long one import may take; longer is a failure of that module.
        base_class: What every class must be derived from, as `package.module:Class`.

    Raises:
        ProfileError: with every class that is no module, and every wrong, unknown or missing setting.
        PreflightError: the checking process could not do its work.
    """
    findings = Preflight()
    problems: list[Problem] = []
    # Services come last: they may ask for the message types that the robot's own code declares.
    waiting = sorted(profile.modules, key=lambda module: module.class_path.startswith(OWN_CODE))
    while waiting:
        current = ""  # the module being imported, or else the last one that was
        with closing(check_events(profile, waiting, timeout_s, base_class)) as events:
            for event in events:
                match event:
                    case {"begin": str(name)}:
                        current = name
                    case {"result": result}:
                        waiting = [module for module in waiting if module.name != current]
                        problems += _problems(profile, current, result["errors"])
                        findings.add(current, result)
                    case {"broken": str(reason)}:
                        waiting = _without_crashed(waiting, current, reason, findings)
                    case {"useless": failure}:
                        raise PreflightError(f"modules cannot be checked; {base_class}:\n{failure}")
    if problems:
        raise ProfileError(problems)
    return findings


def _without_crashed(
    waiting: list[ModuleSpec], crashed: str, reason: str, findings: Preflight
) -> list[ModuleSpec]:
    """Note the failure of the module that ended the process, and of others whose code is in the same file."""
    if not crashed:
        raise PreflightError(f"the process that checks the profile's classes {reason}")
    file_of = {module.name: module.class_path.partition(":")[0] for module in waiting}
    if crashed not in file_of:  # it was through already: a thread that it left behind has ended the process
        return waiting
    same = [name for name, file in file_of.items() if file == file_of[crashed]]
    findings.failures |= dict.fromkeys(same, f"{file_of[crashed]}: {reason} while it was imported")
    return [module for module in waiting if module.name not in same]


def _problems(profile: Profile, module: str, errors: list[tuple[list[str], str]]) -> list[Problem]:
    """Return the errors of a module, each with the place of its key."""
    return [
        Problem(f"modules.{module}.{key[0]}: {text}", profile.place_of("modules", module, *key))
        for key, text in errors
    ]
