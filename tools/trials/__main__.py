"""Tries a robot or a part of it over many seeds, and judges it by the truth.

python -m tools.trials NAME [--seeds N] [--first SEED] [--json FILE] [--keep DIR] [options of NAME]
python -m tools.trials NAME --help
"""

import argparse
import ast
import signal
import sys
from importlib import import_module
from pathlib import Path

from tools.trials.harness import run

HERE = Path(__file__).parent


def subjects() -> dict[str, Path]:
    """Return the module of each subject, by its name."""
    modules = sorted(HERE.glob("*/*.py"))
    return {path.stem: path for path in modules if "\nSUBJECT = " in path.read_text()}


def listed() -> str:
    """Return the subjects of each room, each with the first line of what it says of itself."""
    lines, room = [], ""
    for name, path in subjects().items():
        if path.parent.name != room:
            room = path.parent.name
            lines.append(f"{room}:")
        lines.append(f"  {name:16} {_first_line(path)}")
    return "\n".join(lines)


def _first_line(path: Path) -> str:
    return (ast.get_docstring(ast.parse(path.read_text())) or "").partition("\n")[0]


def main(words: list[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.trials",
        description=f"{__doc__}\n{listed()}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", choices=subjects(), help="one of those above")
    words = sys.argv[1:] if words is None else words
    name = parser.parse_args(words[:1] or ["--help"]).name
    module = import_module(f"tools.trials.{subjects()[name].parent.name}.{name}")
    return run(module.SUBJECT, name, module.__doc__, words[1:])


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the robot must not outlive this program
    sys.exit(main())
