"""Commands of `robbie` that a robot runs for those at the other ends of its link."""

import codecs
import contextlib
import os
import signal
import subprocess
import sys
import time
from typing import IO, Protocol

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.link.header import ChannelId
from robbie_mp.messages import ToolReply, ToolRequest

TOOLS = ("param", "call", "log", "top")
"""The commands that a robot runs for others."""
PROGRAM = "robbie_mp.cli.remote_tool"
MAX_RUNNING = 4
MAX_REQUEST_BYTES = 60_000
"""Of arguments and input; less than a pipe holds, so that no robot waits for a command to read."""
CHUNK_BYTES = 1 << 16
"""Most bytes of each stream in one reply."""
EXPIRES_S = 5.0
"""Age at which a request is refused: somebody who has waited this long may have given up."""
ALONE_S = 10.0
"""Time without its client after which a command is interrupted."""
GRACE_S = 5.0
"""Time that an interrupted command has until it is killed."""


class ToolRefused(RobbieError, RuntimeError):
    """A robot does not run a command for somebody else.

    Example scenarios:
      - it is none of the commands that may be run
      - as many are running as may
    """


class ToolClients(Protocol):
    """What the link knows of the robots for which commands are run."""

    def is_up(self, robot: str) -> bool:
        """Whether it is heard."""
        ...

    def has_room(self, robot: str, name: ChannelId) -> bool:
        """Whether the last reply on a channel has been sent."""
        ...

    def reply(self, robot: str, reply: ToolReply, name: ChannelId) -> None:
        """Send a reply."""
        ...


def reply_channel(place: int = 0) -> ChannelId:
    """Return the channel for the replies of the command at a place."""
    return ChannelId(ToolReply.type_name, ToolReply.version, f"tool_reply/{place}")


class LinkTools:
    """Runs commands of `robbie` in processes of their own, and sends on what they print.

    Only one reply of each command waits at a time: a command that prints faster than the network carries
    waits at its pipe.

    Args:
        robot: the name of this robot.
        run_id: the run that the commands are about.
        client: whom they are run for.

    Attributes:
        started: commands that were run.
        refused: commands that were not.
    """

    def __init__(self, robot: str, run_id: str, client: ToolClients):
        self._robot, self._run_id, self._client = robot, run_id, client
        self._running: dict[int, _Running] = {}
        self.started = 0
        self.refused = 0

    def take(self, client: str, tool: str, request: ToolRequest, refusal: str = "") -> None:
        """Run a command, interrupt one, or say why not. Call this in the main thread alone.

        Args:
            client: who sent the request.
            tool: the command.
            request: the request.
            refusal: why it is refused; '': it is not.
        """
        try:
            if request.interrupts:
                self._interrupt(client, request.request)
            else:
                self._start(client, tool, request, refusal)
        except ToolRefused as error:
            self.refused += 1
            reply = ToolReply(
                request=request.request, robot=self._robot, error=f"{error}\n", is_over=True, exit_code=1
            )
            self._client.reply(client, reply, reply_channel(MAX_RUNNING))

    def _start(self, client: str, tool: str, request: ToolRequest, refusal: str) -> None:
        if refusal:
            raise ToolRefused(refusal)
        if tool not in TOOLS:
            raise ToolRefused(f"{self._robot} runs {', '.join(TOOLS)} for others; got {tool!r}")
        if sum(len(text.encode()) for text in (request.input, *request.arguments)) > MAX_REQUEST_BYTES:
            raise ToolRefused(f"arguments and input are more than {MAX_REQUEST_BYTES} bytes")
        free = [place for place in range(MAX_RUNNING) if place not in self._running]
        if not free:
            raise ToolRefused(f"{self._robot} runs {MAX_RUNNING} commands for others already; try again")
        try:
            one = _Running(self._robot, client, request, self._command(tool, request), self._run_id)
        except (OSError, ValueError) as error:  # ValueError: a NUL in an argument
            raise ToolRefused(f"{self._robot} cannot start it: {error}") from error
        self._running[free[0]] = one
        self.started += 1
        self._client.reply(client, one.reply("", ""), reply_channel(free[0]))

    def _command(self, tool: str, request: ToolRequest) -> list[str]:
        return [sys.executable, "-m", PROGRAM, str(os.getpid()), tool, *request.arguments]

    def _interrupt(self, client: str, number: int) -> None:
        for one in self._running.values():
            if (one.client, one.number) == (client, number):
                one.interrupt()

    def look_after(self) -> None:
        """Send on what has been printed, and end the commands whose client has gone."""
        now_s = time.monotonic()
        for place, one in list(self._running.items()):
            is_gone = one.is_gone(self._client.is_up(one.client), now_s)
            name = reply_channel(place)
            reply = one.next_reply() if self._client.has_room(one.client, name) else None
            if reply is not None:
                self._client.reply(one.client, reply, name)
            if is_gone or (reply is not None and reply.is_over):
                self._running.pop(place).close()

    def close(self) -> None:
        """Kill all commands."""
        for one in self._running.values():
            one.close()
        self._running.clear()


class _Running:
    """A command that runs."""

    def __init__(self, robot: str, client: str, request: ToolRequest, command: list[str], run_id: str):
        self.client, self.number = client, request.request
        self._robot = robot
        self._replies = 0
        self._heard_s = time.monotonic()
        self._interrupted_s: float | None = None
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "ROBBIE_RUN": run_id, "COLUMNS": str(max(20, request.columns))},
        )
        process = self._process
        assert process.stdin is not None and process.stdout is not None and process.stderr is not None
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(request.input.encode())
            process.stdin.close()
        self._streams = [_Stream(process.stdout), _Stream(process.stderr)]

    def interrupt(self) -> None:
        """Do what Ctrl-C does."""
        self._interrupted_s = self._interrupted_s or time.monotonic()
        self._process.send_signal(signal.SIGINT)

    def is_gone(self, is_up: bool, now_s: float) -> bool:
        """Whether it has to end because its client has been gone for long; interrupt it first."""
        if self._interrupted_s is not None and now_s - self._interrupted_s > GRACE_S:
            self._process.kill()  # its last reply follows
        if is_up:
            self._heard_s = now_s
            return False
        if now_s - self._heard_s > ALONE_S and self._interrupted_s is None:
            self.interrupt()
        return now_s - self._heard_s > ALONE_S + GRACE_S

    def next_reply(self) -> ToolReply | None:
        """Return what it has printed since the last reply; None if that is nothing."""
        code = self._process.poll()  # first: what it printed before is then in the pipes
        output, error = (stream.read() for stream in self._streams)
        if output or error:
            return self.reply(output, error)
        return None if code is None else self.reply("", "", code)

    def reply(self, output: str, error: str, code: int | None = None) -> ToolReply:
        """Return the next reply; the last one if there is an exit code."""
        self._replies += 1
        return ToolReply(
            request=self.number,
            robot=self._robot,
            number=self._replies - 1,
            output=output,
            error=error,
            is_over=code is not None,
            exit_code=0 if code is None else code if code >= 0 else 128 - code,
        )

    def close(self) -> None:
        """End it if it still runs."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()


class _Stream:
    """What a command prints, in pieces that are text."""

    def __init__(self, stream: IO[bytes]):
        self._fd = stream.fileno()
        os.set_blocking(self._fd, False)
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")

    def read(self) -> str:
        """Return what is there, at most CHUNK_BYTES."""
        with contextlib.suppress(BlockingIOError):
            text = self._decoder.decode(os.read(self._fd, CHUNK_BYTES))
            return text.replace("\0", "\N{REPLACEMENT CHARACTER}")  # which no message carries
        return ""
