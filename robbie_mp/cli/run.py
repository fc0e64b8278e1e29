"""`robbie run PROFILE`: run a robot, show what happens, and print a summary at the end."""

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from robbie_mp.attached.views.run_figures import as_data
from robbie_mp.base.balance import Balance
from robbie_mp.base.problem import refuse
from robbie_mp.bus.checkpoint.file import checkpoint_file, set_aside
from robbie_mp.cli.clean import recover_power_losses, sweep_dead_runs
from robbie_mp.cli.log_files import LEFT_OUT, print_balance
from robbie_mp.cli.output import say, warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.profile import add_profile_arguments, load
from robbie_mp.cli.run_summary import print_summary
from robbie_mp.cli.screen import RunScreen
from robbie_mp.logs.black_box.salvage import salvage
from robbie_mp.logs.black_box.spool import spool_folders
from robbie_mp.run.doctor.needs import Needs
from robbie_mp.run.profile.model import BLACK_BOX, Profile
from robbie_mp.run.profile.preflight import Preflight, preflight, runnable, what_failed
from robbie_mp.run.profile.workspace import is_class
from robbie_mp.run.results import remove_oldest
from robbie_mp.run.supervisor.run import RunResult, default_output_directory, run_profile


def add_parser(subparsers: Commands) -> None:
    """Add `run` to the commands."""
    parser = add_command(
        subparsers,
        "run",
        "run a robot until it ends or you press Ctrl-C",
        "Start each module of a profile as a process, restart modules that die, and stop all of them in "
        "order at Ctrl-C (a second Ctrl-C kills them). Exit code 0: the run ended well; 1: a module is "
        "FAILED, never came up or did not end in order, so its results may be missing; 2: bad usage or "
        "profile; 3: the run ended in order, but a module had been DEGRADED for 5 s or more when it stopped.",
        [
            "robbie run robot",
            "robbie run sim/arena --set mapping.resolution_m=0.1",
            "robbie run robot --var simulated=true --without camera",
            "robbie run robot --reload",
            "robbie run robot --only laser,mapping",
            "robbie run robot.laser:Laser --set laser.rate_hz=10",
            "robbie run robot --quiet --json > summary.json",
            "robbie run robot --another",
        ],
    )
    add_profile_arguments(parser)
    add_output_arguments(parser)
    parser.add_argument(
        "--fresh",
        action="store_true",
        help="start without the checkpoints of earlier runs (they are renamed, not deleted)",
    )
    parser.add_argument(
        "--another", action="store_true", help="start a second robot, although one of this workspace runs"
    )
    parser.add_argument(
        "--reload",
        action="store_true",
        help="restart modules whose source files are saved, if the new code can be imported",
    )
    parser.set_defaults(command=run)


def add_output_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of commands that run a robot: output directory and printed output."""
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="folder for results and logs (output/PROFILE/TIME)"
    )
    parser.add_argument("--quiet", action="store_true", help="print only failures and the summary")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run a profile."""
    profile, findings = check(load(arguments).with_black_box())
    _check_descriptors(profile)
    if arguments.fresh:
        _set_checkpoints_aside(profile)
    if arguments.reload:
        profile = replace(profile, spares=replace(profile.spares, count=max(1, profile.spares.count)))
    is_robot = not is_class(arguments.profile)
    return run_robot(profile, findings, arguments, is_robot=is_robot, reloads=arguments.reload)


def check(profile: Profile) -> tuple[Profile, Preflight]:
    """Check a profile before its run; return it without the optional modules that cannot be imported."""
    findings = preflight(profile)
    checked = runnable(profile, findings)
    running = {module.name for module in checked.modules}
    for name, failure in findings.failures.items():
        outcome = "is started nevertheless" if name in running else "is left out"
        warn(f"module {name} cannot be imported, and {outcome}: {what_failed(failure)}")
    return checked, findings


def run_robot(
    profile: Profile,
    findings: Preflight,
    arguments: argparse.Namespace,
    balance_of: Callable[[Path], Balance | None] = lambda _folder: None,
    *,
    is_robot: bool = False,
    reloads: bool = False,
) -> int:
    """Run a checked profile to its end, show what happens, and print a summary.

    Args:
        profile: the profile.
        findings: of the check.
        arguments: those of `add_output_arguments`.
        balance_of: returns what was left out, from the folder for results; this makes the exit code 1.
        is_robot: whether it is the robot of its workspace, which runs once unless `arguments.another`.
        reloads: whether modules are restarted when their source files are saved.
    """
    sweep_dead_runs()
    output = arguments.output or default_output_directory(profile.name)
    recover_power_losses(spool_folders(output))
    if arguments.output is None:
        _remove_oldest_results(output.parent, profile.trace.kept_runs)
    count = sum(module.name != BLACK_BOX for module in profile.modules)
    heading = f"{profile.name}: {count} module{'s' * (count != 1)}; results in {output}; Ctrl-C ends the run"
    screen = RunScreen(quiet=arguments.quiet or arguments.json, heading=heading)
    started_s = time.monotonic()
    summary: dict[str, object] = {}

    def summarize(result: RunResult) -> str:
        summary.update(_summary(profile.name, result, time.monotonic() - started_s))
        return json.dumps(summary, indent=2) + "\n"

    with screen:
        types = findings.types.values()
        result = run_profile(
            profile,
            findings.settings,
            types,
            output,
            replace(screen.listener, end=_end_black_box),
            summarize,
            is_robot=is_robot,
            another=is_robot and arguments.another,
            reloads=reloads,
        )
    if result.unwritten:
        print(
            f"the disk of {result.output_directory} has stalled: {result.unwritten} pieces of trace and "
            "summary were not yet written when the run ended; they will be if the disk recovers",
            file=sys.stderr,
        )
    if result.refused:
        print(
            f"{result.output_directory} did not take {result.refused} pieces of trace and summary "
            f"({result.refusal}), so they are lost; make room, or choose another folder with --output",
            file=sys.stderr,
        )
    balance = balance_of(result.output_directory) or Balance()
    if arguments.json:
        played = {"balance": {"used": balance.used, "left_out": balance.left_out}} if balance.read else {}
        print(json.dumps(summary | played, indent=2))
    else:
        print_summary(result, summary["duration_s"])
    if balance.read:
        print_balance(result.output_directory, balance, file=sys.stderr if arguments.json else sys.stdout)
    return result.exit_code or (LEFT_OUT if balance.left_out else 0)


def _check_descriptors(profile: Profile) -> None:
    """Refuse to start a robot whose processes may not open what they need.

    Raises:
        ProfileError: they may not.
    """
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    needed = Needs.of(profile).descriptors_to_start
    if limit not in (resource.RLIM_INFINITY, -1) and limit < needed:
        raise refuse(
            f"{profile.name} takes {needed} open files to start, and a process may have {limit}: "
            f"`ulimit -n {needed}`; see `robbie doctor {profile.name}`"
        )


def _end_black_box(run_id: str, folder: Path) -> None:
    """Write the clips of a black box that was killed at the end of its run."""
    for line in salvage(run_id, folder, has_died=False):
        say(line)


def _remove_oldest_results(folder: Path, kept: int) -> None:
    """Remove results beyond the profile's bound, before this run adds its own."""
    if removed := remove_oldest(folder, kept):
        print(
            f"removed the {len(removed)} oldest results in {folder}; trace.kept_runs keeps {kept}, and those "
            "with recordings",
            file=sys.stderr,
        )


def _set_checkpoints_aside(profile: Profile) -> None:
    for module in profile.modules:
        aside = set_aside(checkpoint_file(profile.workspace, profile.name, module.name), "replaced")
        if aside is not None:
            print(f"{module.name} starts fresh; its last checkpoint is kept as {aside}", file=sys.stderr)


def _summary(profile_name: str, result: RunResult, duration_s: float) -> dict[str, object]:
    return {
        "profile": profile_name,
        "exit_code": result.exit_code,
        "reason": result.reason,
        "degraded": result.degraded,
        "duration_s": round(duration_s, 3),
        "output_directory": str(result.output_directory),
        "modules": [
            as_data(figures)
            | {
                "trace_entries": result.entries.get(figures.name, 0),
                "trace_entries_dropped": result.entries_dropped.get(figures.name, 0),
            }
            for figures in result.figures
        ],
    }
