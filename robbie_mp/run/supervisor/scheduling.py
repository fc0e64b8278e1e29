"""Applies the scheduling that a profile sets for a process."""

import contextlib
import logging
import os
from collections.abc import Mapping

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.priority import for_all_threads, lower_priority, set_time_slice
from robbie_mp.base.linux.wake_latency import DEVICE, HOW_TO_ALLOW, limit_wake_latency
from robbie_mp.run.profile.model import Scheduling

COMPUTE_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
"""Variables from which numerical libraries read their number of threads when they are loaded."""


class NoSuchCpu(RobbieError, ValueError):
    """A profile binds a process to processors, none of which it may use on this machine."""


def apply_scheduling(
    wanted: Scheduling, log: logging.Logger, nice: int = 0, slice_ms: float | None = None
) -> None:
    """Apply the scheduling to all threads of this process; log a warning for what is not permitted.

    Threads started later inherit everything except the real-time priority: see `prefer_new_threads`.

    Args:
        wanted: the scheduling from the profile.
        log: receives warnings.
        nice: the nice value to use if the profile sets none.
        slice_ms: the time slice to use if the profile sets none.

    Raises:
        NoSuchCpu: the process may use none of the processors that the profile names.
    """
    if wanted.cpus:
        try:
            for_all_threads(lambda thread: os.sched_setaffinity(thread, wanted.cpus))
        except (OSError, ValueError, OverflowError) as error:
            usable = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
            raise NoSuchCpu(
                f"scheduling.cpus is {wanted.cpus}, but this process may only use {usable} ({error}); "
                "change it in the profile"
            ) from error
    if wanted.wake_latency_us is not None:
        try:
            limit_wake_latency(wanted.wake_latency_us)  # until this process ends
        except OSError as error:
            log.warning(
                "scheduling.wake_latency_us has no effect: %s cannot be written (%s); %s",
                DEVICE,
                error.strerror,
                HOW_TO_ALLOW,
            )
    nice = nice if wanted.nice is None else wanted.nice
    if nice:
        lower_priority(nice, log)
    slice_ms = slice_ms if wanted.slice_ms is None else wanted.slice_ms
    if slice_ms is not None:
        set_time_slice(slice_ms, log)
    if wanted.realtime_priority:
        try:
            _run_at(wanted.realtime_priority)
        except PermissionError:
            log.warning(
                "no permission for real-time priority %d, so it runs at ordinary priority; allow it with "
                "`ulimit -r`, rtprio in /etc/security/limits.conf, or CAP_SYS_NICE",
                wanted.realtime_priority,
            )


def prefer_new_threads(wanted: Scheduling) -> None:
    """Give threads started since `apply_scheduling` the real-time priority too, if one is set.

    Threads do not inherit it, because child processes would inherit it as well.
    """
    if wanted.realtime_priority:
        with contextlib.suppress(PermissionError):  # apply_scheduling has warned
            _run_at(wanted.realtime_priority)


def _run_at(realtime_priority: int) -> None:
    policy, priority = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(realtime_priority)
    for_all_threads(lambda thread: os.sched_setscheduler(thread, policy, priority))


def computing_with(environment: Mapping[str, str], compute_threads: int) -> dict[str, str]:
    """Return an environment that limits libraries to this number of threads; 0: no limit."""
    if not compute_threads:
        return dict(environment)
    return {**environment, **dict.fromkeys(COMPUTE_THREAD_VARIABLES, str(compute_threads))}
