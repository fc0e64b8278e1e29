"""The clocks that stamp messages and measure deadlines."""

import ctypes
import time
from collections.abc import Iterator
from pathlib import Path

from robbie_mp.run.doctor.finding import Finding, ok, read_line, warn

CLOCK_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
SLOW_SOURCES = ("hpet", "acpi_pm", "pit", "jiffies", "refined-jiffies")
SLOW_READ_S = 2e-6
COARSE_S = 1e-5
READS = 1000
TIME_ERROR = 5
"""The value that adjtimex(2) returns if no service sets the clock."""
TIMEX_BYTES = 512
"""More than the size of struct timex; all zero, it only reads."""


def look_at_clock() -> Iterator[Finding]:
    """Judge this machine's clocks."""
    began = time.perf_counter()
    for _ in range(READS):
        time.monotonic_ns()
    read_s = (time.perf_counter() - began) / READS
    yield check_monotonic(time.get_clock_info("monotonic").resolution, read_s)
    yield check_source(read_line(CLOCK_SOURCE))
    yield check_synchronised(clock_state())


def clock_state() -> int | None:
    """Return the state of the system's clock from adjtimex(2); None if the call fails."""
    libc = ctypes.CDLL(None, use_errno=True)
    state = int(libc.adjtimex(ctypes.create_string_buffer(TIMEX_BYTES)))
    return None if state < 0 else state


def check_monotonic(resolution_s: float, read_s: float) -> Finding:
    """Judge the monotonic clock: its resolution, and how long reading it takes."""
    found = f"resolution {resolution_s * 1e9:.0f} ns, read in {read_s * 1e9:.0f} ns"
    if resolution_s > COARSE_S:
        return warn("monotonic clock", found, "boot with a kernel that has high-resolution timers")
    if read_s > SLOW_READ_S:
        return warn("monotonic clock", found, "each message reads it several times; see the clock source")
    return ok("monotonic clock", found)


def check_source(source: str | None) -> Finding:
    """Judge the hardware from which the kernel reads the time."""
    if source is None:
        return ok("clock source", "unknown")
    if source in SLOW_SOURCES:
        advice = "the kernel found the faster one unstable: see `dmesg | grep clocksource`; update the BIOS"
        return warn("clock source", f"{source}, which is slow", advice)
    return ok("clock source", source)


def check_synchronised(state: int | None) -> Finding:
    """Judge whether a service sets the system's clock (NTP, PTP), from the state of adjtimex(2)."""
    if state is None:
        return ok("time of day", "the kernel does not report whether a service sets the clock")
    if state == TIME_ERROR:
        return warn(
            "time of day",
            "no service sets the clock: stamps do not match those of other machines, and may jump later",
            "sudo timedatectl set-ntp true, or install chrony",
        )
    return ok("time of day", "the clock is synchronised")
