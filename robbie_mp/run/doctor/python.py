"""Python, the packages that Robbie-MP needs, and the modules of a profile."""

import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata

from robbie_mp.bus._hot.choice import why_not
from robbie_mp.run.doctor.finding import Finding, fail, ok, warn
from robbie_mp.run.profile.model import Profile
from robbie_mp.run.profile.preflight import preflight

OLDEST = (3, 10)
DISTRIBUTION = "robbie-mp"
REQUIREMENT = re.compile(r"([\w.-]+)\s*(?:>=\s*([0-9.]+))?[^;]*(?:;.*extra\s*==\s*[\"']([\w-]+)[\"'])?")


@dataclass(frozen=True)
class Requirement:
    """A package, its oldest version, and the extra that requires it ('': Robbie-MP itself)."""

    package: str
    oldest: str
    extra: str

    @classmethod
    def parse(cls, text: str) -> "Requirement":
        """Parse a requirement as Robbie-MP writes it: `scipy>=1.11; extra == "robot"`."""
        match = REQUIREMENT.match(text)
        package, oldest, extra = match.groups(default="") if match else (text, "", "")
        return cls(package, oldest, extra)


def look_at_python() -> Iterator[Finding]:
    """Judge this Python and its packages."""
    yield check_version(sys.version_info[:2], sys.implementation.name, is_gil_enabled())
    yield check_hot_path(why_not())
    requirements = own_requirements()
    installed = {requirement.package: _installed(requirement.package) for requirement in requirements}
    yield from check_packages(requirements, installed)


def is_gil_enabled() -> bool:
    """Whether only one thread runs Python code at a time, as it does before Python 3.13."""
    return bool(getattr(sys, "_is_gil_enabled", lambda: True)())


def own_requirements() -> list[Requirement]:
    """Return Robbie-MP's requirements as they were when it was installed."""
    return [Requirement.parse(text) for text in metadata.requires(DISTRIBUTION) or []]


def _installed(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def check_version(version: tuple[int, int], implementation: str, is_gil_enabled: bool) -> Finding:
    """Judge Python's version."""
    found = f"{implementation} {version[0]}.{version[1]}"
    if version < OLDEST:
        return fail("Python", found, f"use CPython {OLDEST[0]}.{OLDEST[1]} or later")
    if implementation != "cpython" or not is_gil_enabled:
        return warn(
            "Python",
            found,
            "Robbie-MP is tested only with CPython with the global interpreter lock; use that",
        )
    return ok("Python", found)


def check_hot_path(why_not: str) -> Finding:
    """Judge what publishes, routes and takes messages.

    Args:
        why_not: why it is not the module written in C, and after a semicolon what to do; '': it is.
    """
    if not why_not:
        return ok("hot path", "messages are published, routed and taken in C")
    reason, _, advice = why_not.partition("; ")
    return warn(
        "hot path", f"messages are published, routed and taken in Python, which is slower: {reason}", advice
    )


def check_packages(
    requirements: Iterable[Requirement], installed: Mapping[str, str | None]
) -> Iterator[Finding]:
    """Judge the packages, in one line for Robbie-MP itself and one for each extra.

    An extra that is not installed completely is not in use: single packages of it may be there for another
    reason. What a profile lacks, `look_at_modules` finds.

    Args:
        requirements: the required packages.
        installed: the version of each package, None if it is not installed.
    """
    groups: dict[str, list[Requirement]] = defaultdict(list)
    for requirement in requirements:
        groups[requirement.extra].append(requirement)
    for extra, group in groups.items():
        missing = [one.package for one in group if installed[one.package] is None]
        old = [
            f"{one.package} {version} (needs {one.oldest})"
            for one in group
            if (version := installed[one.package]) and _numbers(version) < _numbers(one.oldest)
        ]
        yield _judge(extra, len(missing) < len(group), missing, old)


def _judge(extra: str, has_any: bool, missing: list[str], old: list[str]) -> Finding:
    name = f"extra {extra}" if extra else "packages"
    target = f"{DISTRIBUTION}[{extra}]" if extra else DISTRIBUTION
    advice = f"pip install --upgrade '{target}'"
    if not missing and not old:
        return ok(name, "all are installed")
    lists = {"missing": missing, "too old": old}
    found = "; ".join(f"{what}: {', '.join(packages)}" for what, packages in lists.items() if packages)
    if not extra:
        return fail(name, found, advice)
    if missing:
        lacks = f" completely (missing: {', '.join(missing)})" if has_any else ""
        return ok(name, f"is not installed{lacks}; to install it: {advice}")
    return warn(name, found, advice)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])


def look_at_modules(profile: Profile) -> Iterator[Finding]:
    """Import every module of a profile in another process.

    Raises:
        ProfileError: something named as a module class is not one, or a setting is wrong.
    """
    yield check_modules(len(profile.modules), preflight(profile).failures)


def check_modules(count: int, failures: Mapping[str, str]) -> Finding:
    """Judge the modules by the tracebacks of those that cannot be imported."""
    if not failures:
        return ok("modules", f"all {count} can be imported")
    last_lines = {name: text.strip().splitlines()[-1] for name, text in failures.items() if text.strip()}
    found = "; ".join(f"{name} cannot be imported: {line}" for name, line in last_lines.items())
    needs_package = any("No module named" in line for line in last_lines.values())
    advice = (
        "install what is missing: pip install" if needs_package else "fix the error; `robbie run` shows more"
    )
    return fail("modules", found or ", ".join(failures), advice)
