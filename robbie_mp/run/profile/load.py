"""Loads a profile: finds it, merges it with its parents and overrides, checks its form."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from robbie_mp.run.profile.build import build_profile
from robbie_mp.run.profile.merge import merge_profile
from robbie_mp.run.profile.model import Profile
from robbie_mp.run.profile.variables import resolve
from robbie_mp.run.profile.workspace import locate


def load_profile(
    name_or_file: str,
    start: Path | None = None,
    overrides: Sequence[str] = (),
    variables: Sequence[str] = (),
    without: Sequence[str] = (),
    only: Sequence[str] = (),
) -> Profile:
    """Return a profile of the workspace that contains `start`.

    This checks only the form. `robbie_mp.run.profile.preflight` checks whether the classes exist and accept
    the settings, because it must import them.

    Args:
        name_or_file: A name such as `demo` or `sim/arena`, the path of a file in a folder profiles/, or the
            class of a module, `package.module:Class`, which then runs alone.
        start: A folder in the workspace; the current directory by default.
        overrides: Each `MODULE.SETTING=VALUE` or `CONFIG.KEY=VALUE`, the value in YAML.
        variables: Each `NAME=VALUE`, the value in YAML.
        without: Names of modules to leave out.
        only: Names of the modules to keep; none: all.

    Raises:
        ProfileError: The profile cannot be used; it lists every problem with file and line.
    """
    here = Path.cwd()
    workspace, name = locate(name_or_file, start or here)
    tree, removals = merge_profile(workspace, name, overrides)
    resolved = resolve(tree, variables, without, only)
    profile = build_profile(name, resolved.tree, removals, workspace=workspace.root, current_folder=here)
    return replace(profile, left_out=resolved.left_out)
