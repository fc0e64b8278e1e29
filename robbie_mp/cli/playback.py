"""`robbie playback ORDER`: control the playback of a run, by an order or by single keys."""

import argparse
import math
import os
import re
import secrets
import select
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import closing, contextmanager

from robbie_mp.attached.tool.tool import RunEnded, Tool
from robbie_mp.attached.views.message_text import describe_playback, to_json
from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.declarations import read_declarations
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.output import print_in_place
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.play import rate
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.logs.playback.player import PlaybackRefused
from robbie_mp.messages import PlaybackControl, PlaybackState, as_dict
from robbie_mp.run.run_directory import KnownRun

TIMEOUT_S = 5.0
HELP = "space: pause or resume   .: step   ←, →: 5 s   -, +: rate   m: as fast as possible   q: quit"
KEY = re.compile(rb"\x1b\[[A-D]|.", re.DOTALL)
QUIT = b"q"
LEFT, RIGHT = b"\x1b[D", b"\x1b[C"
SEEK_S = 5.0
LOOK_EVERY_S = 0.05


class NoPlayback(RobbieError, TimeoutError):
    """No playback in the run has answered."""


class NoTerminal(RobbieError, OSError):
    """Keys can be read from a terminal alone."""


def add_parser(subparsers: Commands) -> None:
    """Add `playback` to the commands."""
    parser = add_command(
        subparsers,
        "playback",
        "control the playback of a run",
        "Pause, resume or step a running playback, or change its position or rate.",
        [
            "robbie playback pause",
            "robbie playback step",
            "robbie playback seek 1min30s",
            "robbie playback rate 4",
        ],
    )
    orders = parser.add_subparsers(title="orders", metavar="ORDER", required=True)
    for name, meaning in (
        ("pause", "pause messages and the run's clock"),
        ("resume", "continue playing"),
        ("step", "pause, and play one message"),
    ):
        add_run_argument(add_command(orders, name, meaning, meaning, [f"robbie playback {name}"]))
    seek = add_command(
        orders, "seek", "jump to a position", "Jump to a position.", ["robbie playback seek 1min30s"]
    )
    seek.add_argument("value", metavar="TIME", type=time_between(0), help="time of the recording")
    pace = add_command(orders, "rate", "change the speed", "Change the speed.", ["robbie playback rate 4"])
    pace.add_argument(
        "value", metavar="R|max", type=rate, help="times real time; max: as fast as possible without loss"
    )
    for name, order in orders.choices.items():
        order.set_defaults(command=steer, order=name)
        order.add_argument("--json", action="store_true", help="print JSON for a program to read")
    keys = add_command(
        orders,
        "keys",
        "control it with single keys",
        "Control it with single keys.",
        ["robbie playback keys"],
    )
    keys.set_defaults(command=steer_with_keys)
    add_run_argument(keys)
    for order in (seek, pace):
        add_run_argument(order)


def steer(arguments: argparse.Namespace) -> int:
    """Give a command, and print the state of the playback after it."""
    state = give_order(choose_run(arguments.run), arguments.order, getattr(arguments, "value", 0.0))
    print(to_json(as_dict(state)) if arguments.json else describe_playback(state))
    return 0


def give_order(run: KnownRun, order: str, value: float) -> PlaybackState:
    """Give an order to the playback of a run, and return its state after it.

    Raises:
        ControlRefused: the playback cannot follow the order.
        NoPlayback: there is no playback, or it has not answered in time.
    """
    request = secrets.randbits(63)
    with closing(Tool(run, f"robbie playback {order}")) as tool:
        tool.subscribe(PlaybackState.type_name, PlaybackState.version)
        tool.ready()
        if not tool.wait_for(lambda: tool.is_subscribed() and _plays(run), TIMEOUT_S):
            raise NoPlayback(f"there is no playback in run {run.run_id}; `robbie play` starts one")
        tool.publish(PlaybackControl(request=request, command=order, value=value), "")
        answer: list[PlaybackState] = []

        def has_answered() -> bool:
            while not answer and (received := tool.take()):
                state = PlaybackState.decode(received.data)
                answer.extend([state] if state.request == request else [])
            return bool(answer)

        if not tool.wait_for(has_answered, TIMEOUT_S):
            raise NoPlayback(f"the playback of run {run.run_id} has not answered within {TIMEOUT_S:g} s")
    if answer[0].error:
        raise PlaybackRefused(answer[0].error)
    return answer[0]


def _plays(run: KnownRun) -> bool:
    """Whether a playback has started."""
    declared = read_declarations(run.run_id)
    return any(entry.is_publisher and entry.type_name == PlaybackState.type_name for entry in declared)


def order_of(key: bytes, state: PlaybackState) -> PlaybackControl | None:
    """Return the order that a key gives to a playback; None if the key means nothing."""
    begin_ns = state.begin.nanoseconds
    at_s, end_s = ((time.nanoseconds - begin_ns) / 1e9 for time in (state.position, state.end))
    speed = state.rate if math.isfinite(state.rate) else 1.0
    orders = {
        b" ": ("resume" if state.paused else "pause", 0.0),
        b".": ("step", 0.0),
        LEFT: ("seek", max(0.0, at_s - SEEK_S)),
        RIGHT: ("seek", min(end_s, at_s + SEEK_S)),
        b"-": ("rate", speed / 2),
        b"+": ("rate", speed * 2),
        b"m": ("rate", math.inf),
    }
    if key not in orders:
        return None
    command, value = orders[key]
    return PlaybackControl(command=command, value=value)


def steer_with_keys(arguments: argparse.Namespace) -> int:
    """Take orders from the keyboard until `q`, or until the run ends.

    Raises:
        NoTerminal: there is none.
    """
    run = choose_run(arguments.run)
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise NoTerminal("keys are read from a terminal; without one give orders: robbie playback pause")
    print(HELP)
    with closing(Tool(run, "robbie playback keys")) as tool, _single_keys() as terminal:
        tool.subscribe(PlaybackState.type_name, PlaybackState.version)
        tool.ready()
        state, shown = PlaybackState(), ""
        try:
            while True:
                ready, _, _ = select.select([terminal], [], [], LOOK_EVERY_S)
                for key in KEY.findall(os.read(terminal, 64)) if ready else ():
                    if key == QUIT:
                        return 0
                    if order := order_of(key, state):
                        tool.publish(order, "")
                while received := tool.take():
                    state = PlaybackState.decode(received.data)
                line = f"{describe_playback(state)}  {state.error}" if state.file else ""
                if line != shown:
                    print_in_place(line)
                    shown = line
                tool.wait(0.0)
        except RunEnded:
            return 0
        finally:
            print()


@contextmanager
def _single_keys() -> Iterator[int]:
    """Have each key delivered at once and not shown; Ctrl-C works as always."""
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    try:
        yield terminal
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
