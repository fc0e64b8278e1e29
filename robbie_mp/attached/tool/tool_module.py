"""Runs a module as a tool: in a process that is not in the run's profile and not supervised."""

import os
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, TypeVar

from robbie_mp.attached.tool.tool_bus import ToolBus
from robbie_mp.module.clock import SystemClock
from robbie_mp.module.loop import ModuleLoop
from robbie_mp.module.module import Module, ModuleContext, calls_of
from robbie_mp.module.settings import check_settings
from robbie_mp.module.ticks import TimedTicks
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.run_directory import KnownRun

ModuleClass = TypeVar("ModuleClass", bound=Module)


class _NoCheckpoints:
    """Discards checkpoints: a tool is not restarted."""

    restored: Any = None
    lost = 0

    def save(self, _state: object) -> bool:
        return False


def run_as_tool(
    run: KnownRun,
    module_class: type[ModuleClass],
    settings: Mapping[str, object],
    name: str,
    *,
    on_ready: Callable[[ModuleClass], object],
    is_stopped: Callable[[], object],
) -> None:
    """Run a module as a tool in a live run, until it stops itself or is stopped.

    It uses the machine's clock and keeps no checkpoints, as it is not restarted.

    Args:
        run: the run.
        module_class: the module's class.
        settings: settings of the module; all others have their default values.
        name: name of the module in its log.
        on_ready: called with the module once it is set up.
        is_stopped: called between two messages or ticks; true ends the module.

    Raises:
        SettingError: the settings are invalid.
        RunEnded: the run has ended.
        RunNotControlled: the run has ended, or is just starting.
        ControlRefused: the profile allows no further tools, or this tool was detached and another one has
            taken its place.
    """
    checked = check_settings(module_class, settings)
    module_class.check(checked)
    plan = RunPlan.load(run.folder)
    own_pid = os.getpid()
    with closing(ToolBus(run, name)) as bus:
        module = module_class(
            ModuleContext(
                name=name,
                settings=checked,
                bus=bus,
                clock=SystemClock(),
                checkpoints=_NoCheckpoints(),
                output_directory=Path(plan.output_directory),
                show_status=bus.show_status,
                run_id=run.run_id,
                wake=bus.wake,
            )
        )
        bus.on_new_place = calls_of(module).client.forget_place
        loop = ModuleLoop(module, bus, TimedTicks(module, module.clock))
        loop.set_up()
        bus.ready()
        loop.begin()
        on_ready(module)
        try:
            while not (loop.ends or is_stopped()):
                loop.turn()
        finally:
            if os.getpid() == own_pid:  # a forked process has nothing to tear down
                loop.tear_down()
