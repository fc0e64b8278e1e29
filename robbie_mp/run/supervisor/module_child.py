"""A module as a child: connects the module's class to the run's memory."""

import gc
import logging
import os
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from robbie_mp.base.device_links import Links, MachineLinks, using_links
from robbie_mp.base.linux.bus_error import surviving_truncation
from robbie_mp.bus._hot import choice
from robbie_mp.bus.checkpoint.buffers import CheckpointBuffers
from robbie_mp.bus.checkpoint.file import checkpoint_file
from robbie_mp.bus.checkpoint.image import ImageLayout
from robbie_mp.bus.checkpoint.keeper import CheckpointKeeper, DiskPolicy
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.history import OwnHistory, record_nothing
from robbie_mp.bus.transport.layout import LINE_WORDS, HotPath
from robbie_mp.bus.transport.run_memory import IncarnationMemory, make_block_store, make_views
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.bus.transport.words import WORD_MAX, write_text
from robbie_mp.module.clock import Clock, SystemClock
from robbie_mp.module.handler_times import HandlerTimes, recorded_times
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.membership import Membership
from robbie_mp.module.module import Module, ModuleContext
from robbie_mp.module.recorded import RecordedClock
from robbie_mp.module.recorded_links import RecordedLinks
from robbie_mp.module.runner import ModuleRunner
from robbie_mp.module.setting_changes import SettingChanges, SettingsFile
from robbie_mp.module.settings import SettingError, check_settings
from robbie_mp.module.shared_memory_bus import SharedMemoryBus
from robbie_mp.module.ticks import MAX_RUN_CLOCK_WAIT_S, MAX_WAIT_S, GrantedTicks, Ticks, TimedTicks
from robbie_mp.module.wiring import Wiring
from robbie_mp.run.declared_types import DeclaredTypes
from robbie_mp.run.lockstep import ClockSource, Lockstep
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.check import load_class
from robbie_mp.run.profile.model import HANDLER_TIMES, MEASURED, ModuleSpec
from robbie_mp.run.run_clock import RunClock
from robbie_mp.run.supervisor.imported_files import report_imports
from robbie_mp.run.supervisor.own_history import begin_history, open_history, record_checkpoint
from robbie_mp.run.supervisor.scheduling import apply_scheduling, prefer_new_threads
from robbie_mp.run.variant import Variant, put_first, variant_of_environment


def run_module(run_folder: Path, plan: RunPlan, name: str, incarnation: int) -> None:
    """Import, construct and run a module until it is stopped or stops itself."""
    slot = plan.names.index(name)
    variant = variant_of_environment() or Variant()
    planned = variant.applied(plan.modules[slot - 1])
    native = choice.native()
    wiring = Wiring(planned.topics, planned.namespace)
    place = Membership(plan.run_id, slot, incarnation, plan.sizes, native, wiring)
    place.words[layout.OUT_HOT_PATH] = HotPath.PYTHON if native is None else HotPath.C
    sizes = planned.memory.segment_bytes, planned.memory.limit_bytes
    blocks = make_block_store(plan.run_id, slot, incarnation, *sizes, native)
    if (process_bytes := planned.memory.process_bytes) is not None:
        resource.setrlimit(resource.RLIMIT_AS, (process_bytes, process_bytes))
    module_class = import_class(plan, planned)
    history = open_history(plan.run_id, slot, incarnation, planned.memory.history_bytes, native)
    checkpoints = open_checkpoints(
        plan, place, slot, incarnation, history, is_fresh=variant.fresh_start == incarnation
    )
    clock = run_clock(plan, name, module_class, place.memory)
    settings_file = SettingsFile(run_folder, name)
    settings = read_settings(plan, planned, module_class, settings_file.start().values)
    module_clock: Clock = clock
    if history is not None:
        begin_history(history, plan, place, planned, settings, checkpoints)
        module_clock = RecordedClock(clock, history.append)
    bus = SharedMemoryBus(
        place,
        blocks,
        make_views(plan.run_id, native),
        module_clock,
        wiring,
        DeclaredTypes(run_folder, plan.types).declare,
    )
    if history is not None:
        bus.record_into(history)
    module = module_class(
        ModuleContext(
            name=name,
            settings=settings,
            bus=bus,
            clock=module_clock,
            checkpoints=checkpoints,
            output_directory=Path(plan.output_directory),
            show_status=line_writer(place, layout.OUT_STATUS),
            show_states=line_writer(place, layout.OUT_STATES),
            show_health=line_writer(place, layout.OUT_HEALTH),
            run_id=plan.run_id,
            wake=place.memory.wakeup.post,
        )
    )
    place.words[layout.OUT_TICKS_WAIT] = module.ticks_wait
    lockstep = None
    if isinstance(module, ClockSource) and plan.clock.lockstep and plan.clock.source == name:
        into = place.memory.into.words
        lockstep = Lockstep(plan.run_id, place.words, into, place.board, place.wake_core)
        module.lockstep = lockstep
    wakeup = place.memory.wakeup
    wakeup.spin_s = planned.scheduling.spin_us / 1e6
    wakeup.patience_s = 0.0 if plan.clock.lockstep else module.patience_s
    apply_scheduling(planned.scheduling, module.log, module.nice, module.slice_ms)
    record = record_nothing if history is None else history.append
    runner = ModuleRunner(
        module,
        place,
        bus.inbox,
        bus,
        make_ticks(plan, module, clock, place, bus.inbox, record),
        SettingChanges(module, bus, settings_file),
        None if lockstep is None else lockstep.has_just_settled,
        history,
    )
    signal.signal(signal.SIGTERM, lambda _signal, _frame: runner.request_stop())
    # Only this process handles SIGTERM that way; a process that it forks ends by it, as usual.
    os.register_at_fork(after_in_child=lambda: signal.signal(signal.SIGTERM, signal.SIG_DFL))
    gc.freeze()  # imported objects stay, so the collector need not scan them again
    with (
        using_links(device_links(history)),
        surviving_truncation(f"{SHARED_MEMORY / names.folder(plan.run_id)}/", writable=False),
    ):
        if plan.reloads:
            report_imports(run_folder, name, plan.workspace)
        runner.set_up()
        if plan.reloads:
            report_imports(run_folder, name, plan.workspace)  # those that it imports only there, too
        prefer_new_threads(planned.scheduling)
        runner.run()
    checkpoints.close()


def device_links(history: OwnHistory | None) -> Links:
    """Return what a module's drivers open their devices with."""
    return MachineLinks() if history is None else RecordedLinks(history.append)


def import_class(plan: RunPlan, planned: ModuleSpec) -> type[Module]:
    """Import a module's class from the workspace, or from the code that was swapped in for it."""
    sys.path.insert(0, plan.workspace)
    put_first(planned.code, planned.class_path)
    return load_class(planned.class_path, Module)


def make_ticks(
    plan: RunPlan,
    module: Module,
    clock: SystemClock | RunClock,
    place: Membership,
    inbox: Inbox,
    record: Callable[..., None],
) -> Ticks:
    """Make what decides when a module's ticks are due."""
    words = place.words
    if not isinstance(clock, RunClock):
        return TimedTicks(module, clock, words, MAX_WAIT_S, place.native)
    if plan.clock.lockstep:
        return GrantedTicks(module, words, inbox, clock.now_ns, charge_of(plan, module), record)
    return TimedTicks(module, clock, words, MAX_RUN_CLOCK_WAIT_S, place.native)


def line_writer(place: Membership, at: int) -> Callable[[str], None]:
    """Return a function that writes a status line into a module's memory, one thread at a time."""

    def write(line: str) -> None:
        with place.endpoint.lock:
            write_text(place.words, at, LINE_WORDS, line)

    return write


def run_clock(
    plan: RunPlan, name: str, module_class: type[Module], memory: IncarnationMemory
) -> SystemClock | RunClock:
    """Return the clock that a module uses; if that is the run's, wait until its time has begun."""
    if plan.clock.source in (None, name) or not module_class.follows_run_clock:
        return SystemClock()
    clock = RunClock.attach(plan.run_id)
    if not clock.has_begun:
        waits = f"waiting for {plan.clock.source} to set the run's time"
        write_text(memory.out.words, layout.OUT_STATUS, LINE_WORDS, waits)
    while not clock.has_begun:
        memory.wakeup.wait(MAX_RUN_CLOCK_WAIT_S)
    write_text(memory.out.words, layout.OUT_STATUS, LINE_WORDS, "")
    return clock


def charge_of(plan: RunPlan, module: Module) -> Callable[[int], int] | None:
    """Return what decides how long a module's handlers take by the run's clock; None: they take no time.

    Raises:
        HandlerTimesMissing: the profile names a folder that has none.
    """
    if not plan.clock.charge:
        return None
    recorded = None
    if plan.clock.charge != MEASURED:
        folder = Path(plan.workspace) / plan.clock.charge
        recorded = recorded_times(folder, module.name)
    file = Path(plan.output_directory) / HANDLER_TIMES / f"{module.name}.txt"
    return HandlerTimes(file, recorded, module.log).charge


def read_settings(
    plan: RunPlan, planned: ModuleSpec, module_class: type[Module], changed: dict[str, object]
) -> dict[str, object]:
    """Return a module's settings: those of the profile, with the changes made in this run."""
    workspace = Path(plan.workspace)
    try:
        given = {**planned.settings, **changed}
        return check_settings(module_class, given, folder=workspace, folder_of=planned.folder_of)
    except SettingError:
        if not changed:
            raise
        logging.getLogger(planned.name).exception(
            "the settings changed in this run are no longer valid; the profile's are used"
        )
    return check_settings(module_class, planned.settings, folder=workspace, folder_of=planned.folder_of)


def open_checkpoints(
    plan: RunPlan,
    place: Membership,
    slot: int,
    incarnation: int,
    history: OwnHistory | None,
    *,
    is_fresh: bool = False,
) -> CheckpointKeeper:
    """Find the checkpoint of an earlier incarnation or run, and prepare to write new ones.

    With `is_fresh`, one that is found is not used.
    """
    planned = plan.modules[slot - 1]
    disk = None
    if planned.checkpoint.persist:
        path = checkpoint_file(Path(plan.workspace), plan.profile_name, planned.name)
        disk = DiskPolicy(path, planned.checkpoint.persist_every_s)
    buffers = CheckpointBuffers(
        plan.run_id,
        slot,
        incarnation,
        planned.memory.checkpoint_bytes,
        is_expected=place.board.read(slot).past.checkpoints > 0,
    )
    words = place.words

    def count(image: ImageLayout) -> None:
        words[layout.OUT_CHECKPOINTS] = words[layout.OUT_CHECKPOINTS] + 1 & WORD_MAX
        if history is not None:
            record_checkpoint(history, image)

    return CheckpointKeeper(buffers, disk, logging.getLogger(planned.name), count, is_fresh=is_fresh)
