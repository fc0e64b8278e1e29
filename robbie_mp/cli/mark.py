"""`robbie mark [TEXT]`: mark a moment, and have the black box write a clip."""

import argparse
import json
import time
from contextlib import closing

from robbie_mp.attached.tool.tool import Tool
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.observe import RunObserver
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.logs.black_box.module import CLIP_TOPIC, MARK, TRIGGER_CHARACTERS
from robbie_mp.messages import Clip, Header, Mark, Time
from robbie_mp.run.profile.model import BLACK_BOX

WAIT_S = 10.0
OPEN_S = 2.0


class NotMarked(RobbieError, TimeoutError):
    """Nobody has confirmed a mark.

    Example scenarios:
      - the black box was killed at that moment, or the machine is too busy
    """


def add_parser(subparsers: Commands) -> None:
    """Add `mark` to the commands."""
    parser = add_command(
        subparsers,
        "mark",
        "mark a moment of a run, and keep the messages around it",
        "Mark a moment. The mark is a message, so all logs have it. The black box writes a clip with the "
        "messages from before and after it; the command prints its folder as soon as the clip is begun.",
        ["robbie mark", 'robbie mark "it hit the table"', "robbie mark --json"],
    )
    parser.add_argument("text", nargs="?", default="", metavar="TEXT", help="what has happened")
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    add_run_argument(parser)
    parser.set_defaults(command=mark)


def mark(arguments: argparse.Namespace) -> int:
    """Publish a mark, and wait until the black box has it."""
    run = choose_run(arguments.run)
    text = arguments.text or "by hand"
    with closing(RunObserver(run.run_id)) as observer:
        has_box = any(module.name == BLACK_BOX for module in observer.modules())
    with closing(Tool(run, "robbie mark")) as tool:
        tool.subscribe(Clip.type_name, Clip.version, CLIP_TOPIC)
        tool.ready()
        tool.wait_for(tool.is_subscribed, OPEN_S)
        stamp = Time.from_nanoseconds(time.time_ns())
        if not tool.publish(Mark(header=Header(stamp=stamp), text=text), ""):
            raise NotMarked("the mark was refused, because the memory of the run is full; try again")
        clip = _wait(tool, text) if has_box else None
    if arguments.json:
        print(json.dumps({"text": text, "clip": clip}))
    else:
        print(f"marked; clip {one_line(clip)}" if clip else "marked in the logs; this run has no black box")
    return 0


def _wait(tool: Tool, text: str) -> str:
    """Return the folder of the clip that has the mark."""
    wanted = one_line(f"{MARK}{text}")[:TRIGGER_CHARACTERS]
    since_s = time.time() - OPEN_S
    until_s = time.monotonic() + WAIT_S
    while time.monotonic() < until_s:
        received = tool.take()
        if received is None:
            tool.wait(0.1)
            continue
        clip = Clip.decode(received.data)
        if wanted in clip.triggers and clip.stamp.nanoseconds > since_s * 1e9:
            return clip.folder
    raise NotMarked(f"the mark was published, but {BLACK_BOX} has not confirmed it within {WAIT_S:g} s")
