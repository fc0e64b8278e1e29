"""`robbie play FILE [PROFILE]`: play a recording, for tools to read or in place of a robot's devices."""

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from robbie_mp.base.problem import Problem, ProfileError, SourcePlace, refuse
from robbie_mp.cli import completers
from robbie_mp.cli.amounts import LONGEST_S, time_between
from robbie_mp.cli.log_files import add_limit_argument, add_strict_argument
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.profile import add_set_argument, load
from robbie_mp.cli.run import add_output_arguments, check, run_robot
from robbie_mp.logs.playback.module import BALANCE_FILE, played_balance
from robbie_mp.logs.recording.limits import READ_LIMITS
from robbie_mp.logs.recording.time_jumps import LONGEST_GAP_S
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.model import MEASURED, ClockSettings, ModuleSpec, Profile
from robbie_mp.run.profile.preflight import Preflight
from robbie_mp.run.profile.workspace import find_workspace

PLAYBACK = "playback"
CLASS = "robbie_mp.logs.playback.module:Playback"
SETTINGS = {
    "start": "start_s",
    "end": "end_s",
    "loop": "loop",
    "topics": "topics",
    "paused": "paused",
    "strict": "strict",
}
"""Options of this command, and the settings of the playback that they set as they are."""
PLACES = {
    "file": None,  # the error names it
    "rate": SourcePlace("--rate"),
    "max_chunk_bytes": SourcePlace("--max-chunk"),
    "longest_gap_s": SourcePlace("--gaps"),
    **{setting: SourcePlace(f"--{option}") for option, setting in SETTINGS.items()},
}
"""The place of each setting that this command sets."""


def add_parser(subparsers: Commands) -> None:
    """Add `play` to the commands."""
    parser = add_command(
        subparsers,
        "play",
        "play a recording, alone or into a robot's modules",
        "Publish the messages of a recording as they were recorded. The run's clock shows the recording's "
        "time. Without a profile, tools such as `robbie echo`, `hz` and `record` can read them; with one, "
        "its module `playback` replaces the real devices. `robbie playback` controls it from another "
        "terminal.",
        [
            "robbie play output/demo/log.mcap",
            "robbie play log.mcap demo-playback --rate max",
            "robbie play log.mcap --start 1min --end 90s --loop --topics 'laser/*' odom",
            "robbie play log.mcap demo-playback --lockstep",
        ],
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="an MCAP file, or a folder with its parts")
    profile = parser.add_argument(
        "profile",
        metavar="PROFILE",
        nargs="?",
        help="profile with a module `playback`; default: play the recording alone",
    )
    profile.completer = completers.profiles  # type: ignore[attr-defined]
    parser.add_argument(
        "--rate",
        metavar="R|max",
        type=rate,
        help="speed, times real time (1); max: as fast as possible without loss",
    )
    parser.add_argument(
        "--start", metavar="TIME", type=time_between(-LONGEST_S), help="start at this time of the recording"
    )
    parser.add_argument(
        "--end", metavar="TIME", type=time_between(-LONGEST_S), help="stop at this time of the recording"
    )
    parser.add_argument(
        "--gaps",
        metavar="skip|keep|TIME",
        type=gaps,
        help="where the recording's time jumps, forwards or backwards: skip it (skip: jumps of more than "
        f"{LONGEST_GAP_S:g} s, the default; TIME: of more than that), or keep to the recording's time",
    )
    parser.add_argument("--loop", action="store_true", default=None, help="start again at the end")
    parser.add_argument(
        "--topics",
        metavar="PATTERN",
        nargs="+",
        help="play only these topics (shell patterns); messages without a topic go by their short type name",
    )
    parser.add_argument(
        "--paused", action="store_true", default=None, help="start paused; `robbie playback resume` continues"
    )
    parser.add_argument(
        "--lockstep",
        action="store_true",
        help="send each message only after everything caused by the last one is handled: repeatable results",
    )
    parser.add_argument(
        "--charge",
        metavar="measured|FOLDER",
        default="",
        help="with --lockstep: a module is busy as long as its handler took, or took in an earlier run, "
        "whose output has the FOLDER handler_times",
    )
    add_strict_argument(parser)
    add_limit_argument(parser)
    add_set_argument(parser)
    add_output_arguments(parser)
    parser.set_defaults(command=play)


def rate(text: str) -> float:
    """Parse a rate; `max` is infinity."""
    found = math.inf if text == "max" else float(text)
    if not found > 0:
        raise argparse.ArgumentTypeError(f"expected a number greater than 0, or max; got {text}")
    return found


def gaps(text: str) -> float:
    """Parse the longest gap that is no jump, in s; `keep` is infinity."""
    found = {"skip": LONGEST_GAP_S, "keep": math.inf}.get(text)
    return time_between(0)(text) if found is None else found


def play(arguments: argparse.Namespace) -> int:
    """Play a recording."""
    settings = _settings(arguments)
    try:
        profile, findings = _checked(arguments, settings)
    except ProfileError as error:
        raise _as_typed(error, arguments.overrides) from None
    if arguments.output:
        (arguments.output / BALANCE_FILE).unlink(missing_ok=True)  # of an earlier run
    return run_robot(profile, findings, arguments, played_balance)


def _checked(arguments: argparse.Namespace, settings: dict[str, Any]) -> tuple[Profile, Preflight]:
    if arguments.profile:
        profile = _robot(arguments, settings)
    elif arguments.overrides or arguments.variables or arguments.without or arguments.only:
        raise refuse("--set, --var, --without and --only change a profile; name one after the recording")
    else:
        profile = _alone(settings)
    if arguments.charge and not (arguments.lockstep or profile.clock.lockstep):
        raise refuse("--charge works only with --lockstep: otherwise handlers take their own time")
    if arguments.charge:
        charge = arguments.charge if arguments.charge == MEASURED else str(_handler_times(arguments.charge))
        profile = replace(profile, clock=replace(profile.clock, charge=charge))
    if arguments.lockstep:
        profile = replace(profile, clock=replace(profile.clock, lockstep=True))
    return check(profile)


def _as_typed(error: ProfileError, overrides: Sequence[str]) -> ProfileError:
    """Return the error with the arguments of this command in place of the settings that they stand for."""
    typed = {override.partition("=")[0] for override in overrides}
    places = {
        f"--set {PLAYBACK}.{setting}": place
        for setting, place in PLACES.items()
        if f"{PLAYBACK}.{setting}" not in typed
    }
    return ProfileError(
        Problem(
            problem.text.removeprefix(f"modules.{PLAYBACK}.settings: "),
            places.get(str(problem.place), problem.place),
        )
        for problem in error.problems
    )


def _handler_times(given: str) -> Path:
    """Return the folder with the handler times of an earlier run."""
    folder = Path(given).absolute()
    if not any(folder.glob("*.txt")):
        raise refuse(f"{given} has no handler times; name the folder handler_times in the output of a run")
    return folder


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the playback settings given on the command line."""
    given = {name: getattr(arguments, option) for option, name in SETTINGS.items()}
    settings = {name: value for name, value in given.items() if value is not None and value is not False}
    settings["file"] = str(arguments.file.absolute())
    if arguments.limits != READ_LIMITS:
        settings["max_chunk_bytes"] = arguments.limits.chunk_bytes
    if arguments.rate is not None:
        settings["rate"] = None if math.isinf(arguments.rate) else arguments.rate
    if arguments.gaps is not None:
        settings["longest_gap_s"] = None if math.isinf(arguments.gaps) else arguments.gaps
    return settings


def _alone(settings: dict[str, Any]) -> Profile:
    """Return a profile that contains only the playback."""
    playback = ModuleSpec(PLAYBACK, CLASS, {"rate": 1.0, **settings}, essential=True, ends_run=True)
    try:
        workspace = find_workspace(Path.cwd()).root
    except ProfileError:
        workspace = Path.cwd()
    return Profile("play", (playback,), clock=ClockSettings(source=PLAYBACK), workspace=workspace)


def _robot(arguments: argparse.Namespace, settings: dict[str, Any]) -> Profile:
    """Return the robot's profile with the settings of its playback.

    Raises:
        ProfileError: it has no playback, or is wrong otherwise.
    """
    name = arguments.profile
    profile = load_profile(
        name, variables=arguments.variables, without=arguments.without, only=arguments.only
    )
    modules = {module.name for module in profile.modules}
    if PLAYBACK in modules and profile.clock.source != PLAYBACK:
        raise refuse(f"profile {name!r} needs `clock: {{source: {PLAYBACK}}}`: the playback sets the clock")
    if PLAYBACK not in modules:
        raise refuse(
            f"profile {name!r} has no module {PLAYBACK!r}, only {', '.join(sorted(modules))}; a profile that "
            "plays recordings has `parents: [robbie:playback]`, and null for each module that the "
            "recording replaces"
        )
    # A file's name may look like a variable.
    given = [f"{PLAYBACK}.{key}={json.dumps(value).replace('${', '$${')}" for key, value in settings.items()]
    return load(arguments, given)
