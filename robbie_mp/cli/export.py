"""`robbie export FILE OUT`: the messages of a log in formats of others, or as a bag of ROS 2."""

import argparse
from collections.abc import Iterable, Sequence
from itertools import count
from pathlib import Path

from robbie_mp.base.balance import Balance
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli.export_forms import CSV, NPZ, PLY, TRAJECTORIES, Form, Rows, new_files, parquet, pictures
from robbie_mp.cli.export_size import is_wanted, sizes
from robbie_mp.cli.file_names import file_names
from robbie_mp.cli.log_files import (
    LEFT_OUT,
    add_limit_argument,
    add_log_argument,
    add_strict_argument,
    add_topics_argument,
    print_balance,
    progress_bar,
    warn_of_unmatched,
)
from robbie_mp.cli.output import warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.connect.bridge.bag_export import bridge_of_log, export_bag
from robbie_mp.logs.recording.decoding import logged_type
from robbie_mp.logs.recording.errors import NotDecodable
from robbie_mp.logs.recording.reader import Log, LogChannel, open_log, select
from robbie_mp.messages import Message
from robbie_mp.messages.errors import SchemaError


def add_parser(subparsers: Commands) -> None:
    """Add `export` to the commands."""
    parser = add_command(
        subparsers,
        "export",
        "write the messages of a log as tables, pictures, clouds or trajectories, or as a ROS 2 bag",
        "Write one file per channel of a log into a folder. Each message is a row: its publishing time, its "
        "sequence number, and a column for each number and text in it. The arrays of all messages are one "
        "numpy array, which NAME.lengths splits again. With --png and --ply, each image or cloud is a file, "
        "named after its stamp, in its channel's folder. With --rosbag2, OUT is a bag of ROS 2 with the "
        "names that the robot's bridge gives. The command asks before it writes more than 1 GB.",
        [
            "robbie export logs/monday tables",
            "robbie export monday.mcap arrays --npz --topics odom 'laser/*'",
            "robbie export monday.mcap pictures --png --topics front/camera",
            "robbie export logs/monday tracks --trajectory tum --topics odom",
            "robbie export logs/monday monday_bag --rosbag2",
        ],
    )
    add_log_argument(parser)
    parser.add_argument(
        "folder", metavar="OUT", type=Path, help="folder to write to; created if it does not exist"
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--csv", action="store_true", help="write CSV files, and arrays as .npy (the default)")
    form.add_argument("--npz", action="store_true", help="write numpy .npz files")
    form.add_argument("--parquet", action="store_true", help="write Parquet files, for pandas and the like")
    form.add_argument("--png", action="store_true", help="write images as PNG files, and nothing else")
    form.add_argument("--ply", action="store_true", help="write point clouds and scans as PLY files, only")
    form.add_argument(
        "--trajectory", choices=("tum", "kitti"), help="write poses as trajectories of TUM or KITTI, only"
    )
    form.add_argument("--rosbag2", action="store_true", help="write a bag of ROS 2 (MCAP and metadata.yaml)")
    parser.add_argument("--yes", "-y", action="store_true", help="do not ask before writing more than 1 GB")
    add_topics_argument(parser)
    add_limit_argument(parser)
    add_strict_argument(parser)
    parser.set_defaults(command=export)


def export(arguments: argparse.Namespace) -> int:
    """Write the files."""
    if arguments.rosbag2:
        return _export_bag(arguments)
    form = _form(arguments)
    balance = Balance(is_strict=arguments.strict)
    with open_log(arguments.log, arguments.limits) as log, new_files(arguments.folder) as files:
        chosen = [channel for channel in _chosen(log, arguments.topics) if form.takes(channel)]
        if form.types and not chosen:
            warn(f"{arguments.log} has no {form.name}" + " on these topics" * bool(arguments.topics))
            return LEFT_OUT
        types = _types(log, chosen, balance)
        if not is_wanted(arguments.folder, sizes(log, types, form), yes=arguments.yes):
            print("nothing was written")
            return LEFT_OUT
        with progress_bar(f"writing {arguments.folder}") as progress:
            done, total = count(1), sum(log.counts[channel] for channel in types)
            for channel, name in file_names(list(types)).items():
                rows = Rows(log, channel, types[channel], balance, lambda: progress(next(done), total))
                form.write(rows, files, name + form.suffix)
        log.count_damage(balance)
    return print_balance(arguments.folder, balance)


def _types(log: Log, channels: Iterable[LogChannel], balance: Balance) -> dict[LogChannel, type[Message]]:
    """Return the types of the channels that can be decoded."""
    types = {}
    for channel in channels:
        try:
            types[channel] = logged_type(channel)
        except (NotDecodable, SchemaError) as error:
            balance.leave_out(str(error), log.counts[channel])
    return types


def _form(arguments: argparse.Namespace) -> Form:
    if arguments.trajectory:
        return TRAJECTORIES[arguments.trajectory]
    if arguments.png:
        return pictures()
    if arguments.parquet:
        return parquet()
    return PLY if arguments.ply else NPZ if arguments.npz else CSV


def _chosen(log: Log, topics: Sequence[str]) -> list[LogChannel]:
    warn_of_unmatched(log.channels, topics)
    return select(log.channels, topics)[0]


def _export_bag(arguments: argparse.Namespace) -> int:
    """Write a bag of ROS 2."""
    folder: Path = arguments.folder
    balance = Balance(is_strict=arguments.strict)
    with open_log(arguments.log, arguments.limits) as log:
        chosen = _chosen(log, arguments.topics)
        bridge = bridge_of_log(log)
        with progress_bar(f"writing {folder}") as progress:
            export_bag(log, folder, chosen, bridge.map, balance, progress)
    exit_code = print_balance(folder, balance)
    if bridge.module:
        print(f"names as the module {one_line(bridge.module)} sends them to ROS 2")
    return exit_code
