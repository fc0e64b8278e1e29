"""Runs all checks in order; a check that fails is itself a finding."""

from collections.abc import Callable, Iterable

from robbie_mp.base.problem import ProfileError
from robbie_mp.run.doctor.clock import look_at_clock
from robbie_mp.run.doctor.devices import look_at_devices
from robbie_mp.run.doctor.finding import Finding, Level, warn
from robbie_mp.run.doctor.kernel import look_at_kernel
from robbie_mp.run.doctor.limits import look_at_limits
from robbie_mp.run.doctor.memory import look_at_memory
from robbie_mp.run.doctor.needs import Needs
from robbie_mp.run.doctor.permissions import look_at_permissions
from robbie_mp.run.doctor.processor import look_at_processors
from robbie_mp.run.doctor.python import look_at_modules, look_at_python
from robbie_mp.run.doctor.runs import look_at_runs
from robbie_mp.run.profile.model import Profile

Look = Callable[[], Iterable[Finding]]


def examine(profile: Profile | None = None) -> list[Finding]:
    """Run all checks.

    Args:
        profile: the profile to run on this machine; None: judge the machine for a small robot.

    Raises:
        ProfileError: the profile names something that is not a module class, or a setting is wrong.
    """
    needs = Needs.of(profile) if profile else None
    looks: dict[str, Look] = {
        "kernel": look_at_kernel,
        "Python": look_at_python,
        "memory": lambda: look_at_memory(needs),
        "limits": lambda: look_at_limits(needs),
        "processors": lambda: look_at_processors(needs),
        "clock": look_at_clock,
        "permissions": look_at_permissions,
        "runs": look_at_runs,
    }
    if profile:
        looks["modules"] = lambda: look_at_modules(profile)
        looks["devices"] = lambda: look_at_devices(profile)
    return [finding for name, look in looks.items() for finding in guarded(name, look)]


def guarded(name: str, look: Look) -> list[Finding]:
    """Return the findings of one look; any other exception is a finding and ends only this look."""
    findings: list[Finding] = []
    try:
        # Not a comprehension: findings before a failure are kept.
        for finding in look():
            findings.append(finding)
    except ProfileError:
        raise
    except Exception as error:
        found = f"could not be checked: {type(error).__name__}: {error}"
        findings.append(warn(name, found, "report this as a defect of `robbie doctor`"))
    return findings


def worst(findings: Iterable[Finding]) -> Level:
    """Return the worst level among findings."""
    levels = {finding.level for finding in findings}
    return next((level for level in reversed(Level) if level in levels), Level.OK)
