"""`robbie clips`: what the black boxes of this workspace's robots have written."""

import argparse
import json
from pathlib import Path

from rich.text import Text

from robbie_mp.attached.views import quantities
from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import write_private
from robbie_mp.base.utc import time_text
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli.clean import recover_power_losses, sweep_dead_runs
from robbie_mp.cli.output import console
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.logs.black_box.clip_folder import CLIPS, PINNED, SavedClip, saved_clips
from robbie_mp.logs.black_box.spool import SPOOL

OUTPUT = Path("output")


class NoSuchClip(RobbieError, LookupError):
    """No clip has that name.

    Example scenarios:
      - it was removed, because newer ones needed its space
      - the results are in another folder than output; name it with --in
    """


def add_parser(subparsers: Commands) -> None:
    """Add `clips` to the commands."""
    parser = add_command(
        subparsers,
        "clips",
        "list what black boxes have kept, or pin it",
        "List the clips in the results of runs: the messages around a crash, an emergency stop, a mark. Each "
        "is a log, for `robbie info`, `play` and all the others. The oldest are removed when newer ones need "
        "their space, but pinned ones stay.",
        [
            "robbie clips",
            "robbie clips --in results --json",
            "robbie clips --pin 20261128T213000Z-mark-it-hit-the-table",
        ],
    )
    parser.add_argument(
        "--in", dest="folder", type=Path, metavar="DIR", default=OUTPUT, help="folder with results (output)"
    )
    parser.add_argument("--pin", metavar="CLIP", help="keep a clip, by its name")
    parser.add_argument("--unpin", metavar="CLIP", help="let a clip be removed again")
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.set_defaults(command=clips)


def clips(arguments: argparse.Namespace) -> int:
    """Pin, unpin, and list, after what killed runs and power cuts have left has become clips."""
    sweep_dead_runs()
    recover_power_losses(path for path in arguments.folder.rglob(SPOOL) if path.is_dir())
    folders = [path for path in arguments.folder.rglob(CLIPS) if path.is_dir() and not path.is_symlink()]
    if arguments.pin:
        write_private(_found(arguments.pin, folders).folder / PINNED, "")
    if arguments.unpin:
        (_found(arguments.unpin, folders).folder / PINNED).unlink(missing_ok=True)
    found = saved_clips(folders)
    if arguments.json:
        print(json.dumps([_as_data(clip) for clip in found], indent=2))
    elif not found:
        print(f"there are no clips in {arguments.folder}")
    else:
        _print(found)
    return 0


def _found(name: str, folders: list[Path]) -> SavedClip:
    for clip in saved_clips(folders):
        if name in (clip.folder.name, str(clip.folder)):
            return clip
    raise NoSuchClip(f"there is no clip {name!r}; `robbie clips` lists them")


def _as_data(clip: SavedClip) -> dict[str, object]:
    about = clip.about
    return {
        "folder": str(clip.folder),
        "bytes": clip.bytes,
        "pinned": clip.is_pinned,
        "run": about.run_id if about else "",
        "profile": about.profile if about else "",
        "triggers": about.triggers if about else [],
        "times": [time_text(time_s) for time_s in about.times_s] if about else [],
        "more": about.more if about else 0,
        "missing": about.missing if about else "it is not described: still being written, or given up",
    }


def _print(found: list[SavedClip]) -> None:
    table = PlainTable()
    for heading in ("clip", "size", "pinned", "what happened"):
        table.add_column(heading, shrinks=heading == "what happened", no_wrap=True)
    for clip in found:
        data = _as_data(clip)
        what = "; ".join(clip.about.triggers) if clip.about else ""
        what += f" ({data['missing']})" if data["missing"] else ""
        size = quantities.size(clip.bytes)
        table.add_row(
            Text(one_line(str(clip.folder))),
            Text(size),
            "yes" if clip.is_pinned else "-",
            Text(one_line(what)),
        )
    console().print(table)
