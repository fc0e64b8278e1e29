"""A bridge's view of the run that it is part of."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

from typing_extensions import Self

from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.module.setting_changes import SettingsFile
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.run_directory import list_runs


@dataclass(frozen=True)
class BridgeRun:
    """The run around a bridge.

    Attributes:
        types: the stock types, and the robot's.
        bridges: names of the modules that bridge to the same system, with this one. What they publish came
            from there, so none of them sends it back: no message can go in circles.
        has_own_clock: whether the run's time is that of a playback or a simulation.
        sets_clock: whether the bridge sets the run's time.
        settings: where the settings of each module stand.
        output: where the run writes its results; None in a test.
        folder: the run's folder; None in a test.
        code: where the robot's Python files are.
    """

    types: KnownTypes
    bridges: frozenset[str]
    has_own_clock: bool = False
    sets_clock: bool = False
    settings: Mapping[str, SettingsFile] = field(default_factory=dict)
    output: Path | None = None
    folder: Path | None = None
    code: tuple[Path, ...] = ()

    @classmethod
    def of(cls, run_id: str, module: str, class_path: str) -> Self:
        """Look up the run of a module.

        Args:
            run_id: the run; "" in a test.
            module: the bridge's name in the profile.
            class_path: its class, as profiles name it.
        """
        if not run_id:
            return cls(KnownTypes(), frozenset({module}))
        run = next(run for run in list_runs() if run.run_id == run_id)
        plan = RunPlan.load(run.folder)
        own = {one.class_path for one in plan.modules if one.name == module} | {class_path}
        bridges = {one.name for one in plan.modules if one.class_path in own}
        types = KnownTypes(TypeDescription(*one) for one in plan.types)
        settings = {one.name: SettingsFile(run.folder, one.name) for one in plan.modules}
        output = None if run.record is None else Path(run.record.output_directory)
        source, names = plan.clock.source, frozenset({module, *bridges})
        code = _code(plan)
        return cls(types, names, source is not None, source == module, settings, output, run.folder, code)


def _code(plan: RunPlan) -> tuple[Path, ...]:
    """Return the folders of the workspace, and of the packages that its modules come from."""
    packages = {one.class_path.partition(".")[0].partition(":")[0] for one in plan.modules} - {"robbie_mp"}
    found = [find_spec(one) for one in sorted(packages)]
    places = [place for one in found if one is not None for place in one.submodule_search_locations or ()]
    return (Path(plan.workspace), *map(Path, places))
