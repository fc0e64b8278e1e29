"""Runs the module of a capsule again, and says whether it crashes as it did."""

import os
import pdb
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robbie_mp.base.linux.address_space import limited_address_space
from robbie_mp.logs.capsule.attempt import LIMIT_S, Outcome, Progress, attempt
from robbie_mp.logs.capsule.outside import Outside, TimeOfThen
from robbie_mp.logs.capsule.pace import Pace
from robbie_mp.logs.capsule.place import END, EXCEPTION, Crash, reported_crash
from robbie_mp.logs.capsule.read import Capsule, Step
from robbie_mp.logs.capsule.replayed import ReplayHarness
from robbie_mp.logs.capsule.variables import set_variables
from robbie_mp.run.supervisor.tracebacks import leave_out_our_frames


@dataclass(frozen=True)
class Verdict:
    """What a replay has shown.

    Attributes:
        is_same: whether it crashed at the same line as then.
        lines: the verdict, to read.
    """

    is_same: bool
    lines: list[str]


def replay(capsule: Capsule, workspace: Path, limit_s: float = LIMIT_S, *, quiet: bool = False) -> Outcome:
    """Run the module of a capsule again in a process of its own.

    Args:
        capsule: the capsule.
        workspace: the folder with the module's code.
        limit_s: a step that takes longer hangs.
        quiet: whether what the module prints is dropped.
    """
    outcome = _replay(capsule, workspace, limit_s, None, quiet=quiet)
    if outcome.details.get("has_threads") and not _is_repeated(capsule, outcome):
        # Its threads may not have got so far as then.
        paced = _replay(capsule, workspace, limit_s, Pace(capsule), quiet=quiet)
        if paced.crash.is_like(reported_crash(capsule.report)):
            return paced
    return outcome


def _is_repeated(capsule: Capsule, outcome: Outcome) -> bool:
    """Whether it crashed at the same line, in the same step."""
    return outcome.step == len(capsule.steps) - 1 and outcome.crash.is_like(reported_crash(capsule.report))


def _replay(capsule: Capsule, workspace: Path, limit_s: float, pace: Pace | None, *, quiet: bool) -> Outcome:
    outside = Outside(workspace)

    def act(progress: Progress, details: dict[str, Any]) -> None:
        def before(number: int, step: Step) -> None:
            progress.show(number)
            if pace is not None:
                pace.wait_for(number, step)

        outside.watch()
        try:
            with harness_of(capsule, workspace, outside) as harness:
                try:
                    with limited_address_space(capsule.manifest.start.more_bytes):
                        harness.run(before)
                finally:
                    _note(harness, details)
        finally:
            details["outside"], details["has_threads"] = outside.noted, outside.has_threads

    return attempt(act, limit_s=limit_s, quiet=quiet)


@contextmanager
def harness_of(capsule: Capsule, workspace: Path, outside: Outside) -> Iterator[ReplayHarness]:
    """Yield the module of a capsule in the environment of then, with Python's clocks at the time of then."""
    start = capsule.manifest.start
    set_variables(capsule.manifest.variables, _code_here(capsule, workspace).values())
    time = TimeOfThen(start.started_ns - start.monotonic_ns, start.monotonic_ns)
    with time.given(outside):
        yield ReplayHarness(capsule, workspace, time)


def _note(harness: ReplayHarness, details: dict[str, Any]) -> None:
    bus = harness.replayed
    if bus.difference is not None:
        details["step"], details["difference"] = bus.difference.step, bus.difference.text
    details["written"] = harness.links.difference
    details["later"] = sorted(harness.told.later)


def judge(capsule: Capsule, outcome: Outcome) -> Verdict:
    """Compare how a module crashed then and in a replay."""
    then, now = reported_crash(capsule.report), outcome.crash
    last = len(capsule.steps) - 1
    where = f"in step {outcome.step} of {last}{', sooner than then' if outcome.step < last else ''}"
    if now.kind == END:
        lines = ["no crash", f"  it was: {then}"]
    elif now.is_like(then):
        same = "the same exception at the same line" if then.kind == EXCEPTION else "the same crash"
        lines = [f"{same}: {now}, {where}"]
    elif now.is_like(then, same_line=False):
        lines = [f"the same crash at another line: {now}, {where}", f"  it was: {then}"]
    else:
        lines = [f"another crash: {now}, {where}", f"  it was: {then}"]
    if outcome.details.get("difference"):
        lines.append(
            f"  first difference, in step {outcome.details['step']}: {outcome.details['difference']}"
        )
    if outcome.details.get("written"):
        lines.append(f"  first difference at the device: {outcome.details['written']}")
    if now.kind == END and outcome.details.get("later"):
        lines.append(f"  it asked more often than then: {', '.join(outcome.details['later'])}")
    if outcome.details.get("outside") and not _is_repeated(capsule, outcome):
        lines.append(f"  a capsule does not hold: {', '.join(outcome.details['outside'])}")
    return Verdict(now.is_like(then), lines)


def debug(
    capsule: Capsule,
    workspace: Path,
    *,
    until: int | None = None,
    steps: bool = False,
    post_mortem: bool = True,
) -> Crash:
    """Run the module of a capsule in this process, under the debugger.

    Args:
        capsule: the capsule.
        workspace: the folder with the module's code.
        until: stop before this step; None: run to the crash.
        steps: stop before each step.
        post_mortem: open the debugger at the exception.
    """
    with harness_of(capsule, workspace, Outside(workspace)) as harness:
        return _debug(capsule, harness, until, is_stepping=steps, post_mortem=post_mortem)


def _debug(
    capsule: Capsule, harness: ReplayHarness, until: int | None, *, is_stepping: bool, post_mortem: bool
) -> Crash:
    stepping = is_stepping

    def before(number: int, step: Step) -> None:
        nonlocal stepping
        if stepping or number == until:
            print(f"step {number} of {len(capsule.steps) - 1}: {step.title}")
            if number == until:
                stop_here(harness)
            elif not _goes_on():
                stepping = False

    try:
        harness.run(before)
    except Exception as error:
        leave_out_our_frames(error)
        if not post_mortem:
            raise
        print(f"{type(error).__name__}: {error}")
        pdb.post_mortem(error.__traceback__)
        return Crash(EXCEPTION, type(error).__name__, str(error))
    print("no crash")
    return Crash(END)


def stop_here(harness: ReplayHarness) -> None:
    """Open the debugger; `module` is the module, and `b FILE:LINE` sets a breakpoint in its code."""
    module = harness.module
    print(f"module is {module.name}; `b FILE:LINE` sets a breakpoint, `c` goes on")
    pdb.Pdb(nosigint=True).set_trace(sys._getframe())


def _goes_on() -> bool:
    """Wait for Enter; False: run on without stopping."""
    try:
        return input("Enter: next step, r: run on > ").strip() != "r"
    except EOFError:
        return False


def environment_of(capsule: Capsule) -> dict[str, str]:
    """Return the environment in which sets have the same order as then."""
    hash_seed = capsule.manifest.start.hash_seed
    is_valid = hash_seed == "random" or (hash_seed.isdecimal() and int(hash_seed) < 1 << 32)
    return {**os.environ, "PYTHONHASHSEED": hash_seed if is_valid else "random"}


def changed_code(capsule: Capsule, workspace: Path) -> list[str]:
    """Return the files of the module's code that are not what they were."""
    import hashlib  # noqa: PLC0415 (only when a capsule is replayed)

    here = _code_here(capsule, workspace)
    changed = []
    for name, code in capsule.manifest.code.items():
        is_same = name in here and hashlib.sha256(here[name].read_bytes()).hexdigest() == code.sha256
        if not is_same and not Path(name).is_absolute():
            changed.append(name)
    return changed


def _code_here(capsule: Capsule, workspace: Path) -> dict[str, Path]:
    """Return the files that a capsule names, which may be forged, as far as they lie in the workspace."""
    places = {name: (workspace / name).resolve() for name in capsule.manifest.code}
    return {
        name: place
        for name, place in places.items()
        if place.is_file() and place.is_relative_to(workspace.resolve())
    }
