"""The parser of the command line: every error is one line, every command's help has examples."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

from robbie_mp.base.suggest import did_you_mean

BAD_USAGE = 2
Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""To which `add_command` adds a command."""


class Parser(argparse.ArgumentParser):
    """An argument parser that reports an error on one line, and suggests commands for a mistyped one."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.register("type", Path, _path)

    def _check_value(self, action: argparse.Action, value: object) -> None:
        """Refuse a value that is none of the choices; argparse calls this."""
        if action.choices is not None and value not in action.choices:
            known = [str(choice) for choice in action.choices]
            near = did_you_mean(str(value), known) or f"; there are {', '.join(known)}"
            kind = action.metavar.lower() if isinstance(action.metavar, str) else "possible choice"
            raise argparse.ArgumentError(None, f"{value!r} is no {kind}{near}")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, and refuse what is left over here, where the help of this very command is named."""
        parsed, unknown = super().parse_known_args(args, namespace)
        if unknown:
            option, _, _ = next((one for one in unknown if one.startswith("--")), "").partition("=")
            near = did_you_mean(option, self._option_string_actions) if option else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{near}")
        return parsed, unknown

    def error(self, message: str) -> NoReturn:
        """Print the error and how to get help, and exit."""
        self.exit(BAD_USAGE, f"{self.prog}: {message}; see `{self.prog} --help`\n")


def _path(text: str) -> Path:
    """Return a path. An empty one is a variable of a shell that is not set, and not the present folder."""
    if not text:
        raise argparse.ArgumentTypeError("the path is empty")
    return Path(text)


def add_command(
    subparsers: Commands,
    name: str,
    summary: str,
    description: str,
    examples: Sequence[str],
) -> argparse.ArgumentParser:
    """Add a command whose help ends with examples.

    Args:
        subparsers: where to add it.
        name: of the command.
        summary: one line for the help of the parent command.
        description: what the command does, in a few sentences.
        examples: command lines.
    """
    return subparsers.add_parser(
        name,
        help=summary,
        description=description,
        epilog="\n".join(["examples:", *(f"  {example}" for example in examples)]),
        formatter_class=HelpFormatter,
    )


class HelpFormatter(argparse.HelpFormatter):
    """Wraps descriptions, but not examples."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith("examples:"):
            return text
        return super()._fill_text(text, width, indent)
