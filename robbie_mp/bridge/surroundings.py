"""What a bridge must know about the run that it is part of."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.module.setting_changes import SettingsFile
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.run_directory import list_runs


@dataclass(frozen=True)
class Surroundings:
    """The run around a bridge.

    Attributes:
        types: the stock types, and the robot's.
        bridges: names of the modules that bridge to the same system, with this one. What they publish came
            from there, so none of them sends it back: no message can go in circles.
        has_own_clock: whether the run's time is that of a playback or a simulation.
        settings: where the settings of each module stand.
    """

    types: KnownTypes
    bridges: frozenset[str]
    has_own_clock: bool = False
    settings: Mapping[str, SettingsFile] = field(default_factory=dict)

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
        folder = next(run.folder for run in list_runs() if run.run_id == run_id)
        plan = RunPlan.load(folder)
        own = {one.class_path for one in plan.modules if one.name == module} | {class_path}
        bridges = {one.name for one in plan.modules if one.class_path in own}
        types = KnownTypes(TypeDescription(*one) for one in plan.types)
        settings = {one.name: SettingsFile(folder, one.name) for one in plan.modules}
        return cls(types, frozenset({module, *bridges}), plan.clock.source is not None, settings)
