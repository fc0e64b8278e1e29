"""Whether the modules of a profile can be imported here."""

from collections.abc import Iterator, Mapping

from robbie_mp.doctor.finding import Finding, fail, ok
from robbie_mp.profile.model import Profile
from robbie_mp.profile.preflight import preflight


def look_at_modules(profile: Profile) -> Iterator[Finding]:
    """Import every module of a profile, in another process.

    Raises:
        ProfileError: a class is none, or a setting is wrong.
    """
    yield check_modules(len(profile.modules), preflight(profile).failures)


def check_modules(count: int, failures: Mapping[str, str]) -> Finding:
    """Judge the modules by the tracebacks of those that cannot be imported."""
    if not failures:
        return ok("modules", f"all {count} can be imported")
    last_words = {name: text.strip().splitlines()[-1] for name, text in failures.items() if text.strip()}
    found = "; ".join(f"{name} cannot be imported: {line}" for name, line in last_words.items())
    needs_package = any("No module named" in line for line in last_words.values())
    advice = "install what is missing: pip install" if needs_package else "mend it; `robbie run` shows more"
    return fail("modules", found or ", ".join(failures), advice)
