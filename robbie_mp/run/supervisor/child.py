"""The entry point of a child: `python -m robbie_mp.run.supervisor.child RUN_FOLDER NAME [INCARNATION]`.

The core and the modules need different imports, so each is imported only when it is needed.
"""

import contextlib
import faulthandler
import io
import logging
import os
import signal
import sys
import traceback
from pathlib import Path
from typing import NoReturn

from robbie_mp.base.linux.prctl import die_with_parent, set_process_name
from robbie_mp.run.plan import CORE, RunPlan
from robbie_mp.run.supervisor.breakpoints import open_debugger_at_breakpoints
from robbie_mp.run.supervisor.leftovers import MARKER
from robbie_mp.run.supervisor.tracebacks import leave_out_our_frames
from robbie_mp.run.trace.channel import ChannelHandler, log_to_supervisor
from robbie_mp.run.trace.kinds import follow_level


def main(run_folder: Path, name: str, incarnation: int) -> None:
    """Run the core or a module until it is stopped."""
    leave_interrupts_to_supervisor()
    plan = RunPlan.load(run_folder)
    die_with_parent(plan.supervisor_pid)
    run_child(run_folder, plan, name, incarnation)


def leave_interrupts_to_supervisor() -> None:
    """Ignore SIGINT from now on: the supervisor gets it, too, and stops all children in order.

    A terminal sends it to the supervisor alone, but a service manager may send it to all processes. This is a
    handler and not SIG_IGN, so programs that a module starts do not inherit it.
    """
    signal.signal(signal.SIGINT, lambda _signal, _frame: None)
    os.register_at_fork(after_in_child=lambda: signal.signal(signal.SIGINT, signal.default_int_handler))


def own_incarnation() -> int:
    """Return the incarnation with which the supervisor marked this process."""
    return int(os.environ[MARKER].rpartition("/")[2])


def run_child(run_folder: Path, plan: RunPlan, name: str, incarnation: int) -> NoReturn:
    """Run one incarnation of the core or a module, then end the process."""
    own_pid = os.getpid()
    os.umask(0o077)  # results and whatever else it writes: others need no access
    set_process_name(name)
    faulthandler.enable()  # it also handles SIGABRT, which the supervisor sends to a child that hangs
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(
                errors="backslashreplace"
            )  # printing an undecodable file name must not end the process
    channel = log_to_supervisor()
    follow_level(run_folder, name)
    code = 1
    try:
        code = _outcome(run_folder, plan, name, incarnation, channel, own_pid)
    finally:  # also if it cannot be reported
        _flush()
        # Threads, pools and finalizers that a module leaves running must not delay a stop or a restart.
        os._exit(code & 0xFF)


def _outcome(
    run_folder: Path, plan: RunPlan, name: str, incarnation: int, channel: ChannelHandler | None, own_pid: int
) -> int:
    """Run the core or a module, report the exception that ended it, and return the exit code."""
    try:
        if name == CORE:
            from robbie_mp.run.supervisor.core_child import run_core  # noqa: PLC0415

            run_core(plan)
        else:
            from robbie_mp.run.supervisor.module_child import run_module  # noqa: PLC0415

            open_debugger_at_breakpoints(run_folder)
            run_module(run_folder, plan, name, incarnation)
    except SystemExit as end:
        if isinstance(end.code, str):
            logging.getLogger(name).error("%s", end.code)
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException as error:  # every exception is logged, then the process ends
        if os.getpid() != own_pid:
            _end_fork(name, error)
        leave_out_our_frames(error)  # of the exception; in Python 3.10, sys.exc_info() still has them
        more = _memory_limit(plan, name) if isinstance(error, MemoryError) else _advice(name, error)
        logging.getLogger(name).critical("%s: %s%s", type(error).__name__, error, more, exc_info=error)
        if channel is None or channel.dropped:
            traceback.print_exception(error)
        return 1
    return 0


def _flush() -> None:
    """Write what waits in streams and logs."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):  # a module may have closed or replaced it
            stream.flush()
    with contextlib.suppress(Exception):
        logging.shutdown()


def _end_fork(name: str, error: BaseException) -> NoReturn:
    """End a process that a module forked and that failed, or that returned from the fork into our code."""
    logging.getLogger(name).error(
        "a process that this module forked ended with %s: %s. A forked process must not return from the code "
        "that forked it: end it with os._exit(), or start it with multiprocessing.get_context('spawn')",
        type(error).__name__, error, exc_info=error,
    )  # fmt: skip
    os._exit(1)


def _advice(name: str, error: BaseException) -> str:
    if name == CORE:  # which need not import what modules do
        return ""
    from robbie_mp.run.supervisor.advice import advice  # noqa: PLC0415

    return advice(error)


def _memory_limit(plan: RunPlan, name: str) -> str:
    process_bytes = plan.modules[plan.names.index(name) - 1].memory.process_bytes if name != CORE else None
    return f" (the profile allows memory.process_bytes {process_bytes})" if process_bytes else ""


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]) if sys.argv[3:] else own_incarnation())
