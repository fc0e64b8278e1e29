"""The options that name other code or settings for a module, and their check before it runs."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.problem import Problem, ProfileError, refuse
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.base.yaml_reader import read_text
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.model import ModuleSpec, Profile
from robbie_mp.run.profile.preflight import preflight, runnable, what_failed
from robbie_mp.run.variant import Variant, check_code


class NoSuchModule(RobbieError, LookupError):
    """The profile of a run has no module of this name."""


def add_variant_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--with`, `--class` and `--set`."""
    parser.add_argument(
        "--with",
        dest="code",
        metavar="PATH",
        type=Path,
        help="folder in which its code is looked for first, or a file that takes the place of the one with "
        "its class",
    )
    parser.add_argument(
        "--class",
        dest="class_path",
        metavar="MODULE:CLASS",
        default="",
        help="another class, as in a profile",
    )
    parser.add_argument(
        "--set",
        dest="settings",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="set one of its settings, in YAML as in a profile; null: the default of the class; may be "
        "repeated",
    )


def variant_of(arguments: argparse.Namespace) -> Variant:
    """Return the variant that the arguments name; the profile's own if they name nothing.

    Raises:
        InvalidVariant: there is no such code.
        ProfileError: a setting is not written as NAME=VALUE.
    """
    code = "" if arguments.code is None else str(arguments.code.expanduser().absolute())
    check_code(code)
    return Variant(code, arguments.class_path, dict(map(_setting, arguments.settings)))


def _setting(text: str) -> tuple[str, object]:
    name, equals, value = text.partition("=")
    if not equals or not name.isidentifier():
        raise refuse(f"--set {text}: write NAME=VALUE, with the name of a setting of this module")
    return name, read_text(value, f"--set {text}").plain()


def planned_module(plan: RunPlan, name: str) -> ModuleSpec:
    """Return what a run's profile says about a module.

    Raises:
        NoSuchModule: there is none of this name.
    """
    for spec in plan.modules:
        if spec.name == name:
            return spec
    names = [spec.name for spec in plan.modules]
    near = did_you_mean(name, names) or f"; there are {', '.join(names)}"
    raise NoSuchModule(f"no module is named {name!r}{near}")


def checked_variant(plan: RunPlan, name: str, variant: Variant) -> ModuleSpec:
    """Import the code of a variant in another process, and check its settings, as before a run.

    Returns:
        The module with every setting of the variant.

    Raises:
        NoSuchModule: there is none of this name.
        ProfileError: the code or the settings are wrong, or it cannot import something.
    """
    others = [one for one in plan.modules if one.name != name]
    return checked(variant.applied(planned_module(plan, name)), others, Path(plan.workspace))


def checked(spec: ModuleSpec, others: Sequence[ModuleSpec], workspace: Path) -> ModuleSpec:
    """Do the same for a module that is not, or not yet, one of a run.

    Args:
        spec: the module.
        others: the other modules.
        workspace: the workspace with its code.
    """
    spec = replace(spec, optional=False)
    profile = Profile("", (spec, *others), workspace=workspace)
    findings = preflight(profile, only={spec.name})
    runnable(profile, findings)
    if failure := findings.failures.get(spec.name):
        raise ProfileError([Problem(f"{spec.class_path} cannot be imported: {what_failed(failure)}")])
    return replace(spec, settings=findings.settings[spec.name])
