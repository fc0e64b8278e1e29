"""`robbie recording repair`: repair a truncated or damaged recording."""

import argparse
import sys
from pathlib import Path

from robbie_mp.cli.log_files import add_limit_argument, add_log_argument, progress_bar
from robbie_mp.cli.output import warn
from robbie_mp.cli.parser import BAD_USAGE, Commands, add_command
from robbie_mp.logs.recording.bag_metadata import write_bag_metadata
from robbie_mp.logs.recording.errors import RepairFailed
from robbie_mp.logs.recording.format import BAG_METADATA
from robbie_mp.logs.recording.limits import ReadLimits
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.logs.recording.repair import repair, repaired_name


def add_parser(subparsers: Commands) -> None:
    """Add `repair` to the actions of `robbie recording`."""
    parser = add_command(
        subparsers,
        "repair",
        "repair a truncated or damaged recording",
        "Write a new recording with every message of each intact chunk of a truncated or damaged "
        "recording, and verify it by reading it again. The old recording is kept unchanged. In a folder, "
        "each part that needs it is repaired.",
        ["robbie recording repair logs/monday", "robbie recording repair cut.mcap -o whole.mcap"],
    )
    add_log_argument(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="OUT",
        help="the new file (NAME.repaired.mcap beside the old one, which replaces it in a folder of parts)",
    )
    add_limit_argument(parser)
    parser.set_defaults(command=repair_recording)


def repair_recording(arguments: argparse.Namespace) -> int:
    """Repair a file, or the parts of a folder that need it."""
    log: Path = arguments.log
    targets = {log: arguments.output or repaired_name(log)}
    if log.is_dir():
        if arguments.output:
            print(f"{log} is a folder: without -o its parts are repaired where they are", file=sys.stderr)
            return BAD_USAGE
        with open_log(log, arguments.limits) as opened:
            damaged = [part.path for part in opened.parts if not part.is_complete]
        targets = {path: repaired_name(path) for path in damaged}
    if not targets:
        print(f"all parts of {log} are whole")
    try:
        for source, target in targets.items():
            _repair(source, target, arguments.limits)
    except RepairFailed as failure:
        print(failure, file=sys.stderr)
        return 1
    if log.is_dir():
        _describe(log)
    return 0


def _describe(folder: Path) -> None:
    """Write the file by which rosbag2 opens the folder."""
    try:
        reason = write_bag_metadata(folder)
    except OSError as error:
        reason = f"it cannot be written: {error.strerror}"
    if reason:
        warn(f"no {BAG_METADATA} was written, by which rosbag2 opens the folder: {reason}")


def _repair(source: Path, target: Path, limits: ReadLimits) -> None:
    with progress_bar(f"repairing {source.name}") as progress:
        done = repair(source, target, progress, limits)
    for line in done.damage or ["nothing was wrong with it"]:
        print(f"{source}: {line}", file=sys.stderr)
    print(f"{done.target}: {done.messages} messages, read again and found whole")
