"""`robbie profile show`: a merged profile, and where each value comes from."""

import argparse
import json
import sys
from collections.abc import Iterable, Sequence

from robbie_mp.cli import completers
from robbie_mp.cli.output import console, warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.model import Profile
from robbie_mp.run.profile.preflight import preflight, what_failed
from robbie_mp.run.profile.show import DEFAULT, YamlLine, as_tree, origins, to_lines, without_defaults


def add_parser(subparsers: Commands) -> None:
    """Add `profile` to the commands."""
    profile = subparsers.add_parser("profile", help="show a profile merged with its parents")
    actions = profile.add_subparsers(title="actions", metavar="ACTION", required=True)
    parser = add_command(
        actions,
        "show",
        "print the merged profile with the origin of each value",
        "Print a profile merged with its parents, each value with the file and line that set it. "
        "Module classes and settings are checked as before a run.",
        [
            "robbie profile show robot",
            "robbie profile show robot --set sensor.period_s=1 --json",
            "robbie profile show robot --changed",
        ],
    )
    add_profile_arguments(parser)
    parser.add_argument("--changed", action="store_true", help="show only what differs from the defaults")
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.set_defaults(command=show)


def add_profile_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for a profile: `profile` and `overrides`."""
    name = parser.add_argument(
        "profile", help="a profile in profiles/, by name or path; or package.module:Class, one alone"
    )
    name.completer = completers.profiles  # type: ignore[attr-defined]
    add_set_argument(parser)


def load(arguments: argparse.Namespace, given: Sequence[str] = ()) -> Profile:
    """Load the profile that the arguments of `add_profile_arguments` name.

    Args:
        arguments: the arguments.
        given: further overrides, before those of the command line.
    """
    return load_profile(
        arguments.profile,
        overrides=[*given, *arguments.overrides],
        variables=arguments.variables,
        without=arguments.without,
        only=arguments.only,
    )


def add_set_argument(parser: argparse.ArgumentParser) -> None:
    """Add the options that change a profile: `overrides`, `variables`, `without`, `only`."""
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="NAME.SETTING=VALUE",
        action="append",
        default=[],
        help="set a module's setting; may be repeated",
    )
    variables = parser.add_argument(
        "--var",
        dest="variables",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="give a variable of the profile a value; may be repeated",
    )
    variables.completer = completers.profile_variables  # type: ignore[attr-defined]
    for option, what in (
        ("--without", "leave out these modules"),
        ("--only", "leave out all but these modules"),
    ):
        names = parser.add_argument(
            option,
            metavar="MODULE[,MODULE...]",
            type=_names,
            action="extend",
            default=[],
            help=f"{what} of the profile; may be repeated",
        )
        names.completer = completers.profile_modules  # type: ignore[attr-defined]


def _names(text: str) -> list[str]:
    """Return the names in a list with commas."""
    return text.split(",")


def show(arguments: argparse.Namespace) -> int:
    """Print a profile."""
    profile = load(arguments)
    findings = preflight(profile)
    for module, failure in findings.failures.items():
        warn(f"module {module} cannot be imported: {what_failed(failure)}")
    tree = as_tree(profile, findings.settings)
    origin_of = origins(profile, tree)
    if arguments.changed:
        tree = without_defaults(tree, origin_of)
        origin_of = {path: origin for path, origin in origin_of.items() if origin != DEFAULT}
    if arguments.json:
        described = {
            "name": profile.name,
            "workspace": str(profile.workspace),
            "left_out": dict(profile.left_out),
            **tree,
        }
        described["origins"] = {"/".join(path): origin for path, origin in origin_of.items()}
        print(json.dumps(described, indent=2))
    else:
        left_out = (YamlLine(f"# {name} is left out: {why}") for name, why in profile.left_out.items())
        _print_lines([YamlLine(f"# profile {profile.name}"), *left_out, *to_lines(tree, origin_of)])
    return 0


def _print_lines(lines: Iterable[YamlLine]) -> None:
    if not sys.stdout.isatty():
        print(*lines, sep="\n")
        return
    from rich.text import Text  # noqa: PLC0415

    output = console()
    for line in lines:
        output.print(
            Text.assemble(str(line).removesuffix(line.comment), (line.comment, "dim")), soft_wrap=True
        )
