"""Commands that the pages mention exist, and commands that exist are in the reference."""

import argparse
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.cli.program import COMMANDS, parser_of
from tests.docs._support.pages import PAGES, ROOT

COMMAND = re.compile(r"\b(?<![\w/.-])robbie((?: [a-z][\w./-]*| --?[a-z][a-z0-9-]*)*)")
REFERENCE = (ROOT / "docs" / "reference.md").read_text()


def options(parser: argparse.ArgumentParser) -> Iterator[tuple[str, ...]]:
    """Every command as its words, with each of its options."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, command in action.choices.items():
                yield from ((name, *rest) for rest in options(command))
        yield from ((option,) for option in action.option_strings)
    yield ()


KNOWN = set(options(parser_of(())))


def mentioned(page: Path) -> list[str]:
    """Command lines of `robbie` in code of a page."""
    code = re.findall(r"```sh\n(.*?)```|^    (.*)$|`([^`\n]+)`", page.read_text(), re.DOTALL | re.MULTILINE)
    lines = "\n".join(part for parts in code for part in parts if part).splitlines()
    return [found for line in lines for found in COMMAND.findall(line.replace("robbie-top", "robbie top"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_that_a_page_mentions_exist(page: Path) -> None:
    for line in mentioned(page):
        words = line.split()
        if words and not words[0].startswith("-"):
            assert words[0] in COMMANDS, f"robbie{line}"
        command: tuple[str, ...] = ()
        for word in words:
            if word.startswith("-"):
                assert (*command, word) in KNOWN, f"robbie{line}"
            elif (*command, word) in KNOWN:
                command = (*command, word)


def test_check_finds_commands() -> None:
    found = {line.split()[0] for page in PAGES for line in mentioned(page) if line.split()}
    assert found >= set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_reference_describes_every_command(command: str) -> None:
    assert re.search(rf"^\| `robbie {command}\b", REFERENCE, re.MULTILINE)


def test_reference_describes_every_option() -> None:
    long_options = {words[-1] for words in KNOWN if words and words[-1].startswith("--")} - {"--help"}
    assert not [option for option in long_options if f"| `{option}" not in REFERENCE]


def test_make_targets_that_pages_mention_exist() -> None:
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for page in PAGES:
        assert set(re.findall(r"(?:`|^    )make (\w+)", page.read_text(), re.MULTILINE)) <= targets
