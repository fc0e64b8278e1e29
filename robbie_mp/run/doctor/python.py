"""Python, the packages that Robbie-MP needs, and the modules of a profile."""

import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence

from robbie_mp.base.extras import Requirement, installed, own_requirements, what_to_install
from robbie_mp.bus._hot.choice import why_not
from robbie_mp.run.doctor.finding import Finding, fail, ok, warn
from robbie_mp.run.profile.model import Profile
from robbie_mp.run.profile.preflight import preflight, require_processors, what_failed

OLDEST = (3, 10)
FOR_DEVELOPERS = ("dev", "docs", "bench", "fuzz", "wheels")
"""Extras for those who work on Robbie-MP itself."""


def look_at_python() -> Iterator[Finding]:
    """Judge this Python and its packages."""
    yield check_version(sys.version_info[:2], sys.implementation.name, is_gil_enabled())
    yield check_hot_path(why_not())
    requirements = own_requirements()
    versions = {requirement.package: installed(requirement.package) for requirement in requirements}
    yield from check_packages(requirements, versions)


def is_gil_enabled() -> bool:
    """Whether only one thread runs Python code at a time, as it does before Python 3.13."""
    return bool(getattr(sys, "_is_gil_enabled", lambda: True)())


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
    requirements: Iterable[Requirement], versions: Mapping[str, str | None]
) -> Iterator[Finding]:
    """Judge the packages: those of Robbie-MP itself, each extra with a package that is too old, and the rest.

    An extra that is not installed completely is not in use: single packages of it may be there for another
    reason. What a profile lacks, `look_at_modules` finds.

    Args:
        requirements: the required packages.
        versions: the version of each package, None if it is not installed.
    """
    groups: dict[str, list[Requirement]] = defaultdict(list)
    for requirement in requirements:
        groups[requirement.extra].append(requirement)
    complete: list[str] = []
    incomplete: list[str] = []
    for extra, group in groups.items():
        missing = [one.package for one in group if versions[one.package] is None]
        old = [one for one in group if _is_old(one, versions[one.package])]
        if not extra or (old and not missing):
            yield _judge(extra, missing, old, versions)
        elif extra not in FOR_DEVELOPERS:
            (incomplete if missing else complete).append(extra)
    yield ok("extras", f"installed: {_listed(complete)}; not installed: {_listed(incomplete)}")


def _is_old(requirement: Requirement, version: str | None) -> bool:
    return version is not None and _numbers(version) < _numbers(requirement.oldest)


def _judge(
    extra: str, missing: list[str], old: list[Requirement], versions: Mapping[str, str | None]
) -> Finding:
    name = f"extra {extra}" if extra else "packages"
    if not missing and not old:
        return ok(name, "all are installed")
    too_old = [f"{one.package} {versions[one.package]} (needs {one.oldest})" for one in old]
    lists = {"missing": missing, "too old": too_old}
    found = "; ".join(f"{what}: {', '.join(packages)}" for what, packages in lists.items() if packages)
    advice = f"pip install --upgrade {' '.join([*missing, *(one.package for one in old)])}"
    return warn(name, found, advice) if extra else fail(name, found, advice)


def _listed(names: list[str]) -> str:
    return ", ".join(names) or "none"


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])


def look_at_modules(profile: Profile) -> Iterator[Finding]:
    """Import every module of a profile in another process.

    Raises:
        ProfileError: something named as a module class is not one, or a setting or a processor is wrong.
    """
    require_processors(profile)
    found = preflight(profile)
    yield check_modules(len(profile.modules), found.failures)
    kept = {one.name for one in profile.modules if one.memory.history_bytes is not None}
    yield check_capsules(sorted(found.forgetful & kept), len(kept))


def check_capsules(forgetful: Sequence[str], count: int) -> Finding:
    """Say whose crashes are replayed from their start only as long as the history since then is kept.

    Args:
        forgetful: the modules that never save a checkpoint.
        count: the modules that keep a history.
    """
    found = f"{count} modules keep a history, from which a crash is replayed"
    if forgetful:
        found += (
            "; these have no checkpoints, so that after a while only the newest part is replayed "
            f"(memory.history_bytes): {', '.join(forgetful)}"
        )
    return ok("capsules", found)


def check_modules(count: int, failures: Mapping[str, str]) -> Finding:
    """Judge the modules by the tracebacks of those that cannot be imported."""
    if not failures:
        return ok("modules", f"all {count} can be imported")
    last_lines = {name: what_failed(text) for name, text in failures.items() if text.strip()}
    found = "; ".join(f"{name} cannot be imported: {line}" for name, line in last_lines.items())
    missing = [line for line in last_lines.values() if "No module named" in line]
    advice = "; ".join(dict.fromkeys(map(what_to_install, missing)))
    advice = advice or "fix the error; `robbie run` shows more"
    return fail("modules", found or ", ".join(failures), advice)
