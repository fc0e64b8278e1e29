"""`robbie module start|stop|restart|swap NAME`: start, stop and exchange single modules of a run."""

import argparse
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

from robbie_mp.base.problem import refuse
from robbie_mp.bus.observe import RunObserver
from robbie_mp.cli import completers
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.cli.variants import add_variant_arguments, checked_variant, variant_of
from robbie_mp.run.control import RunNotControlled, control
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.dependencies import with_dependents
from robbie_mp.run.profile.model import Profile
from robbie_mp.run.profile.preflight import preflight, runnable
from robbie_mp.run.variant import TRIAL_S, Variant

DESCRIPTIONS = {
    "restart": "Stop a module in order if it runs, start it again with its full restart budget, and wait "
    "until it is RUNNING. The module may also be FAILED or STOPPED. Modules that depend on it restart with "
    "it. Their classes are checked first as before a run. Exit code 0: it is RUNNING; 1: it is not; 2: its "
    "code or settings are wrong, and it was left as it was.",
    "stop": "Stop a module in order, and wait until it has ended. It stays STOPPED until you start it.",
    "start": "Start a module that is STOPPED or FAILED with its full restart budget, and wait until it is "
    "RUNNING. Its class is checked first as before a run. Exit code 0: it is RUNNING; 1: it is not; 2: its "
    "code or settings are wrong, and it was left as it was.",
}


def add_parser(subparsers: Commands) -> None:
    """Add `module` to the commands."""
    parser = subparsers.add_parser("module", help="start, stop or restart one module of a run")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    for action, description in DESCRIPTIONS.items():
        command = add_command(
            actions, action, f"{action} one module", description, [f"robbie module {action} laser"]
        )
        name = command.add_argument("module", help="name of the module" + ", or core" * (action == "restart"))
        name.completer = completers.modules  # type: ignore[attr-defined]
        add_run_argument(command)
        command.set_defaults(command=tell, action=action)
    _add_swap(actions)


def _add_swap(actions: Commands) -> None:
    command = add_command(
        actions,
        "swap",
        "exchange the code or the settings of one module",
        "Restart a module with other code, another class or other settings, for the rest of the run. "
        "Messages wait for it meanwhile, and its last checkpoint is handed over. The code is checked first "
        f"as before a run. If it does not come up, or ends within {TRIAL_S:g} s, what ran before is put "
        "back. Exit code 0: it runs; 1: it does not; 2: its code or settings are wrong, and it was left "
        "as it was.",
        [
            "robbie module swap mapping --with ~/fixed",
            "robbie module swap mapping --with ~/fixed/mapping.py --set resolution_m=0.1",
            "robbie module swap mapping --class mapping_2:Mapping --fresh",
            "robbie module swap mapping --back",
        ],
    )
    name = command.add_argument("module", help="name of the module")
    name.completer = completers.modules  # type: ignore[attr-defined]
    add_variant_arguments(command)
    command.add_argument("--back", action="store_true", help="run what the profile says again")
    command.add_argument("--fresh", action="store_true", help="start without the checkpoint")
    add_run_argument(command)
    command.set_defaults(command=swap)


def swap(arguments: argparse.Namespace) -> int:
    """Exchange a module's code or settings, and say what became of its messages."""
    run, name = choose_run(arguments.run), arguments.module
    variant = variant_of(arguments)
    if arguments.back == (variant != Variant()):
        raise refuse("name other code or settings with --with, --class or --set; or else --back")
    try:
        checked_variant(RunPlan.load(run.folder), name, variant)
    except FileNotFoundError:
        raise RunNotControlled(f"run {run.run_id} is just starting, or has ended") from None
    with closing(RunObserver(run.run_id)) as observer:
        before = _missed(observer, name)
        fields = {"variant": asdict(variant), "fresh": arguments.fresh}
        done = control(run.folder, "swap", name, **fields)
        missed = _missed(observer, name) - before
    print(done)
    print(f"messages that it missed meanwhile: {missed or 'none'}")
    return 0


def _missed(observer: RunObserver, name: str) -> int:
    """Return how many messages for a module were lost in crashes, or dropped because it was too slow."""
    figures = next(one for one in observer.modules() if one.name == name)
    return sum(one.lost + one.overflowed for one in figures.subscriptions)


def tell(arguments: argparse.Namespace) -> int:
    """Send the supervisor a command for a module."""
    folder = choose_run(arguments.run).folder
    if arguments.action != "stop":
        _check(folder, arguments.module)
    print(control(folder, arguments.action, arguments.module))
    return 0


def _check(folder: Path, name: str) -> None:
    """Check a module and those that restart with it as before a run: a mistake must not stop what runs well.

    Args:
        folder: the run's folder.
        name: the module; the supervisor says if there is none.

    Raises:
        ProfileError: the code or the settings of one of them are wrong, or it cannot import something.
    """
    try:
        plan = RunPlan.load(folder)
    except FileNotFoundError:  # the run is starting or ending, and takes no commands
        return
    started = with_dependents(name, {spec.name: spec.depends_on for spec in plan.modules})
    # One that was optional when the run started takes part in it now.
    modules = tuple(replace(spec, optional=False) for spec in plan.modules)
    profile = Profile(plan.profile_name, modules, workspace=Path(plan.workspace))
    runnable(profile, preflight(profile, only=started))
