"""`robbie param list|get|set|dump|load`: the settings of running modules."""

import argparse
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.text import Text

from robbie_mp.attached.tool.parameters import ANSWER_TIMEOUT_S, ChangeAnswer, Parameters
from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.yaml_reader import read_text
from robbie_mp.cli import completers
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.output import console, warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_robot_argument, add_run_argument, choose_run
from robbie_mp.module.setting_changes import NotChangeable
from robbie_mp.run.profile.show import inline
from robbie_mp.run.run_directory import KnownRun

MAX_FILE_BYTES = 1 << 20


class CannotLoad(RobbieError, ValueError):
    """Settings in a file cannot be loaded into a run; none of them has been changed."""


def add_parser(subparsers: Commands) -> None:
    """Add `param` to the commands."""
    parser = subparsers.add_parser("param", help="show and change settings of running modules")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    listed = add_command(
        actions,
        "list",
        "list the settings of running modules",
        "List the settings of running modules with their present values, and whether they can be changed "
        "while the module runs.",
        ["robbie param list", "robbie param list mapping --json", "robbie param list --changeable"],
    )
    module = listed.add_argument("module", nargs="?", help="list only the settings of this module")
    module.completer = completers.modules  # type: ignore[attr-defined]
    listed.add_argument(
        "--changeable", action="store_true", help="list only settings that can be changed now"
    )
    listed.set_defaults(command=list_all)
    got = add_command(
        actions,
        "get",
        "print the value of a setting",
        "Print the present value of a setting.",
        ["robbie param get mapping.resolution_m"],
    )
    _add_setting_argument(got)
    got.set_defaults(command=get)
    changed = add_command(
        actions,
        "set",
        "change a setting",
        "Change a setting of a running module. The module checks the value as it checks a profile's, and "
        "uses it from the next message on. The change lasts until the run ends, even if the module restarts. "
        "But if the module dies before it has run with the value for 5 s, the value is taken back. A module "
        "that does not run takes the change at its next start.",
        ["robbie param set mapping.resolution_m 0.1", "robbie param set camera.size '[640, 480]'"],
    )
    _add_setting_argument(changed)
    changed.add_argument("value", help="new value, in YAML as in a profile")
    changed.set_defaults(command=change)
    dumped = add_command(
        actions,
        "dump",
        "write all settings as a profile",
        "Write the present values of all settings as a profile, whose parent is the profile of the run. So "
        "`robbie run FILE` starts with them, and `robbie param load FILE` sets them again.",
        ["robbie param dump profiles/tuned.yaml", "robbie param dump"],
    )
    dumped.add_argument("file", metavar="FILE", nargs="?", help="file to write (-: standard output)")
    dumped.set_defaults(command=dump)
    loaded = add_command(
        actions,
        "load",
        "set the settings in a file",
        "Set the settings that a file contains, as written by `robbie param dump`, or any profile's "
        "modules. Nothing is changed if one of them is unknown or would have to be changed but cannot. If a "
        "module refuses a value, those changed before get their old values back.",
        ["robbie param load profiles/tuned.yaml"],
    )
    loaded.add_argument(
        "file", metavar="FILE", help="file to read, - for standard input; without its parents"
    )
    loaded.set_defaults(command=load, reads_input=True)
    for action in (changed, loaded):
        action.add_argument(
            "--timeout",
            metavar="TIME",
            type=time_between(0),
            default=ANSWER_TIMEOUT_S,
            help=f"time to wait for each module's answer ({ANSWER_TIMEOUT_S:g}s)",
        )
    for action in (listed, got):
        action.add_argument("--json", action="store_true", help="print JSON for a program to read")
    for action in (listed, got, changed, dumped, loaded):
        add_run_argument(action)
        add_robot_argument(action)


def _add_setting_argument(parser: argparse.ArgumentParser) -> None:
    setting = parser.add_argument(
        "setting", metavar="MODULE.SETTING", help="module and setting, such as mapping.resolution_m"
    )
    setting.completer = completers.settings  # type: ignore[attr-defined]


def list_all(arguments: argparse.Namespace) -> int:
    """Print all settings."""
    parameters = Parameters(choose_run(arguments.run))
    found = [
        {"module": module, "setting": name, **entry}
        for module in ([arguments.module] if arguments.module else parameters.modules)
        for name, entry in parameters.of_module(module).items()
        if entry["changeable"] or not arguments.changeable
    ]
    if arguments.json:
        print(json.dumps(found, indent=2))
        return 0
    if not found:
        print("no module has a setting" + " that can be changed" * arguments.changeable)
        return 0
    table = PlainTable()
    for heading, left_out in (("setting", 0), ("value", 0), ("type", 2), ("change", 1), ("means", 3)):
        table.add_column(heading, left_out=left_out, shrinks=heading in ("type", "means"))
    for entry in found:
        value = Text(inline(entry["value"]), "bold" if entry["changed"] else "")
        name = f"{entry['module']}.{entry['setting']}"
        may_change = "yes" if entry["changeable"] else "-"
        table.add_row(name, value, entry["type"], may_change, entry["description"])
    console().print(table)
    return 0


def get(arguments: argparse.Namespace) -> int:
    """Print one setting."""
    _, _, entry = Parameters(choose_run(arguments.run)).find(arguments.setting)
    print(json.dumps(entry, indent=2) if arguments.json else inline(entry["value"]))
    return 0


def change(arguments: argparse.Namespace) -> int:
    """Ask a module to change a setting, and print what it answers."""
    parameters = Parameters(choose_run(arguments.run))
    _, _, before = parameters.find_changeable(arguments.setting)
    value, waits = parameters.set_text(arguments.setting, arguments.value, arguments.timeout)
    print(_told(arguments.setting, value, waits, before["value"]))
    return 0


def _told(path: str, value: str, waits: str, before: object) -> str:
    """Say what became of a change.

    Args:
        path: the setting.
        value: its new value.
        waits: the state of its module, if the change waits for its start.
        before: the value before.
    """
    if waits:
        return f"{path.partition('.')[0]} is {waits}: it takes {path} = {value} at its next start"
    return f"{path} is {value}, was {inline(before)}"


def dump(arguments: argparse.Namespace) -> int:
    """Write all settings."""
    run = choose_run(arguments.run)
    text = "".join(f"{line}\n" for line in _dumped(run, Parameters(run)))
    if arguments.file in (None, "-"):
        print(text, end="")
        return 0
    try:
        Path(arguments.file).write_text(text)
    except OSError as error:
        raise CannotLoad(f"cannot write {arguments.file}: {error.strerror}") from error
    print(f"wrote {arguments.file}")
    return 0


def _dumped(run: KnownRun, parameters: Parameters) -> Iterator[str]:
    profile = run.record.profile if run.record else ""
    yield f"# settings of run {run.run_id}"
    if profile:
        yield f"parents: [{inline(profile)}]"
    yield "modules:"
    for module in parameters.modules:
        settings = parameters.of_module(module)
        if not settings:
            warn(f"{module} has no settings, or has not started yet")
            continue
        yield f"  {inline(module)}:"
        yield "    settings:"
        for name, entry in settings.items():
            yield f"      {inline(name)}: {inline(entry['value'])}"


def load(arguments: argparse.Namespace) -> int:
    """Set the settings in a file that differ, all or none."""
    run = choose_run(arguments.run)
    parameters = Parameters(run)
    wanted = _read(Path("/dev/stdin" if arguments.file == "-" else arguments.file))
    before = _check(parameters, wanted, arguments.file)
    done: dict[str, ChangeAnswer] = {}
    try:
        for path in before:
            done[path] = parameters.set_text(path, inline(wanted[path]), arguments.timeout)
    except RobbieError as error:
        _take_back(parameters, {path: before[path] for path in reversed(done)}, arguments.timeout)
        raise CannotLoad(f"{path}: {error}") from error
    for path, value in before.items():
        print(_told(path, inline(wanted[path]), done[path].waits, value))
    print(f"{len(before)} of {len(wanted)} settings changed; the others had these values already")
    return 0


def _read(file: Path) -> dict[str, Any]:
    """Return the settings of all modules in a file, by MODULE.SETTING."""
    try:
        with file.open("rb") as opened:  # perhaps a pipe
            told = opened.read(MAX_FILE_BYTES + 1)
        if len(told) > MAX_FILE_BYTES:
            raise CannotLoad(f"{file} has more than {MAX_FILE_BYTES} bytes, so it is no file of settings")
        content = read_text(told.decode(), str(file)).plain()
    except (OSError, UnicodeDecodeError) as error:
        raise CannotLoad(f"cannot read {file}: {error}") from error
    modules = content.get("modules") if isinstance(content, Mapping) else None
    if not isinstance(modules, Mapping):
        raise CannotLoad(f"{file}: expected `modules:` with the settings of each, as in a profile")
    found: dict[str, Any] = {}
    for module, described in modules.items():
        settings = described.get("settings") if isinstance(described, Mapping) else None
        if settings is None:
            continue
        if not isinstance(settings, Mapping):
            raise CannotLoad(f"{file}: the settings of {module} are no map")
        found |= {f"{module}.{name}": value for name, value in settings.items()}
    return found


def _check(parameters: Parameters, wanted: Mapping[str, Any], file: str) -> dict[str, Any]:
    """Return the present values of the settings that must change; all or none can be."""
    before: dict[str, Any] = {}
    problems: list[str] = []
    for path, value in wanted.items():
        try:
            _, _, entry = parameters.find(path)
            if entry["value"] == value:
                continue
            parameters.find_changeable(path)
        except NotChangeable as error:
            problems.append(str(error))
        else:
            before[path] = entry["value"]
    if problems:
        raise CannotLoad("\n".join([f"{file}: nothing was changed:", *problems]))
    return before


def _take_back(parameters: Parameters, before: Mapping[str, Any], timeout_s: float) -> None:
    for path, value in before.items():
        try:
            parameters.set(path, value, timeout_s)
        except RobbieError as error:
            warn(f"{path} was changed, and could not get its old value {inline(value)} back: {error}")
