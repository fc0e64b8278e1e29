"""`robbie play FILE [PROFILE]`: play a log, for tools to look at, or in place of a robot's devices."""

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robbie_mp.cli import completers
from robbie_mp.cli.log_files import add_limit_argument
from robbie_mp.cli.parser import add_command
from robbie_mp.cli.profile import add_set_argument
from robbie_mp.cli.run import add_output_arguments, run_robot
from robbie_mp.profile.load import load_profile
from robbie_mp.profile.model import ClockSettings, ModuleSpec, Profile
from robbie_mp.profile.preflight import preflight
from robbie_mp.profile.problem import ProfileError, refuse
from robbie_mp.profile.workspace import find_workspace
from robbie_mp.recording.limits import MEGABYTE, READ_LIMITS

if TYPE_CHECKING:
    from argparse import _SubParsersAction

PLAYBACK = "playback"
CLASS = "robbie_mp.services.playback:Playback"


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `play` to the commands."""
    parser = add_command(
        subparsers,
        "play",
        "play a log, alone or into a robot",
        "Publish the messages of a log as they were recorded; the run's clock is the log's. Alone, for tools "
        "such as `robbie echo`, `hz` and `record` to look at; or into a profile that has a module `playback` "
        "where the real robot has its devices. `robbie playback` steers it from another terminal.",
        [
            "robbie play output/demo/log.mcap",
            "robbie play log.mcap demo-playback --rate max",
            "robbie play log.mcap --start 60 --end 90 --loop --topics 'laser/*' odom",
            "robbie play log.mcap demo-playback --lockstep",
        ],
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="an MCAP file, or a folder with its parts")
    profile = parser.add_argument(
        "profile", metavar="PROFILE", nargs="?", help="a profile with a module `playback`; without: no robot"
    )
    profile.completer = completers.profiles  # type: ignore[attr-defined]
    parser.add_argument(
        "--rate", metavar="R|max", type=rate, help="times real time (1); max: as fast as nothing is lost"
    )
    parser.add_argument("--start", metavar="S", type=float, help="begin so long after the log's begin")
    parser.add_argument("--end", metavar="S", type=float, help="end so long after the log's begin")
    parser.add_argument("--loop", action="store_true", default=None, help="begin again at the end")
    parser.add_argument(
        "--topics",
        metavar="PATTERN",
        nargs="+",
        help="shell patterns; for messages without a topic, of the last part of their type",
    )
    parser.add_argument("--paused", action="store_true", default=None, help="wait for `robbie playback`")
    parser.add_argument(
        "--lockstep",
        action="store_true",
        help="the next message only when all is over that came of the last: the same results every time",
    )
    add_limit_argument(parser)
    add_set_argument(parser)
    add_output_arguments(parser)
    parser.set_defaults(command=play)


def rate(text: str) -> float:
    """Read a rate; `max` is infinity."""
    found = math.inf if text == "max" else float(text)
    if not found > 0:
        raise argparse.ArgumentTypeError(f"expected more than 0, or max; got {text}")
    return found


def play(arguments: argparse.Namespace) -> int:
    """Play a log."""
    settings = _settings(arguments)
    if arguments.profile:
        profile = _robot(arguments.profile, settings, arguments.overrides)
    elif arguments.overrides:
        raise refuse("--set changes a profile; name one behind the log")
    else:
        profile = _alone(settings)
    if arguments.lockstep:
        profile = replace(profile, clock=replace(profile.clock, lockstep=True))
    return run_robot(profile, preflight(profile), arguments)


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the playback's settings as far as they are given."""
    names = {"start": "start_s", "end": "end_s", "loop": "loop", "topics": "topics", "paused": "paused"}
    given = {name: getattr(arguments, option) for option, name in names.items()}
    settings = {name: value for name, value in given.items() if value is not None}
    settings["file"] = str(arguments.file.absolute())
    if arguments.limits != READ_LIMITS:
        settings["max_chunk_mib"] = arguments.limits.chunk_bytes // MEGABYTE
    if arguments.rate is not None:
        settings["rate"] = None if math.isinf(arguments.rate) else arguments.rate
    return settings


def _alone(settings: dict[str, Any]) -> Profile:
    """Return a profile with nothing but the playback."""
    playback = ModuleSpec(PLAYBACK, CLASS, {"rate": 1.0, **settings}, essential=True, ends_run=True)
    try:
        workspace = find_workspace(Path.cwd()).root
    except ProfileError:
        workspace = Path.cwd()
    return Profile("play", (playback,), clock=ClockSettings(source=PLAYBACK), workspace=workspace)


def _robot(name: str, settings: dict[str, Any], overrides: Sequence[str]) -> Profile:
    """Return the robot's profile with what its playback is to play.

    Raises:
        ProfileError: it has no playback, or something in it is wrong.
    """
    profile = load_profile(name)
    modules = {module.name for module in profile.modules}
    if PLAYBACK in modules and profile.clock.source != PLAYBACK:
        raise refuse(
            f"profile {name!r} needs `clock: {{source: {PLAYBACK}}}`: who plays a log turns the clock"
        )
    if PLAYBACK not in modules:
        raise refuse(
            f"profile {name!r} has no module {PLAYBACK!r}, only {', '.join(sorted(modules))}; a profile that "
            "plays logs has `parents: [playback]` and null for the modules that the log stands in for"
        )
    given = [f"{PLAYBACK}.{key}={json.dumps(value)}" for key, value in settings.items()]
    return load_profile(name, overrides=[*given, *overrides])
