"""Completions that the shell offers after TAB: names from the run or the workspace.

argcomplete calls these functions. Where a name cannot be determined, they return nothing.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.visible_text import is_visible
from robbie_mp.cli.runs import choose_run
from robbie_mp.run.run_directory import KnownRun

if TYPE_CHECKING:
    from robbie_mp.base.yaml_reader import YamlNode

Completer = Callable[..., list[str]]


def of_run(names: Callable[[KnownRun], Iterable[str]]) -> Completer:
    """Return a completer for names that are read from the chosen run."""

    def complete(parsed_args: argparse.Namespace, **_: object) -> list[str]:
        try:
            found = names(choose_run(getattr(parsed_args, "run", None)))
            return [name for name in found if is_visible(name)]
        except (RobbieError, OSError):
            return []

    return complete


def _modules(run: KnownRun) -> Iterable[str]:
    from robbie_mp.run.plan import RunPlan  # noqa: PLC0415 - the user waits after TAB

    return [*(module.name for module in RunPlan.load(run.folder).modules), "core"]


def _types(run: KnownRun) -> Iterable[str]:
    from robbie_mp.attached.views.known_types import types_of_run  # noqa: PLC0415

    names = types_of_run(run).names()
    short = Counter(name.rpartition("/")[2] for name in names)
    return [
        *(name for name, count in short.items() if count == 1),
        *(name.replace("/msg/", "/") for name in names),
    ]


def _topics(run: KnownRun) -> Iterable[str]:
    from robbie_mp.attached.views.known_channels import channels_of_run  # noqa: PLC0415

    return {channel.topic for channel in channels_of_run(run)} - {""}


def _published_topics(run: KnownRun) -> set[str]:
    from robbie_mp.bus.transport.declarations import read_declarations  # noqa: PLC0415

    return {entry.topic for entry in read_declarations(run.run_id) if entry.is_publisher} - {""}


def _services(run: KnownRun) -> Iterable[str]:
    from robbie_mp.bus.transport.declarations import read_declarations  # noqa: PLC0415
    from robbie_mp.messages.calls import GOAL_SUFFIX, REQUEST_SUFFIX  # noqa: PLC0415

    names = {entry.type_name for entry in read_declarations(run.run_id) if not entry.is_publisher}
    bases = {name: name.removesuffix(REQUEST_SUFFIX).removesuffix(GOAL_SUFFIX) for name in names}
    return [base.rpartition("/")[2] for name, base in bases.items() if base != name]


def _settings(run: KnownRun) -> Iterable[str]:
    from robbie_mp.module.setting_changes import SettingsFile  # noqa: PLC0415

    return [f"{name}.{key}" for name in _modules(run) for key in SettingsFile(run.folder, name).read()]


modules = of_run(_modules)
types = of_run(_types)
topics = of_run(_topics)
published_topics = of_run(_published_topics)
services = of_run(_services)
settings = of_run(_settings)


def types_and_topics(prefix: str = "", **given: Any) -> list[str]:
    """Return the topics on which modules publish; once a letter is typed, or if there are none, types too."""
    found = published_topics(**given)
    return [*types(**given), *topics(**given)] if prefix or not found else found


def profiles(**_: object) -> list[str]:
    """Return the names of the profiles of the current workspace, and of those that come with Robbie-MP."""
    from robbie_mp.run.profile.workspace import find_workspace, stock_names  # noqa: PLC0415

    try:
        return find_workspace(Path.cwd()).names() + stock_names()
    except (RobbieError, OSError):
        return stock_names()


def _of_profile(names: Callable[["YamlNode"], Iterable[str]]) -> Completer:
    """Return a completer for names in the merged profile on the command line."""

    def complete(parsed_args: argparse.Namespace, **_: object) -> list[str]:
        from robbie_mp.run.profile.merge import merge_profile  # noqa: PLC0415
        from robbie_mp.run.profile.workspace import locate  # noqa: PLC0415

        try:
            found = names(merge_profile(*locate(parsed_args.profile, Path.cwd())).tree)
            return [name for name in found if is_visible(name)]
        except (RobbieError, OSError, AttributeError, TypeError):
            return []

    return complete


def _keys(tree: "YamlNode", section: str) -> list[str]:
    node = tree.value.get(section) if isinstance(tree.value, dict) else None
    return list(node.value) if node is not None and isinstance(node.value, dict) else []


profile_modules = _of_profile(lambda tree: _keys(tree, "modules"))
profile_variables = _of_profile(lambda tree: [f"{name}=" for name in _keys(tree, "variables")])


def logs(prefix: str, **_: object) -> list[str]:
    """Return MCAP files, and folders that may contain some."""
    from argcomplete.completers import FilesCompleter  # noqa: PLC0415

    return list(FilesCompleter(("mcap",))(prefix))


def log_topics(parsed_args: argparse.Namespace, **_: object) -> list[str]:
    """Return the topics of the log on the command line."""
    from robbie_mp.logs.recording.reader import channel_name, open_log  # noqa: PLC0415

    try:
        with open_log(getattr(parsed_args, "log", None) or parsed_args.a) as log:
            return [name for channel in log.channels if is_visible(name := channel_name(channel))]
    except (RobbieError, OSError, AttributeError, TypeError):
        return []
