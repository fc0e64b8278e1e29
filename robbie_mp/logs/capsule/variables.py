"""Variables of the environment that a module's code names: a replay has them again."""

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

MOST_VARIABLES = 100
MOST_LENGTH = 4096
_NAME = re.compile(r"[A-Z][A-Z0-9_]+")
_OF_PYTHON = re.compile(r"LD_|PYTHON|(?:.*_)?PATH$|HOME$|SHELL$|ROBBIE_")
"""What decides which code runs is this machine's own."""
_SECRET = re.compile(r"KEY|TOKEN|SECRET|PASS|CREDENTIAL|AUTH|COOKIE")


def named_variables(files: Iterable[Path], environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables whose names are in files of code; none that seems to be secret.

    Args:
        files: the module's code.
        environment: all variables.
    """
    words: set[str] = set()
    for file in files:
        try:
            words.update(_NAME.findall(file.read_text(errors="replace")))
        except OSError:
            continue
    found = {name: environment[name] for name in sorted(words) if name in environment and _may_be_kept(name)}
    return {name: text for name, text in list(found.items())[:MOST_VARIABLES] if len(text) <= MOST_LENGTH}


def set_variables(variables: Mapping[str, str], files: Iterable[Path]) -> None:
    """Set the variables of a capsule, which may be forged: only those that the code here names, too.

    Args:
        variables: the variables.
        files: the module's code here.
    """
    os.environ.update(named_variables(files, variables))


def _may_be_kept(name: str) -> bool:
    return not _OF_PYTHON.match(name) and not _SECRET.search(name)
