"""The processors: how many this process may use, and whether they run at full speed."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from robbie_mp.base.linux.wake_latency import DEVICE, HOW_TO_ALLOW
from robbie_mp.run.doctor.finding import Finding, ok, read_line, warn
from robbie_mp.run.doctor.needs import Needs

PROCESSORS = Path("/sys/devices/system/cpu")
QUOTA = Path("/sys/fs/cgroup/cpu.max")
ENOUGH_PROCESSORS = 2
DYNAMIC_DRIVERS = ("intel_pstate", "amd-pstate-epp")
"""With these drivers, the governor named `powersave` does follow the load."""


def look_at_processors(needs: Needs | None) -> Iterator[Finding]:
    """Judge this machine's processors."""
    yield check_count(len(os.sched_getaffinity(0)), read_line(QUOTA))
    folders = sorted(PROCESSORS.glob("cpu[0-9]*/cpufreq"))
    governors = Counter(line for folder in folders if (line := read_line(folder / "scaling_governor")))
    driver = read_line(folders[0] / "scaling_driver") if folders else None
    yield check_governor(governors, driver)
    yield check_wake_latency(may_limit=os.access(DEVICE, os.W_OK), needs=needs)


def check_count(processors: int, quota: str | None) -> Finding:
    """Judge how many processors this process may use.

    Args:
        processors: by its affinity.
        quota: cpu.max of a container: `max PERIOD` or `QUOTA PERIOD`, in µs.
    """
    share = float(processors)
    match (quota or "").split():
        case [allowed, period] if allowed.isdecimal() and period.isdecimal() and int(period):
            share = min(share, int(allowed) / int(period))
    found = f"{share:g} for this process"
    if share < ENOUGH_PROCESSORS:
        advice = "publisher, core and subscriber take turns; give it two (docker: --cpus, --cpuset-cpus)"
        return warn("processors", found, advice)
    return ok("processors", found)


def check_governor(governors: Mapping[str, int], driver: str | None) -> Finding:
    """Judge the frequency governors.

    Args:
        governors: how many processors have each.
        driver: the driver that sets the frequencies.
    """
    if not governors:
        return ok("frequency", "no governor is reported, as in a virtual machine")
    found = ", ".join(f"{name} ({count})" for name, count in governors.items())
    if "powersave" in governors and driver not in DYNAMIC_DRIVERS:
        advice = "they stay at their lowest frequency: sudo cpupower frequency-set -g schedutil"
        return warn("frequency", found, advice)
    return ok("frequency", found)


def check_wake_latency(*, may_limit: bool, needs: Needs | None) -> Finding:
    """Judge whether a robot may keep processors from deep sleep.

    Args:
        may_limit: whether the device for this can be written.
        needs: the robot's needs; None: unknown.
    """
    may = "may" if may_limit else "may not"
    found = f"a robot {may} keep processors from deep sleep ({DEVICE})"
    if needs is not None and needs.limits_wake_latency and not may_limit:
        return warn("wake latency", f"{found}; {needs.profile} asks for it", HOW_TO_ALLOW)
    return ok("wake latency", found)
