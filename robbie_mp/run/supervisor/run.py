"""One run of a profile, from the sweep of dead runs to the unlinking of the last name."""

import os
import secrets
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from robbie_mp.base.linux.bus_error import surviving_truncation
from robbie_mp.base.linux.private_files import make_private_folder, ownership_problem, write_private
from robbie_mp.base.linux.service_manager import VARIABLES as SERVICE_VARIABLES
from robbie_mp.base.linux.service_manager import ServiceManager
from robbie_mp.base.utc import file_stamp
from robbie_mp.bus._hot.choice import why_not
from robbie_mp.bus.observe import ModuleFigures, RunObserver
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.board import TOOL_PREFIX
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.bus.transport.words import check_machine
from robbie_mp.messages.descriptions import TypeDescription
from robbie_mp.run.exclusive_use import one_start_at_a_time, refuse_second_robot, refuse_taken_devices
from robbie_mp.run.plan import CORE, PLAN_FILE, RunPlan
from robbie_mp.run.profile.model import BLACK_BOX, Profile, Scheduling
from robbie_mp.run.profile.show import as_profile
from robbie_mp.run.run_directory import PROFILE_FILE, RunDirectory, UnsafeRunFolder
from robbie_mp.run.supervisor.attached_tools import AttachedTools
from robbie_mp.run.supervisor.capsules import Capsules
from robbie_mp.run.supervisor.child_spec import SPARE_COMPUTE_THREADS, ChildSpec
from robbie_mp.run.supervisor.connection_watch import ConnectionWatch
from robbie_mp.run.supervisor.control import ControlServer
from robbie_mp.run.supervisor.debugging import Debugging
from robbie_mp.run.supervisor.files_watch import FilesWatch
from robbie_mp.run.supervisor.health_watch import HealthWatch
from robbie_mp.run.supervisor.memory import SUPERVISOR, RunMemory
from robbie_mp.run.supervisor.output import Listener, OutputStore
from robbie_mp.run.supervisor.own_log import logging_to
from robbie_mp.run.supervisor.reload import Reloader
from robbie_mp.run.supervisor.scheduling import computing_with
from robbie_mp.run.supervisor.spares import SpareCommand
from robbie_mp.run.supervisor.states import StateChange
from robbie_mp.run.supervisor.sweep import sweep
from robbie_mp.run.supervisor.tree import Tree
from robbie_mp.run.trace.disk_writer import DiskWriter
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.trace.reader import LOG_FOLDER

SUMMARY_FILE = "summary.json"
DEGRADED = 3
"""The exit code of a run that ended in order, but with a module that was DEGRADED."""


@dataclass(frozen=True)
class RunListener:
    """Callbacks for the caller of a run; each must return quickly."""

    entry: Listener = lambda _entry: None
    change: Callable[[StateChange], None] = lambda _change: None
    begin: Callable[[str], None] = lambda _run_id: None
    """Called once, when a `RunObserver` can open the run's memory."""
    end: Callable[[str, Path], None] = lambda _run_id, _folder: None
    """Called once with the folder of the run, when all processes have ended but its memory is still there."""


@dataclass(frozen=True)
class RunResult:
    """How a run ended."""

    exit_code: int
    reason: str
    figures: list[ModuleFigures]
    """Of supervisor, modules and core, at the end."""
    entries: dict[str, int]
    """Number of trace entries of each child, by name."""
    entries_dropped: dict[str, int]
    """Number of entries dropped, likewise."""
    output_directory: Path
    degraded: dict[str, str] = field(default_factory=dict)
    """Why modules were DEGRADED when the run began to stop, by name: those that had been for a while."""
    unwritten: int = 0
    """Orders to write trace or summary that a stalled disk had not accepted at the end."""
    refused: int = 0
    """Those that the disk refused, for example because it is full."""
    refusal: str = ""
    """Why it refused the last one."""


def run_profile(
    profile: Profile,
    settings: Mapping[str, dict[str, object]],
    types: Iterable[TypeDescription],
    output_directory: Path,
    listener: RunListener,
    summarize: Callable[[RunResult], str] = lambda _result: "",
    *,
    is_robot: bool = False,
    another: bool = False,
    reloads: bool = False,
) -> RunResult:
    """Run a profile to its end.

    Args:
        profile: what to run.
        settings: the checked and complete settings of each module that could be imported.
        types: the robot's own message types, for tools that attach to the run.
        output_directory: where modules write their results; the children's logs go to its folder `log`.
        listener: called with what happens.
        summarize: returns the content of `SUMMARY_FILE` in the output directory; '': no such file.
        is_robot: whether this is the robot of its workspace.
        another: whether it may run beside another robot of its workspace.
        reloads: whether modules are restarted when their source files are saved.

    Raises:
        RobotRunsAlready: the robot of this workspace runs already.
        DeviceTaken: a live run uses a device that this one names.
        SharedMemoryFull: there is no room for the run's tables.
        UnsafeRunFolder: the folder for runs, or the one for results, is not safe.
        LogNotWritable: the folder for logs cannot be used.
        UnsuitableMachine: this Python has no words of 64 bits.
    """
    check_machine()
    sweep()
    complete = replace(
        profile,
        modules=tuple(
            replace(spec, settings=settings.get(spec.name, spec.settings)) for spec in profile.modules
        ),
    )
    with ExitStack() as stack:
        starting = stack.enter_context(ExitStack())
        starting.enter_context(one_start_at_a_time())
        if is_robot and not another:
            refuse_second_robot(profile.workspace)
        refuse_taken_devices(complete.modules)
        output_directory = _results_folder(output_directory)
        directory = RunDirectory.create(
            profile.name, output_directory, workspace=profile.workspace, is_robot=is_robot
        )
        connections = stack.enter_context(
            ExitStack()
        )  # clients that wait for the end of the run: closed after it
        disk = stack.enter_context(DiskWriter(profile.trace.waiting_bytes))
        stack.callback(directory.remove, disk)
        plan = RunPlan.of_profile(
            complete,
            directory.run_id,
            profile.workspace,
            output_directory,
            os.getpid(),
            types,
            reloads=reloads,
        )
        plan.save(directory.folder)
        starting.close()
        write_private(directory.folder / PROFILE_FILE, as_profile(profile, settings))
        result = _run(plan, profile, directory.folder, listener, connections, disk)
        if summary := summarize(result):
            disk.order(["replace", str(output_directory / SUMMARY_FILE)], summary.encode())
    code = result.exit_code or (DEGRADED if disk.refused else 0)
    return replace(
        result, exit_code=code, unwritten=disk.unfinished, refused=disk.refused, refusal=disk.refusal
    )


def _results_folder(folder: Path) -> Path:
    """Make the folder for results, and return its path without links.

    Raises:
        UnsafeRunFolder: others can write to it, and could have put links there; or it is a link of theirs.
    """
    problem = ""
    if folder.is_symlink() and folder.lstat().st_uid not in (0, os.geteuid()):
        problem = f"is a link that belongs to user {folder.lstat().st_uid}"
    else:
        folder = folder.resolve()
        make_private_folder(folder)
        problem = ownership_problem(folder.stat(), folder=True, readable=True)
    if problem:
        raise UnsafeRunFolder(
            f"the folder for results, {folder}, {problem}; choose another one with --output"
        )
    return folder


def _run(
    plan: RunPlan,
    profile: Profile,
    run_folder: Path,
    listener: RunListener,
    connections: ExitStack,
    disk: DiskWriter,
) -> RunResult:
    output_directory = Path(plan.output_directory)
    memory = RunMemory(plan, listener.change)
    observer = RunObserver(plan.run_id)
    figures: list[ModuleFigures] = []

    def at_the_end() -> None:
        figures.extend(_without_tools(observer.modules()))
        listener.end(plan.run_id, run_folder)

    memory.before_close = at_the_end
    service = ServiceManager.of_environment()
    connections.callback(service.close)
    environment = {
        **{name: value for name, value in os.environ.items() if name not in SERVICE_VARIABLES},
        "PYTHONUNBUFFERED": "1",
    }  # otherwise the last output of a crashed child is lost
    # Sets of strings have the same order in each process, and when a crash is replayed.
    hash_seed = 0 if profile.clock.lockstep else secrets.randbits(32)
    environment.setdefault("PYTHONHASHSEED", str(hash_seed))
    if plan.reloads:
        environment["PYTHONDONTWRITEBYTECODE"] = "1"  # two saves in a second may look the same there
    try:
        tree = Tree(
            _children(profile, run_folder, environment),
            plan.run_id,
            memory,
            OutputStore(output_directory / LOG_FOLDER, listener.entry, profile.trace, disk),
            lambda: _each_turn(
                tree, memory, control, tools, debugging, watch, health, files, service, capsules, reloader
            ),
            spares=_spares(profile, run_folder, environment),
        )
        capsules = memory.capsules = Capsules(
            plan, profile.trace.capsules, lambda name, kind, text: tree.child(name).output.say(kind, text)
        )
        tree.helper_pids = lambda: capsules.pids
        tree.before_output_ends = capsules.close
        watch = ConnectionWatch(
            observer, tree.say, {module.name: list(module.topics) for module in plan.modules}
        )
        health = HealthWatch(
            observer,
            lambda name, text: tree.child(name).output.say(Kind.WARNING, text),
            memory.show_health,
            [module.name for module in plan.modules],
        )
        plan_file = str(run_folder / PLAN_FILE)
        files = FilesWatch(lambda: {plan_file: None, **memory.files()}, memory.data_files)
        tools = AttachedTools(tree, memory, plan.tool_names)
        debugging = Debugging(tree)
        control = ControlServer(run_folder, tree, tools=tools, debugging=debugging)
        connections.callback(control.close)
        connections.callback(tools.close)
        connections.callback(debugging.close)
        reloader = Reloader(run_folder, profile.workspace, plan.modules, tree) if plan.reloads else None
        if reloader is not None:
            connections.callback(reloader.close)
        listener.begin(plan.run_id)
        _say_hot_path(tree)
    except BaseException:
        memory.close()
        raise
    try:
        with surviving_truncation(f"{SHARED_MEMORY / names.folder(plan.run_id)}/"), logging_to(tree.say):
            exit_code = tree.run()
    finally:
        observer.close()
    outputs = {child.spec.name: child.output for child in tree.children}
    return RunResult(
        exit_code=exit_code or (DEGRADED if disk.refused or set(health.lasting) - {BLACK_BOX} else 0),
        reason=tree.stop_reason,
        figures=figures,
        entries={name: output.lines for name, output in outputs.items()},
        entries_dropped={name: output.dropped for name, output in outputs.items()},
        output_directory=output_directory,
        degraded=health.lasting,
    )


def _say_hot_path(tree: Tree) -> None:
    """Say once in each run which form of the hot path its processes will choose."""
    if reason := why_not():
        tree.say(Kind.WARNING, f"the hot path runs in Python, which is slower: {reason}")
    else:
        tree.say(Kind.SYSTEM, "the hot path runs in C")


def _without_tools(figures: Sequence[ModuleFigures]) -> list[ModuleFigures]:
    """Return the figures without those of attached tools, which are no part of the run."""
    return [entry for entry in figures if not entry.name.startswith(TOOL_PREFIX)]


def _each_turn(
    tree: Tree,
    memory: RunMemory,
    control: ControlServer,
    tools: AttachedTools,
    debugging: Debugging,
    watch: ConnectionWatch,
    health: HealthWatch,
    files: FilesWatch,
    service: ServiceManager,
    capsules: Capsules,
    reloader: Reloader | None,
) -> None:
    memory.beat()
    if not tree.stop_reason:
        health.turn()
    service.turn(is_ready=tree.has_started, status=health.summary, stop_reason=tree.stop_reason)
    for path, what, owner in files.look():
        if owner is None:
            tree.stop(f"{path} was {what}, and no process can start without it", has_failed=True)
            break  # all end in order
        _kill(tree, tools, *owner, f"its shared memory {path} was {what}")
    memory.read_notices()
    while memory.faulted:
        name, incarnation = memory.faulted.pop()
        if name == SUPERVISOR:
            # No module could be restarted. A new core recovers, or fails repeatedly and thereby ends the run.
            tree.child(CORE).kill("it refused the supervisor's own records; core.log says why")
            continue
        _kill(tree, tools, name, incarnation, "the core refused its records; core.log says why")
    control.turn()
    tools.turn()
    debugging.turn()
    watch.turn()
    capsules.turn()
    if reloader is not None:
        reloader.turn()


def _kill(tree: Tree, tools: AttachedTools, name: str, incarnation: int, why: str) -> None:
    """Kill a module, or detach a tool, unless it has ended since."""
    if tools.fault(name, incarnation, why):
        return
    child = tree.child(name)
    if child.incarnation == incarnation:
        child.kill(why)


def _children(profile: Profile, run_folder: Path, environment: Mapping[str, str]) -> list[ChildSpec]:
    """Describe the processes of a run: the core, then the modules in the profile's order."""

    def command(name: str) -> tuple[str, ...]:
        return (sys.executable, "-m", "robbie_mp.run.supervisor.child", str(run_folder), name)

    def environment_of(scheduling: Scheduling) -> dict[str, str]:
        return computing_with(environment, scheduling.compute_threads)

    core = ChildSpec.of_core(profile.core, command("core"), environment_of(profile.core.scheduling))
    record = profile.trace.record
    return [
        core,
        *(
            ChildSpec.of_module(spec, command(spec.name), environment_of(spec.scheduling), record)
            for spec in profile.modules
        ),
    ]


def _spares(profile: Profile, run_folder: Path, environment: Mapping[str, str]) -> SpareCommand:
    argv = (sys.executable, "-m", "robbie_mp.run.supervisor.spare", str(run_folder))
    return SpareCommand(profile.spares.count, argv, computing_with(environment, SPARE_COMPUTE_THREADS))


def default_output_directory(profile_name: str) -> Path:
    """Return the default folder for a run's results, a new one for each run."""
    return Path("output") / profile_name / f"{file_stamp()}-{os.getpid()}"
