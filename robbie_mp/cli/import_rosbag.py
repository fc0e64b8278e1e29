"""`robbie import-rosbag IN OUT`: make a log of a bag of ROS."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from robbie_mp.cli.log_files import print_conversion, progress_bar
from robbie_mp.cli.parser import add_command
from robbie_mp.recording.rosbag_import import import_rosbag as convert

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `import-rosbag` to the commands."""
    parser = add_command(
        subparsers,
        "import-rosbag",
        "make a log of a bag of ROS 1 or ROS 2",
        "Make a log of a bag. Messages of ROS 1 become what they are in ROS 2; types that are not known here "
        "keep their definitions. Needs the library rosbags: pip install 'robbie-mp[ros]'.",
        ["robbie import-rosbag drive.bag drive.mcap", "robbie import-rosbag rosbag2_folder drive.mcap"],
    )
    parser.add_argument(
        "source", metavar="IN", type=Path, help="a .bag of ROS 1, or the folder of a bag of ROS 2"
    )
    parser.add_argument("target", metavar="OUT", type=Path, help="the new log, an MCAP file")
    parser.set_defaults(command=import_rosbag)


def import_rosbag(arguments: argparse.Namespace) -> int:
    """Convert the bag."""
    with progress_bar(f"importing {arguments.source.name}") as progress:
        done = convert(arguments.source, arguments.target, progress=progress)
    return print_conversion(arguments.target, done)
