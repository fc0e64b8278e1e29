"""`robbie pub TYPE|TOPIC YAML`: publish messages by hand."""

import argparse
import time
from contextlib import closing, suppress

from robbie_mp.attached.tool.tool import Tool
from robbie_mp.attached.views.message_text import message_of_yaml
from robbie_mp.bus.transport.declarations import read_declarations
from robbie_mp.bus.transport.segment import SegmentMissing
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.cli.amounts import whole_between
from robbie_mp.cli.channel_choice import add_messages_argument, choose_messages, nobody_subscribes
from robbie_mp.cli.output import warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.messages import Header, Message, Time, check_well_formed, replace
from robbie_mp.run.run_directory import KnownRun


def add_parser(subparsers: Commands) -> None:
    """Add `pub` to the commands."""
    parser = add_command(
        subparsers,
        "pub",
        "publish messages by hand",
        "Publish a message, once or at a rate. Fields you do not give have their default values. The message "
        "is checked before it is sent.",
        [
            "robbie pub DriveCommand '{linear_m_per_s: 0.1, valid_for: {sec: 1}}'",
            "robbie pub initial_pose '{header: {frame_id: map}, pose: {position: {x: 2.5}}}'",
            "robbie pub geometry_msgs/Twist '{linear: {x: 0.1}}' --topic teleop --rate 10",
        ],
    )
    add_messages_argument(parser, "with TYPE: topic to publish on")
    parser.add_argument(
        "message", metavar="YAML", nargs="?", default="{}", help="fields of the message ('{}')"
    )
    parser.add_argument("--rate", metavar="HZ", type=_rate, help="publish repeatedly, until Ctrl-C")
    parser.add_argument(
        "--latched",
        action="store_true",
        help="have the core keep the newest message of the topic for modules and tools that come later",
    )
    parser.add_argument(
        "--count", metavar="N", type=whole_between(1), help="with --rate: stop after N messages"
    )
    add_run_argument(parser)
    parser.set_defaults(command=pub)


def _rate(text: str) -> float:
    rate_hz = float(text)
    if not 0 < rate_hz <= 1000:
        raise argparse.ArgumentTypeError(f"expected more than 0 and at most 1000 Hz; got {text}")
    return rate_hz


def based_on_now(message: Message) -> Message:
    """Return a command that does not say what it rests on with the time of its input, which is now."""
    if getattr(message, "based_on", None) != Time():
        return message
    now = Time.from_nanoseconds(time.time_ns())
    header: Header = message.header  # type: ignore[attr-defined]
    if header.stamp == Time():  # a link needs both, because it knows no clock but its own
        header = replace(header, stamp=now)
    return replace(message, header=header, based_on=now)


def subscriptions_of(run: KnownRun) -> list[ChannelName]:
    """Return what the modules of a run, and its tools, subscribe to now."""
    with suppress(SegmentMissing):
        return [one.name for one in read_declarations(run.run_id) if not one.is_publisher]
    return []


def pub(arguments: argparse.Namespace) -> int:
    """Publish; 1 if a message was refused because the robot's memory or tables are full."""
    run = choose_run(arguments.run)
    types, channel = choose_messages(run, arguments)
    message = message_of_yaml(types.get(channel.type_name, channel.version), arguments.message)
    check_well_formed(message)
    count = 1 if arguments.rate is None else arguments.count
    published = refused = 0
    next_s = time.monotonic()
    with closing(Tool(run, f"robbie pub {message.type_name}")) as tool:
        tool.ready()
        try:
            while count is None or published + refused < count:
                while (wait_s := next_s - time.monotonic()) > 0:
                    tool.wait(wait_s)
                sent = tool.publish(based_on_now(message), channel.topic, arguments.latched)
                published, refused = published + sent, refused + (not sent)
                next_s = max(next_s + 1 / (arguments.rate or 1), time.monotonic() - 1)
        finally:
            print(f"published {published}" + (f", {refused} refused" if refused else ""))
    if hint := nobody_subscribes(channel, subscriptions_of(run)):
        warn(hint)
    return int(refused > 0)
