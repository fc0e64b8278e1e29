"""`robbie call SERVICE YAML`: send a request to the module that serves it, and print the reply."""

import argparse
import sys
from contextlib import closing

from robbie_mp.attached.tool.tool_bus import ToolBus
from robbie_mp.attached.views.known_types import types_of_run
from robbie_mp.attached.views.message_text import FieldPath, message_of_yaml, to_json, to_yaml
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli import completers
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_robot_argument, add_run_argument, choose_run
from robbie_mp.messages import Message
from robbie_mp.messages.calls import FEEDBACK_SUFFIX, GOAL_SUFFIX, RESULT_SUFFIX, response_name
from robbie_mp.messages.descriptions import KnownTypes
from robbie_mp.module.calls.calls import Calls
from robbie_mp.module.calls.errors import CallError

TIMEOUT_S = 5.0


def add_parser(subparsers: Commands) -> None:
    """Add `call` to the commands."""
    parser = add_command(
        subparsers,
        "call",
        "send a request to a module, and print the reply",
        "Send a request to the module that serves it, and print the reply. Or send a goal: print each "
        "feedback as a line of JSON, then the result; Ctrl-C cancels the goal. `robbie list services` lists "
        "what a run serves. Fields you do not give have their default values. Exit code 1: there is no reply "
        "or result; the error says why.",
        [
            "robbie call NavigateTo '{pose: {pose: {position: {x: 2.5}}}}'",
            "robbie call FindPath '{x_m: 2.0, y_m: 1.0}'",
            "robbie call my_robot/FindPath --topic fast --timeout 20 --json",
        ],
    )
    service = parser.add_argument(
        "service",
        metavar="SERVICE",
        help="service or action: my_robot/srv/FindPath, or FindPath",
    )
    service.completer = completers.services  # type: ignore[attr-defined]
    parser.add_argument(
        "request", metavar="YAML", nargs="?", default="{}", help="fields of the request ('{}')"
    )
    parser.add_argument("--topic", default="", help="name of the service, if the module gave it one")
    parser.add_argument(
        "--timeout",
        metavar="TIME",
        type=time_between(0),
        help="time to wait for the reply (5s; for a goal: any)",
    )
    parser.add_argument("--json", action="store_true", help="print the reply as one line of JSON")
    add_run_argument(parser)
    add_robot_argument(parser)
    parser.set_defaults(command=call)


def call(arguments: argparse.Namespace) -> int:
    """Call, and print what comes back."""
    run = choose_run(arguments.run)
    types = types_of_run(run)
    name = types.find_request(arguments.service)
    caller = _Caller(types, name, message_of_yaml(types.get(name), arguments.request), arguments)
    with closing(ToolBus(run, f"robbie call {arguments.service}")) as bus:
        return caller.run(bus)


class _Caller:
    """Sends one request or goal, and prints feedback and reply.

    Args:
        types: the types of the run.
        name: full name of the request's type.
        request: the request or goal.
        arguments: of the command.
    """

    def __init__(self, types: KnownTypes, name: str, request: Message, arguments: argparse.Namespace):
        base = name.removesuffix(GOAL_SUFFIX)
        self._is_goal = base != name
        self._request = request
        self._replies = types.get(base + RESULT_SUFFIX if self._is_goal else response_name(name))
        self._feedbacks = types.get(base + FEEDBACK_SUFFIX) if self._is_goal else None
        self._arguments = arguments
        self._end: Message | CallError | None = None

    def run(self, bus: ToolBus) -> int:
        """Send it, and wait for the end."""
        calls = bus.make_calls()
        number = calls.client.call(
            self._request,
            self._replies,
            self._set_end,
            self._set_end,
            self._arguments.timeout or (None if self._is_goal else TIMEOUT_S),
            self._arguments.topic,
            self._feedbacks,
            self._print,
        )
        while self._end is None:
            try:
                self._wait(bus, calls)
            except KeyboardInterrupt:
                if not (self._is_goal and calls.client.cancel(number, "Ctrl-C")):
                    raise
                print("(cancelling; Ctrl-C again leaves the goal alone)", file=sys.stderr, flush=True)
                self._is_goal = False
        if isinstance(self._end, CallError):
            raise type(self._end)(one_line(str(self._end)))  # a server's words may have more lines
        self._print(self._end)
        return 0

    def _wait(self, bus: ToolBus, calls: Calls) -> None:
        while self._end is None:
            bus.work_for(calls)

    def _set_end(self, end: Message | CallError) -> None:
        self._end = end

    def _print(self, message: Message) -> None:
        value = FieldPath(type(message), "").value(message)
        value.pop("call")
        is_line = self._arguments.json or type(message) is self._feedbacks
        print(to_json(value) if is_line else to_yaml(value), flush=True)
