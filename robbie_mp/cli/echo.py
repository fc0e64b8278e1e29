"""`robbie echo TYPE|TOPIC`: print messages as they arrive."""

import argparse
import sys
import time
from collections.abc import Callable
from contextlib import closing
from typing import Any

from robbie_mp.attached.tool.message_stream import MessageStream
from robbie_mp.attached.tool.tool import Received, RunEnded
from robbie_mp.attached.views.message_text import FieldPath, flat, to_csv, to_json, to_yaml
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.transport.declarations import read_declarations
from robbie_mp.cli.channel_choice import add_messages_argument, choose_messages, nobody_publishes
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.logs.capture.recorded_run import RecordedRun
from robbie_mp.messages import DecodeError, Message

SAY_MISSED_EVERY_S = 1.0


def add_parser(subparsers: Commands) -> None:
    """Add `echo` to the commands."""
    parser = add_command(
        subparsers,
        "echo",
        "print messages as they arrive",
        "Print the messages of a type, or on a topic. The robot does not wait for you: messages that arrive "
        "faster than they can be printed are skipped, and counted on standard error.",
        [
            "robbie echo LaserScan",
            "robbie echo laser/front",
            "robbie echo sensor_msgs/LaserScan --topic laser/front --field 'ranges[0]'",
            "robbie echo Odometry --once --json | jq .message.pose",
            "robbie echo Odometry --field pose.pose.position --csv > track.csv",
        ],
    )
    add_messages_argument(parser, "with TYPE: only messages on this topic")
    parser.add_argument(
        "--field", metavar="FIELD", default="", help="print only this field, such as pose.position.x"
    )
    parser.add_argument("--once", action="store_true", help="stop after one message")
    parser.add_argument("--full", action="store_true", help="print long arrays in full")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print each message as one line of JSON")
    form.add_argument("--csv", action="store_true", help="print CSV: column names, then a line per message")
    add_run_argument(parser)
    parser.set_defaults(command=echo)


def echo(arguments: argparse.Namespace) -> int:
    """Print messages until the run ends or the user presses Ctrl-C."""
    run = choose_run(arguments.run)
    types, channel = choose_messages(run, arguments)
    message_type = types.get(channel.type_name, channel.version)
    field = FieldPath(message_type, arguments.field)
    purpose = f"robbie echo {channel.type_name}" + (f" --topic {channel.topic}" if channel.topic else "")
    if not arguments.once:
        published = {entry.name for entry in read_declarations(run.run_id) if entry.is_publisher}
        if said := nobody_publishes(channel, published):
            _note(f"{said}; waiting")
    with (
        closing(RecordedRun(run.folder)) as recorded,
        closing(MessageStream(run, [channel], purpose)) as stream,
    ):
        return _Echo(message_type, field, arguments, recorded.time_ns).print_all(stream)


class _Echo:
    """Prints messages one after the other."""

    def __init__(
        self,
        message_type: type[Message],
        field: FieldPath,
        arguments: argparse.Namespace,
        time_ns: Callable[[int], int],
    ):
        self._type = message_type
        self._field = field
        self._arguments = arguments
        self._time_ns = time_ns
        """Returns the run's time, as in its logs, for a time of the monotonic clock."""
        self._printed = 0
        self._said_missed = 0
        self._next_say_s = 0.0

    def print_all(self, stream: MessageStream) -> int:
        """Print messages as they arrive. Return the exit code."""
        try:
            for received in stream:
                self._print(received)
                self._say_missed(stream)
                if self._arguments.once:
                    return 0
        except RunEnded:
            _note("the run has ended")
            return int(self._arguments.once)
        finally:
            if not self._arguments.once or stream.missed:
                _note(f"printed {self._printed}, missed {stream.missed}")
        return 0

    def _print(self, received: Received) -> None:
        arguments = self._arguments
        full = arguments.full or arguments.json or arguments.csv or bool(arguments.field)
        try:
            value = self._field.value(self._type.decode(received.data), full=full)
        except DecodeError as error:
            _note(f"message {received.sequence} from {received.sender} cannot be read: {error}")
            return
        if arguments.json:
            print(to_json(self._envelope(received) | {"message": value}), flush=True)
        elif arguments.csv:
            row = self._envelope(received) | dict(flat(value, arguments.field))
            if not self._printed:
                print(to_csv(list(row)))
            print(to_csv(list(row.values())), flush=True)
        else:
            about = f"topic {received.topic}, " if received.topic else ""
            print(one_line(f"--- # {about}from {received.sender}, sequence {received.sequence}"))
            print(to_yaml(value), flush=True)
        self._printed += 1

    def _say_missed(self, stream: MessageStream) -> None:
        now_s = time.monotonic()
        if now_s >= self._next_say_s:
            self._next_say_s = now_s + SAY_MISSED_EVERY_S
            missed = stream.missed
            if missed > self._said_missed:
                _note(f"missed {missed - self._said_missed} messages")
                self._said_missed = missed

    def _envelope(self, received: Received) -> dict[str, Any]:
        """Return what a log would say about a message, in the same columns as `robbie export`."""
        return {
            "time_ns": self._time_ns(received.published_ns),
            "sequence": received.sequence,
            "topic": received.topic,
            "sender": received.sender,
        }


def _note(text: str) -> None:
    print(f"({one_line(text)})", file=sys.stderr, flush=True)
