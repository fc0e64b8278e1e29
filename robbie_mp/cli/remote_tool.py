"""A command that a robot's link runs for somebody at its other end; see `robbie_mp.connect.link.tools`.

    python -m robbie_mp.cli.remote_tool PID COMMAND …

PID is the process of the link, and ROBBIE_RUN names the run. The command may use no other run, and no files.
"""

import argparse
import os
import sys
from collections.abc import Sequence

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.prctl import die_with_parent
from robbie_mp.cli import main
from robbie_mp.cli.output import plain_output, say
from robbie_mp.cli.program import parser_of
from robbie_mp.connect.link.tools import TOOLS

FILES = ("directory", "file", "csv")
"""The arguments that name files."""


class NotForOthers(RobbieError, PermissionError):
    """Somebody at the other end of a link asks for what a command does only on the robot itself.

    Example scenarios:
      - the command is to write a file on the robot, or to read one
      - it names another run of the robot's machine
    """


def check(argv: Sequence[str]) -> None:
    """Check that a command uses this run alone, and no files.

    Raises:
        NotForOthers: it does not.
    """
    if not argv or argv[0] not in TOOLS:
        raise NotForOthers(f"only {', '.join(TOOLS)} work from elsewhere; got {' '.join(argv[:1])!r}")
    parsed: argparse.Namespace = parser_of(argv).parse_args(argv)
    if parsed.run is not None or parsed.on_robot is not None:
        raise NotForOthers("from elsewhere, a command is about the run of the link; leave out --run")
    for name in FILES:
        if (path := getattr(parsed, name, None)) not in (None, "-"):
            raise NotForOthers(f"{path} would be a file on the robot; write - and redirect it here")


def _run(parent_pid: str, *argv: str) -> int:
    die_with_parent(int(parent_pid))
    os.nice(10)  # the robot comes first
    with plain_output():
        try:
            check(argv)
        except NotForOthers as error:
            say(str(error))
            return 2
    return main(argv)


if __name__ == "__main__":
    sys.exit(_run(*sys.argv[1:]))
