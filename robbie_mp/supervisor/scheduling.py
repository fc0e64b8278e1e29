"""Give a process the scheduling that its profile asks for."""

import contextlib
import logging
import os
from collections.abc import Mapping

from robbie_mp.errors import RobbieError
from robbie_mp.linux.priority import for_all_threads, lower_priority
from robbie_mp.linux.wake_latency import DEVICE, HOW_TO_ALLOW, limit_wake_latency
from robbie_mp.profile.model import Scheduling

COMPUTE_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
"""Where libraries look, when they are loaded, for how many threads they may compute with."""


class NoSuchCpu(RobbieError, ValueError):
    """A profile binds a process to processors of which this machine lets it use none."""


def apply_scheduling(wanted: Scheduling, log: logging.Logger, nice: int = 0) -> None:
    """Schedule all threads of this process as wanted; what is not permitted is warned of, and done without.

    Threads that it starts later inherit all but the real-time priority: see `prefer_new_threads`.

    Args:
        wanted: what the profile says.
        log: where warnings go.
        nice: how far it steps back behind others if the profile does not say.

    Raises:
        NoSuchCpu: there is none of the processors it is to run on.
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
                "processors sleep as deep as usual, for %s cannot be written (%s); %s",
                DEVICE,
                error.strerror,
                HOW_TO_ALLOW,
            )
    nice = nice if wanted.nice is None else wanted.nice
    if nice:
        lower_priority(nice, log)
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
    """Give threads that were started since `apply_scheduling` the real-time priority too, if there is one.

    They do not inherit it, for a process that this one starts would do so as well.
    """
    if wanted.realtime_priority:
        with contextlib.suppress(PermissionError):  # which was told then
            _run_at(wanted.realtime_priority)


def _run_at(realtime_priority: int) -> None:
    policy, priority = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(realtime_priority)
    for_all_threads(lambda thread: os.sched_setscheduler(thread, policy, priority))


def computing_with(environment: Mapping[str, str], compute_threads: int) -> dict[str, str]:
    """Return an environment for libraries to compute with so many threads; 0: as many as they like."""
    if not compute_threads:
        return dict(environment)
    return {**environment, **dict.fromkeys(COMPUTE_THREAD_VARIABLES, str(compute_threads))}
