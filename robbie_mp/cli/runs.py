"""The option that chooses the run that a command acts on."""

import argparse

from robbie_mp.run.live_runs import NoSuchRun, choose_run, live_runs

__all__ = ["NoSuchRun", "add_run_argument", "choose_run", "live_runs"]


def add_run_argument(parser: argparse.ArgumentParser, *also: str) -> None:
    """Add the option that names a run, and further names for it."""
    run = parser.add_argument(
        "--run",
        *also,
        metavar="ID",
        help="id of the run, or its beginning, if there are several (see `robbie list`)",
    )
    run.completer = lambda **_: [known.run_id for known in live_runs()]  # type: ignore[attr-defined]
