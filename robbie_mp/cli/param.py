"""`robbie param list|get|set`: settings that can be changed while their module runs."""

import argparse
import json
import secrets
from collections.abc import Iterator
from contextlib import closing
from typing import TYPE_CHECKING, Any

from rich.text import Text

from robbie_mp.cli import completers
from robbie_mp.cli.output import console
from robbie_mp.cli.parser import add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.errors import RobbieError
from robbie_mp.messages import SettingChange, SettingChanged
from robbie_mp.module.setting_changes import NotChangeable, SettingsFile
from robbie_mp.module.settings import SettingError
from robbie_mp.observe import RunObserver
from robbie_mp.profile.show import inline
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.run_directory import KnownRun
from robbie_mp.suggest import did_you_mean
from robbie_mp.tool.tool import Received, Tool
from robbie_mp.views.plain_table import PlainTable
from robbie_mp.views.run_figures import state_name

if TYPE_CHECKING:
    from argparse import _SubParsersAction

OPEN_TIMEOUT_S = 2.0
Entry = dict[str, Any]


class NoAnswer(RobbieError, TimeoutError):
    """A module has not answered in time whether it has changed a setting."""


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `param` to the commands."""
    parser = subparsers.add_parser("param", help="show and change settings of running modules")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    listed = add_command(
        actions,
        "list",
        "list the settings that can be changed",
        "List the settings that can be changed while their modules run, and their values.",
        ["robbie param list", "robbie param list mapping --json"],
    )
    module = listed.add_argument("module", nargs="?", help="list only the settings of this module")
    module.completer = completers.modules  # type: ignore[attr-defined]
    listed.set_defaults(command=list_all)
    got = add_command(
        actions,
        "get",
        "print the value of a setting",
        "Print the current value of a setting that can be changed.",
        ["robbie param get mapping.resolution_m"],
    )
    _add_setting_argument(got)
    got.set_defaults(command=get)
    changed = add_command(
        actions,
        "set",
        "change a setting",
        "Change a setting of a running module. The module checks the value as it checks a profile's, and "
        "uses it from the next message on. The change lasts until the run ends, even if the module restarts.",
        ["robbie param set mapping.resolution_m 0.1", "robbie param set camera.size '[640, 480]'"],
    )
    _add_setting_argument(changed)
    changed.add_argument("value", help="new value, in YAML as in a profile")
    changed.add_argument(
        "--timeout",
        metavar="SECONDS",
        type=float,
        default=5.0,
        help="time to wait for the module's answer (5)",
    )
    changed.set_defaults(command=change)
    for action in (listed, got):
        action.add_argument("--json", action="store_true", help="print JSON for a program to read")
    for action in (listed, got, changed):
        add_run_argument(action)


def _add_setting_argument(parser: argparse.ArgumentParser) -> None:
    setting = parser.add_argument(
        "setting", metavar="MODULE.SETTING", help="module and setting, such as mapping.resolution_m"
    )
    setting.completer = completers.settings  # type: ignore[attr-defined]


def list_all(arguments: argparse.Namespace) -> int:
    """Print all changeable settings."""
    run = choose_run(arguments.run)
    found = [
        {"module": module, "setting": name, **entry}
        for module in ([arguments.module] if arguments.module else _modules(run))
        for name, entry in _settings(run, module).items()
    ]
    if arguments.json:
        print(json.dumps(found, indent=2))
        return 0
    if not found:
        print("no module has a setting that can be changed")
        return 0
    table = PlainTable("setting", "value", "type", "means")
    for entry in found:
        value = Text(inline(entry["value"]), "bold" if entry["changed"] else "")
        name = f"{entry['module']}.{entry['setting']}"
        table.add_row(name, value, entry["type"], entry["description"])
    console().print(table)
    return 0


def get(arguments: argparse.Namespace) -> int:
    """Print one setting."""
    run = choose_run(arguments.run)
    _, _, entry = _find(run, arguments.setting)
    print(json.dumps(entry, indent=2) if arguments.json else inline(entry["value"]))
    return 0


def change(arguments: argparse.Namespace) -> int:
    """Ask a module to change a setting, and print what it answers."""
    run = choose_run(arguments.run)
    module, name, before = _find(run, arguments.setting)
    with closing(Tool(run, f"robbie param set {module}.{name}")) as tool:
        tool.subscribe(SettingChanged.type_name, SettingChanged.version, module)
        tool.ready()
        tool.wait_for(tool.is_subscribed, OPEN_TIMEOUT_S)
        request = secrets.randbits(63)
        tool.publish(SettingChange(request=request, setting=name, value=arguments.value), module)
        answers = _answers(tool, request)
        if not tool.wait_for(lambda: next(answers) is not None, arguments.timeout):
            raise NoAnswer(
                f"no answer within {arguments.timeout:g} s; {module} is {_state(run, module)}, and will "
                "make the change once it handles the request"
            )
        answer = next(answers)
    assert answer is not None
    if answer.error:
        raise SettingError(f"{module} refuses: {answer.error}", name)
    print(f"{module}.{name} is {answer.value}, was {inline(before['value'])}")
    return 0


def _answers(tool: Tool, request: int) -> Iterator[SettingChanged | None]:
    """Yield None until the answer to a request has arrived, and from then on the answer."""
    answer: SettingChanged | None = None
    while True:
        received: Received | None = tool.take() if answer is None else None
        if received is not None:
            said = SettingChanged.decode(received.data)
            answer = said if said.request == request else None
        yield answer


def _modules(run: KnownRun) -> list[str]:
    return [module.name for module in RunPlan.load(run.folder).modules]


def _settings(run: KnownRun, module: str) -> dict[str, Entry]:
    if module not in (names := _modules(run)):
        near = did_you_mean(module, names) or f"; there are {', '.join(names)}"
        raise NotChangeable(f"no module is named {module!r}{near}")
    return SettingsFile(run.folder, module).read()


def _find(run: KnownRun, path: str) -> tuple[str, str, Entry]:
    module, dot, name = path.partition(".")
    if not dot:
        raise NotChangeable(f"expected MODULE.SETTING; got {path!r}")
    settings = _settings(run, module)
    if name not in settings:
        near = did_you_mean(name, settings) or f"; it has {', '.join(settings) or 'none'}"
        raise NotChangeable(f"{module} has no setting {name!r} that can be changed while it runs{near}")
    return module, name, settings[name]


def _state(run: KnownRun, module: str) -> str:
    with closing(RunObserver(run.run_id)) as observer:
        return next(state_name(figures) for figures in observer.modules() if figures.name == module)
