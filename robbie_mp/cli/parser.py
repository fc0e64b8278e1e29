"""The parser of the command line: every error is one line, every command's help has examples."""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from argparse import _SubParsersAction

BAD_USAGE = 2


class Parser(argparse.ArgumentParser):
    """An argument parser that says what is wrong on one line."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong and where more is told, and end."""
        self.exit(BAD_USAGE, f"{self.prog}: {message}; see `{self.prog} --help`\n")


def add_command(
    subparsers: "_SubParsersAction[argparse.ArgumentParser]",
    name: str,
    summary: str,
    description: str,
    examples: Sequence[str],
) -> argparse.ArgumentParser:
    """Add a command whose help ends with examples.

    Args:
        subparsers: where to add it.
        name: the word by which it is called.
        summary: its line in the help of the command above it.
        description: what it does, in a few sentences.
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
    """Wraps descriptions, but leaves examples as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith("examples:"):
            return text
        return super()._fill_text(text, width, indent)
