"""`robbie run PROFILE`: run a robot, show what happens, and sum it up at the end."""

import argparse
import json
import sys
import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live

from robbie_mp.checkpoint.file import checkpoint_file, set_aside
from robbie_mp.cli.figures import as_data, console, table
from robbie_mp.cli.profile import add_profile_arguments
from robbie_mp.observe import RunObserver
from robbie_mp.profile.load import load_profile
from robbie_mp.profile.model import Profile
from robbie_mp.profile.preflight import preflight
from robbie_mp.supervisor.output import OutputLine
from robbie_mp.supervisor.run import RunListener, RunResult, default_output_directory, run_profile
from robbie_mp.supervisor.states import ChildState, StateChange

if TYPE_CHECKING:
    from argparse import _SubParsersAction

REFRESH_S = 0.25


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `run` to the commands."""
    parser = subparsers.add_parser(
        "run",
        help="run a profile until it ends or Ctrl-C stops it",
        description="Start every module of a profile in a process of its own, restart what dies, and stop "
        "all in order at Ctrl-C (a second one stops at once). Exit code 0: the run ended well; 1: a module "
        "is FAILED; 2: bad usage or profile.",
    )
    add_profile_arguments(parser)
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="where results and logs go (output/PROFILE/TIME)"
    )
    parser.add_argument(
        "--fresh",
        action="store_true",
        help="set aside the checkpoints that earlier runs left on disk (state/PROFILE/MODULE.checkpoint)",
    )
    parser.add_argument("--quiet", action="store_true", help="print only the summary and what failed")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    parser.set_defaults(command=run)


def run(arguments: argparse.Namespace) -> int:
    """Run a profile."""
    profile = load_profile(arguments.profile, overrides=arguments.overrides)
    findings = preflight(profile)
    if arguments.fresh:
        _set_checkpoints_aside(profile)
    output = arguments.output or default_output_directory(profile.name, datetime.now())
    screen = RunScreen(quiet=arguments.quiet or arguments.json)
    started_s = time.monotonic()
    with screen:
        result = run_profile(profile, findings.settings, output, screen.listener)
    summary = _summary(profile.name, result, time.monotonic() - started_s)
    (result.output_directory / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    if arguments.json:
        print(json.dumps(summary, indent=2))
    else:
        _print_summary(result, summary["duration_s"])
    return result.exit_code


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
        "duration_s": round(duration_s, 3),
        "output_directory": str(result.output_directory),
        "modules": [as_data(figures) for figures in result.figures],
    }


def _print_summary(result: RunResult, duration_s: object) -> None:
    out = console()
    out.print(table(result.figures, live=False))
    out.print(f"run ended after {duration_s} s: {result.reason}; exit code {result.exit_code}")
    out.print("results:", end=" ")
    out.print(str(result.output_directory), soft_wrap=True)


class RunScreen:
    """What a person sees of a run: on a terminal a live table below the lines, else only the lines.

    Args:
        quiet: show only what went wrong.
    """

    def __init__(self, *, quiet: bool):
        self._console = Console(stderr=True, highlight=False)
        self._quiet = quiet
        self._live: Live | None = None
        self._next_s = 0.0
        self.listener = RunListener(self._line, self._change, self._turn)

    def __enter__(self) -> "RunScreen":
        """Begin to show."""
        if self._console.is_terminal and not self._quiet:
            self._live = Live(console=self._console, auto_refresh=False, transient=True)
            self._live.start()
        return self

    def __exit__(self, *_error: object) -> None:
        """Clear the live table."""
        if self._live is not None:
            self._live.stop()

    def _line(self, line: OutputLine) -> None:
        if not self._quiet:
            self._print(f"[{line.name}] {line.text}", "dim" if line.stream == "stdout" else "")

    def _change(self, change: StateChange) -> None:
        if change.new in (ChildState.FAILED, ChildState.BACKOFF):
            again = f", again in {change.restart_in_s:.2f} s" if change.restart_in_s is not None else ""
            self._print(f"{change.name}: {change.new} ({change.reason}{again})", "bold red")
            for text in change.last_lines if self._quiet else ():
                self._print(f"[{change.name}] {text}", "")

    def _turn(self, observer: RunObserver) -> None:
        if self._live is not None and time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + REFRESH_S
            self._live.update(table(observer.modules(), live=True), refresh=True)

    def _print(self, text: str, style: str) -> None:
        if self._live is None:
            print(text, file=sys.stderr, flush=True)
        else:
            self._console.print(text, style=style, markup=False, soft_wrap=True)
