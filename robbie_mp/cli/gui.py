"""`robbie gui`: an operator station for a robot that is already running."""

import argparse
import json
import logging
import os
import sys
from typing import TYPE_CHECKING

from robbie_mp.attached.tool.tool import RunEnded
from robbie_mp.base.problem import refuse
from robbie_mp.base.yaml_reader import read_text
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.program import signals_noted
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.module.settings import SettingError
from robbie_mp.run.operator_link import read_link
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.run_directory import KnownRun

if TYPE_CHECKING:
    from robbie_mp.station import OperatorStation

NAME = "operator station"
TOKENS = {"operator_token": "ROBBIE_OPERATOR_TOKEN", "observer_token": "ROBBIE_OBSERVER_TOKEN"}
"""Settings that are secrets, and the variables that hold them unless it is said otherwise."""


def add_parser(subparsers: Commands) -> None:
    """Add `gui` to the commands."""
    parser = add_command(
        subparsers,
        "gui",
        "serve the operator's page for a run",
        "Serve the operator's page for a run whose profile has no operator station, until Ctrl-C or the end "
        "of the run. If the page ends while an operator is driving, the base stops the robot.",
        [
            "robbie gui",
            "robbie gui --link",
            "robbie gui --run demo --port 8090",
            "robbie gui --host 0.0.0.0 --operator-token file:operator.token",
            "robbie gui --set 'tabs={drive: Pad, map: Where am I}' --set max_linear_m_per_s=0.3",
        ],
    )
    add_run_argument(parser)
    parser.add_argument("--host", help="address to listen on (127.0.0.1); any other needs a token")
    parser.add_argument("--port", type=int, help="port to listen on (8080); 0: any free port")
    for setting, variable in TOKENS.items():
        parser.add_argument(
            f"--{setting.replace('_', '-')}",
            metavar="PLACE",
            default=f"environment:{variable}" if os.environ.get(variable) else None,
            help=f"where the token is: file:PATH or environment:NAME (environment:{variable}, if set)",
        )
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="SETTING=VALUE",
        action="append",
        default=[],
        help="set any other setting of the operator station; may be repeated",
    )
    parser.add_argument(
        "--link", action="store_true", help="only print the link of the run's own operator station"
    )
    parser.add_argument("--json", action="store_true", help="with --link: print JSON for a program to read")
    parser.set_defaults(command=gui)


def gui(arguments: argparse.Namespace) -> int:
    """Serve the page until the run ends or the user presses Ctrl-C."""
    from robbie_mp.attached.tool.tool_module import run_as_tool  # noqa: PLC0415 - help is waited for, and needs neither
    from robbie_mp.station import OperatorStation, load_website  # noqa: PLC0415

    settings = _settings(arguments)
    run = choose_run(arguments.run)
    if arguments.link:
        return _show_link(run, as_json=arguments.json)
    load_website()
    sys.path.insert(0, RunPlan.load(run.folder).workspace)  # where the panels are that the settings name
    logging.basicConfig(format="%(levelname)s: %(message)s", stream=sys.stderr)
    with signals_noted() as stopped:
        try:
            run_as_tool(
                run, OperatorStation, settings, NAME, on_ready=_announce, is_stopped=lambda: bool(stopped)
            )
        except SettingError as error:
            raise refuse(str(error)) from error
        except RunEnded:
            print("(the run has ended)", file=sys.stderr)
    return 0


def _show_link(run: KnownRun, *, as_json: bool) -> int:
    """Print the link of the run's own operator station."""
    link = read_link(run.folder)
    if not link:
        raise refuse("this run has no operator station; `robbie gui` without --link serves one")
    print(json.dumps({"link": link}) if as_json else link)
    return 0


def _announce(station: "OperatorStation") -> None:
    print(f"operator station: {station.link} (Ctrl-C ends it)", flush=True)


def _settings(arguments: argparse.Namespace) -> dict[str, object]:
    """Return the settings of the station given on the command line.

    Raises:
        ProfileError: one is no YAML, or has no value.
    """
    settings: dict[str, object] = {}
    for override in arguments.overrides:
        name, equals, value = override.partition("=")
        if not equals:
            raise refuse(f"--set {override}: expected SETTING=VALUE")
        settings[name] = read_text(value, f"--set {override}").plain()
    given = {name: getattr(arguments, name) for name in ("host", "port", *TOKENS)}
    return settings | {name: value for name, value in given.items() if value is not None}
