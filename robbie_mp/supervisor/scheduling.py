"""Give a process the scheduling that its profile asks for."""

import logging
import os

from robbie_mp.errors import RobbieError
from robbie_mp.profile.model import Scheduling
from robbie_mp.stepping_back import step_back
from robbie_mp.wake_latency import DEVICE, HOW_TO_ALLOW, limit_wake_latency


class NoSuchCpu(RobbieError, ValueError):
    """A profile binds a process to processors of which this machine lets it use none."""


def apply_scheduling(wanted: Scheduling, log: logging.Logger, nice: int = 0) -> None:
    """Schedule this process as wanted; what is not permitted is warned of, for a robot can do without.

    Args:
        wanted: what the profile says.
        log: where warnings go.
        nice: how far it steps back behind others if the profile does not say.

    Raises:
        NoSuchCpu: there is none of the processors it is to run on.
    """
    if wanted.cpus:
        try:
            os.sched_setaffinity(0, wanted.cpus)
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
        step_back(nice, log)
    if wanted.realtime_priority:
        # Its children would be real-time processes too, without anyone having asked for it.
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        try:
            os.sched_setscheduler(0, policy, os.sched_param(wanted.realtime_priority))
        except PermissionError:
            log.warning(
                "no permission for real-time priority %d, so it runs at ordinary priority; allow it with "
                "`ulimit -r`, rtprio in /etc/security/limits.conf, or CAP_SYS_NICE",
                wanted.realtime_priority,
            )
