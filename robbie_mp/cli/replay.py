"""`robbie replay CAPSULE`: run a module that crashed again, with the same messages and times."""

import argparse
import json
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.python_command import python_command
from robbie_mp.cli.amounts import time_between, whole_between
from robbie_mp.cli.output import plain_output
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.logs.capsule import replay as replaying
from robbie_mp.logs.capsule.attempt import LIMIT_S
from robbie_mp.logs.capsule.read import Capsule, handled, read_capsule

WORKER = "robbie_mp.cli.replay"
"""The program that runs the module: with the hash seed of then, which is set when Python starts."""


class NoSuchStep(RobbieError, LookupError):
    """`--until` names a step or message that a capsule does not hold."""


class NoDebugpy(RobbieError, ImportError):
    """`--debug` needs a package that is not installed."""


def add_parser(subparsers: Commands) -> None:
    """Add `replay` to the commands."""
    parser = add_command(
        subparsers,
        "replay",
        "run a module's crash again",
        "Run the module of a capsule alone, with the same messages, times, answers and random numbers, as "
        "fast as it goes. `robbie run` writes a capsule of each crash into the folder log/crashes of its "
        "results. The code is that of the current folder, or of --with FOLDER. Exit code 0: it crashed at "
        "the same line; 1: it did not, or crashed elsewhere; the last lines say how.",
        [
            "robbie replay output/rescue/…/log/crashes/mapping-20261128T215220.103-1.capsule",
            "robbie replay mapping.capsule --list",
            "robbie replay mapping.capsule --pdb",
            "robbie replay mapping.capsule --until 41",
            "robbie replay mapping.capsule --with ~/fixed",
            "robbie replay mapping.capsule --as-test tests/test_mapping_crash.py",
        ],
    )
    _add_arguments(parser)
    parser.set_defaults(command=replay)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capsule", metavar="CAPSULE", type=Path, help="the capsule")
    parser.add_argument(
        "--with", dest="workspace", metavar="FOLDER", type=Path, help="the workspace whose code is run"
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--list", action="store_true", help="list the steps instead, with their numbers")
    what.add_argument("--pdb", action="store_true", help="open the debugger at the exception")
    what.add_argument("--until", metavar="STEP", help="open the debugger before a step, or before the `last`")
    what.add_argument("--step", action="store_true", help="wait before each step")
    what.add_argument(
        "--debug",
        metavar="PORT",
        type=whole_between(1, 65_535),
        help="wait for an editor (debugpy) on this port",
    )
    what.add_argument("--as-test", metavar="FILE", type=Path, help="write a small test that crashes likewise")
    parser.add_argument("--json", action="store_true", help="print the verdict as one line of JSON")
    parser.add_argument(
        "--limit",
        metavar="TIME",
        type=time_between(0.001),
        default=LIMIT_S,
        help="a step that takes longer hangs (5s; setup: 20s)",
    )


def replay(arguments: argparse.Namespace) -> int:
    """Replay, in an interpreter whose sets have the same order as then."""
    capsule = read_capsule(arguments.capsule)
    if arguments.list:
        return _list(capsule)
    words = [str(arguments.capsule), "--limit", str(arguments.limit)]
    for name, value in (
        ("--with", arguments.workspace),
        ("--until", arguments.until),
        ("--debug", arguments.debug),
        ("--as-test", arguments.as_test),
    ):
        words += [name, str(value)] if value is not None else []
    words += [name for name in ("--pdb", "--step", "--json") if getattr(arguments, name[2:])]
    sys.stdout.flush()
    ended = subprocess.run(
        [*python_command(WORKER), *words], env=replaying.environment_of(capsule), check=False
    )
    return ended.returncode if ended.returncode >= 0 else 1


def _list(capsule: Capsule) -> int:
    first_ns = next((step.event.time_ns for _, step in handled(capsule) if step.event), 0)
    for number, step in handled(capsule):
        time_ns = step.event.time_ns if step.event else 0
        at = f"{(time_ns - first_ns) / 1e9:9.3f} s" if time_ns else " " * 11
        print(f"{number:6} {at}  {step.title}")
    return 0


def main(words: list[str]) -> int:
    """Be the program that runs the module."""
    parser = argparse.ArgumentParser()
    _add_arguments(parser)
    arguments = parser.parse_args(words)
    is_interactive = arguments.pdb or arguments.step or arguments.until is not None
    with nullcontext() if is_interactive else plain_output():
        try:
            return _run(arguments, read_capsule(arguments.capsule))
        except RobbieError as error:
            print(error, file=sys.stderr)
            return 1


def _run(arguments: argparse.Namespace, capsule: Capsule) -> int:
    workspace = (arguments.workspace or Path.cwd()).resolve()
    notes = list(capsule.warnings)
    if changed := replaying.changed_code(capsule, workspace):
        notes.append(f"the code is another one than then: {', '.join(changed[:5])}")
    for note in notes:
        print(f"note: {note}", file=sys.stderr if arguments.json else sys.stdout)
    if arguments.as_test is not None:
        from robbie_mp.logs.capsule.as_test import write_test  # noqa: PLC0415

        return write_test(capsule, workspace, arguments.as_test, arguments.limit)
    if arguments.debug is not None:
        _wait_for_editor(arguments.debug)
    if arguments.pdb or arguments.step or arguments.until is not None or arguments.debug is not None:
        until = None if arguments.until is None else _step_number(capsule, arguments.until)
        replaying.debug(
            capsule,
            workspace,
            until=until,
            steps=arguments.step,
            post_mortem=arguments.debug is None,
        )
        return 0
    verdict = replaying.judge(capsule, replaying.replay(capsule, workspace, arguments.limit))
    print(json.dumps(asdict(verdict)) if arguments.json else "\n".join(verdict.lines))
    return 0 if verdict.is_same else 1


def _step_number(capsule: Capsule, text: str) -> int:
    last = len(capsule.steps) - 1
    if text == "last":
        return last
    if not text.isdecimal() or not 0 < int(text) <= last:
        raise NoSuchStep(f"--until {text}: the steps are 1 to {last}; see --list")
    return int(text)


def _wait_for_editor(port: int) -> None:
    try:
        debugpy = import_module("debugpy")
    except ImportError:
        raise NoDebugpy("--debug needs debugpy: pip install debugpy") from None
    debugpy.listen(("127.0.0.1", port))
    print(f"waiting for an editor to attach to 127.0.0.1:{port}")
    debugpy.wait_for_client()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
