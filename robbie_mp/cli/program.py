"""The program `robbie`: finds the command, runs it, and turns its errors into text and an exit code."""

import argparse
import os
import signal
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.bus_error import surviving_truncation
from robbie_mp.base.version import installed_version
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.cli.interrupts import interrupts_end_at_once
from robbie_mp.cli.output import fill_standard_descriptors, finish_output, plain_output, say
from robbie_mp.cli.parser import BAD_USAGE, HelpFormatter, Parser

GROUPS = {
    "run a robot": ("run", "stop", "module", "play", "playback", "connect"),
    "look at a run": (
        "list", "top", "log", "echo", "hz", "bw", "plot", "graph", "type", "gui", "foxglove",
    ),
    "debug a module": (
        "attach", "replay", "shadow",
    ),
    "talk to a run": ("pub", "call", "param", "mark"),
    "record, and use recordings": (
        "record", "clips", "report", "info", "recording", "diff", "export", "import-carmen", "import-rosbag",
    ),
    "set up robots and machines": (
        "new", "profile", "doctor", "devices", "install", "keys", "clean", "completion",
    ),
}  # fmt: skip
"""The commands, in the order in which help lists them."""
COMMANDS = tuple(command for group in GROUPS.values() for command in group)

FAILED = 1


class GroupedHelp(HelpFormatter):
    """Lists the commands in groups."""

    def _format_action(self, action: argparse.Action) -> str:
        """Return the help of an argument, or of all commands; argparse calls this."""
        if not isinstance(action, argparse._SubParsersAction):
            return super()._format_action(action)
        self._indent()
        lines = {one.dest: super(GroupedHelp, self)._format_action(one) for one in action._choices_actions}
        self._dedent()
        return "\n".join(
            f"  {group}:\n{''.join(lines[name] for name in names if name in lines)}"
            for group, names in GROUPS.items()
        )


def run_command(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return 0 on success, 1 if it failed, 2 for bad usage or a bad profile.

    Raises:
        KeyboardInterrupt: the user pressed Ctrl-C.
    """
    fill_standard_descriptors()
    with plain_output():
        try:
            code = _outcome(arguments)
        except SystemExit:  # argparse, after help or an error
            if finish_output():
                raise
            return FAILED
        is_whole = finish_output()
    return code or (0 if is_whole else FAILED)


def _outcome(arguments: Sequence[str] | None) -> int:
    """Run a command, and turn what ends it into text and an exit code."""
    try:
        return _run_command(arguments)
    except RobbieError as error:
        say(str(error))
        return _exit_code(error)
    except OSError as error:
        if finish_output():  # else that was the reason
            say(_of_place(error))
        return FAILED
    except Exception:
        traceback.print_exc()  # inside plain_output, which makes control characters visible
        return FAILED


def _of_place(error: OSError) -> str:
    """Say which file, or which place, the system refused."""
    try:
        Path.cwd()
    except OSError:
        return "the working directory does not exist any more; change to one that exists"
    if isinstance(error, FileExistsError):
        return f"{error.filename} is in the place of a folder; move it away"
    return f"{error.filename}: {error.strerror}" if error.filename else f"the system refused: {error}"


def _run_command(arguments: Sequence[str] | None) -> int:
    argv = list(sys.argv[1:] if arguments is None else arguments)
    if "_ARGCOMPLETE" in os.environ:
        _complete()
    with interrupts_end_at_once():
        parser = parser_of(argv)
    if not argv:
        parser.print_help()
        return 0
    parsed = parser.parse_args(argv)
    if getattr(parsed, "on_robot", None) is not None:
        from robbie_mp.cli.remote import run_on_robot  # noqa: PLC0415

        return run_on_robot(parsed, argv)
    with surviving_truncation(f"{SHARED_MEMORY / names.folder('')}"):  # of a run that it looks at
        code: int = parsed.command(parsed)
    return code


def _complete() -> None:
    """Print the possible completions for the shell, and exit; see `robbie completion`."""
    import argcomplete  # noqa: PLC0415

    argcomplete.autocomplete(parser_of(os.environ.get("COMP_LINE", "").split()[1:2]))


def _exit_code(error: RobbieError) -> int:
    from robbie_mp.base.problem import ProfileError  # noqa: PLC0415
    from robbie_mp.logs.recording.errors import LogError  # noqa: PLC0415

    return BAD_USAGE if isinstance(error, ProfileError | LogError) else FAILED


def parser_of(argv: Sequence[str]) -> argparse.ArgumentParser:
    """Return a parser with only the command that is called, or with all of them."""
    first = argv[:1]
    parser = Parser(
        prog="robbie",
        description="Run a robot whose modules are separate processes, and inspect it.",
        epilog="`robbie COMMAND --help` explains a command.",
        formatter_class=GroupedHelp,
    )
    parser.add_argument("--version", action="version", version=f"robbie {installed_version()}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for command in first if first and first[0] in COMMANDS else COMMANDS:
        import_module(f"robbie_mp.cli.{command.replace('-', '_')}").add_parser(subparsers)
    return parser


@contextmanager
def signals_noted() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM in the list that is yielded, instead of ending the process."""
    noted: list[int] = []
    before = {
        number: signal.signal(number, lambda received, _frame: noted.append(received))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
