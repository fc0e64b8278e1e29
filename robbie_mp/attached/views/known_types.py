"""The message types that a command knows: those of the selected run, or of the current workspace."""

from contextlib import closing
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.run.live_runs import live_runs, matching_runs
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.checking_process import check_events
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.model import ModuleSpec, Profile
from robbie_mp.run.profile.preflight import BASE_CLASS
from robbie_mp.run.profile.workspace import find_workspace
from robbie_mp.run.run_directory import KnownRun

IMPORT_TIMEOUT_S = 30.0
"""A busy robot's computer takes several seconds to import the modules of a workspace."""


def types_of_run(run: KnownRun) -> KnownTypes:
    """Return the stock types and those that the run's modules declare; nothing is imported."""
    return KnownTypes(TypeDescription(*one) for one in RunPlan.load(run.folder).types)


def types_of_run_or_workspace(named: str | None) -> KnownTypes:
    """Return the types of the matching run if there is exactly one, else those of the current workspace."""
    runs = matching_runs(named, live_runs())
    return types_of_run(runs[0]) if len(runs) == 1 else KnownTypes(types_of_workspace(Path.cwd()))


def types_of_workspace(folder: Path) -> list[TypeDescription]:
    """Return the types that the modules of all profiles in a folder's workspace declare; [] outside of one.

    Another process imports the modules; modules that cannot be imported are skipped.
    """
    try:
        workspace = find_workspace(folder)
    except RobbieError:
        return []
    modules: dict[str, ModuleSpec] = {}
    for name in workspace.names():
        try:
            profile = load_profile(name, workspace.root)
        except RobbieError:
            continue
        modules |= {module.class_path: module for module in profile.modules}
    found: dict[str, TypeDescription] = {}
    robot = Profile("", (), workspace=workspace.root)
    with closing(check_events(robot, list(modules.values()), IMPORT_TIMEOUT_S, BASE_CLASS)) as events:
        for event in events:
            for name, *rest in event.get("result", {}).get("types", ()):
                found[name] = TypeDescription(name, *rest)
    return list(found.values())
