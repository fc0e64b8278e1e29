"""`--robot NAME`: a command that runs on a robot at the other end of this run's link."""

import argparse
import secrets
import shutil
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from typing import Any

from robbie_mp.attached.tool.tool import Received, Tool
from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.observe import RunObserver
from robbie_mp.cli.output import clear_screen, warn
from robbie_mp.cli.runs import choose_run
from robbie_mp.messages import LinkPeer, LinkState, ToolReply, ToolRequest
from robbie_mp.run.run_directory import KnownRun

ANSWER_S = 10.0
"""Time to wait for the first reply, and for the end after Ctrl-C."""
DOWN_S = 10.0
"""Time without the robot after which its command is over; the robot then ends it, too."""
OPEN_S = 2.0


class NotOnRobot(RobbieError, ConnectionError):
    """A command cannot be run on a robot elsewhere.

    Example scenarios:
      - the run on this machine has no link, because `robbie connect` does not run
      - the link to the robot is down
      - the robot's link does not accept commands from here
    """


def run_on_robot(parsed: argparse.Namespace, argv: Sequence[str]) -> int:
    """Have a robot run a command, print what it prints, and return its exit code.

    Args:
        parsed: its arguments, parsed here.
        argv: the same as they were given.

    Raises:
        NotOnRobot: the robot does not run it.
    """
    command, *arguments = _without_places(argv)
    if command == "top" and not (parsed.once or parsed.json or parsed.csv):
        arguments.append("--plain")
    standard_input = sys.stdin.read() if getattr(parsed, "reads_input", False) and parsed.file == "-" else ""
    run = choose_run(parsed.run)
    _check_link(run)
    with closing(Tool(run, f"robbie {command} --robot {parsed.on_robot}")) as tool:
        return _Remote(tool, parsed.on_robot, command).run(arguments, standard_input)


def _without_places(argv: Sequence[str]) -> list[str]:
    """Return the arguments without the options that say where a command is run."""
    places = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    places.add_argument("--robot")
    places.add_argument("--run")
    return places.parse_known_args(argv)[1]


def _check_link(run: KnownRun) -> None:
    with closing(RunObserver(run.run_id)) as observer:
        takes = [one.type_name for module in observer.modules() for one in module.subscriptions]
    if ToolRequest.type_name not in takes:
        raise NotOnRobot(
            f"run {run.run_id} has no link to a robot; start one with `robbie connect ROBOT --at ADDRESS`"
        )


class _Remote:
    """One command on a robot.

    Args:
        tool: attached to the run with the link.
        robot: the robot's name.
        command: such as `param`.
    """

    def __init__(self, tool: Tool, robot: str, command: str):
        self._tool, self._robot, self._command = tool, robot, command
        self._number = secrets.randbits(63)
        self._code: int | None = None
        self._replies = 0
        self._waits_for = "a reply"
        self._until_s: float | None = None
        self._up_s = time.monotonic()
        self._session = 0
        self._clears = False

    def run(self, arguments: Sequence[str], standard_input: str) -> int:
        """Send the request, and print the replies until the last one."""
        tool = self._tool
        self._clears = "--plain" in arguments and sys.stdout.isatty()
        tool.subscribe(ToolReply.type_name, ToolReply.version)
        tool.subscribe(LinkState.type_name, LinkState.version)
        tool.ready()
        tool.wait_for(tool.is_subscribed, OPEN_S)
        columns = shutil.get_terminal_size((160, 24)).columns
        self._send("a reply", arguments=list(arguments), input=standard_input, columns=min(columns, 1000))
        is_interrupted = False
        while self._code is None:
            try:
                self._work()
            except KeyboardInterrupt:
                if is_interrupted:
                    raise
                is_interrupted = True
                self._send("the end of its command", interrupts=True)
        return self._code

    def _send(self, waits_for: str, **fields: Any) -> None:
        self._tool.publish(ToolRequest(request=self._number, robot=self._robot, **fields), self._command)
        self._waits_for, self._until_s = waits_for, time.monotonic() + ANSWER_S

    def _work(self) -> None:
        received = self._tool.take()
        if received is None:
            self._tool.wait()
            self._check_patience()
        elif received.type_name == LinkState.type_name:
            self._take_state(LinkState.decode(received.data))
        else:
            self._take_reply(received)

    def _check_patience(self) -> None:
        now_s = time.monotonic()
        if self._until_s is not None and now_s > self._until_s:
            raise NotOnRobot(f"waited {ANSWER_S:g} s in vain for {self._waits_for} of {self._robot}")
        if now_s - self._up_s > DOWN_S:
            raise NotOnRobot(f"the link to {self._robot} has been down for {DOWN_S:g} s; it ends its command")

    def _take_state(self, state: LinkState) -> None:
        for peer in state.peers:
            if peer.robot == self._robot and peer.is_up:
                self._up_s = time.monotonic()
                self._check_session(peer)

    def _check_session(self, peer: LinkPeer) -> None:
        if self._session and peer.session != self._session:
            raise NotOnRobot(f"the link of {self._robot} has been restarted, which has ended its command")
        self._session = peer.session

    def _take_reply(self, received: Received) -> None:
        reply = ToolReply.decode(received.data)
        if (reply.request, reply.robot) != (self._number, self._robot):
            return
        if self._waits_for == "a reply":
            self._until_s = None
        if reply.number > self._replies:
            warn(f"{reply.number - self._replies} pieces of the output were lost on the way")
        self._replies = reply.number + 1
        self._print(reply)
        if reply.is_over:
            self._code = reply.exit_code

    def _print(self, reply: ToolReply) -> None:
        if self._clears and reply.output:
            clear_screen()
        for text, stream in ((reply.output, sys.stdout), (reply.error, sys.stderr)):
            stream.write(text)
            stream.flush()
