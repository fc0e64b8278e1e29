"""`robbie playback keys`: steer a playback with single keys, and see where it stands."""

import math
import os
import re
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

from robbie_mp.attach.tool import RunEnded, Tool
from robbie_mp.cli.output import print_in_place
from robbie_mp.errors import RobbieError
from robbie_mp.messages import PlaybackControl, PlaybackState
from robbie_mp.run.run_directory import KnownRun

HELP = "space: pause or resume   .: step   ←, →: 5 s   -, +: rate   m: as fast as possible   q: quit"
KEY = re.compile(rb"\x1b\[[A-D]|.", re.DOTALL)
QUIT = b"q"
LEFT, RIGHT = b"\x1b[D", b"\x1b[C"
SEEK_S = 5.0
LOOK_EVERY_S = 0.05


class NoTerminal(RobbieError, OSError):
    """Keys can be read from a terminal alone."""


def order_of(key: bytes, state: PlaybackState) -> PlaybackControl | None:
    """Return the order that a key gives to a playback; None if the key means nothing."""
    begin_ns = state.begin.nanoseconds
    at_s, end_s = ((time.nanoseconds - begin_ns) / 1e9 for time in (state.position, state.end))
    rate = state.rate if math.isfinite(state.rate) else 1.0
    orders = {
        b" ": ("resume" if state.paused else "pause", 0.0),
        b".": ("step", 0.0),
        LEFT: ("seek", max(0.0, at_s - SEEK_S)),
        RIGHT: ("seek", min(end_s, at_s + SEEK_S)),
        b"-": ("rate", rate / 2),
        b"+": ("rate", rate * 2),
        b"m": ("rate", math.inf),
    }
    if key not in orders:
        return None
    command, value = orders[key]
    return PlaybackControl(command=command, value=value)


def steer_with_keys(run: KnownRun, describe: Callable[[PlaybackState], str]) -> int:
    """Follow keys until `q`, or until the run ends.

    Args:
        run: the run with the playback.
        describe: says in a line where that stands.

    Raises:
        NoTerminal: there is none.
    """
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
                line = f"{describe(state)}  {state.error}" if state.file else ""
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
    """Let each key come at once, without showing it; Ctrl-C works as always."""
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    try:
        yield terminal
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
