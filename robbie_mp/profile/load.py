"""Load a profile: find it, merge it with its parents and overrides, check its form."""

from collections.abc import Sequence
from pathlib import Path

from robbie_mp.profile.build import build_profile
from robbie_mp.profile.merge import merge_profile
from robbie_mp.profile.model import Profile
from robbie_mp.profile.workspace import locate


def load_profile(name_or_file: str, start: Path | None = None, overrides: Sequence[str] = ()) -> Profile:
    """Return a profile of the workspace that `start` is in.

    What this checks is the form. Whether its classes exist and take its settings is up to
    `robbie_mp.profile.preflight`, which has to import them.

    Args:
        name_or_file: As `demo`, `sim/arena`, or the path of a file in a folder profiles/.
        start: A folder in the workspace; the current directory by default.
        overrides: Each `MODULE.SETTING=VALUE` or `CONFIG.KEY=VALUE`, the value in YAML.

    Raises:
        ProfileError: with every problem found, each with file and line.
    """
    here = Path.cwd()
    workspace, name = locate(name_or_file, start or here)
    tree = merge_profile(workspace, name, overrides)
    return build_profile(name, tree, workspace=workspace.root, current_folder=here)
