"""`robbie shadow MODULE --with PATH [--log RECORDING]`: run other code beside a module, and compare."""

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from rich.text import Text

from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.base.problem import refuse
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.transport.histogram import Distribution
from robbie_mp.cli import completers
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.output import console
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.program import signals_noted
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.cli.variants import add_variant_arguments, checked, planned_module, variant_of
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.logs.shadow.comparison import ShadowReport
from robbie_mp.logs.shadow.of_log import recorded_module, shadow_of_log
from robbie_mp.logs.shadow.of_run import ShadowOfRun, begin_of
from robbie_mp.logs.shadow.pairing import WAIT_S, ChannelResult, Side
from robbie_mp.run.control import RunNotControlled
from robbie_mp.run.exclusive_use import named_devices
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.model import ModuleSpec
from robbie_mp.run.profile.workspace import enclosing_workspace
from robbie_mp.run.variant import Variant

DIFFERENT = 1
MOST_AMOUNTS = 5
"""Fields of one channel that are listed."""


def add_parser(subparsers: Commands) -> None:
    """Add `shadow` to the commands."""
    parser = add_command(
        subparsers,
        "shadow",
        "run other code beside a module, and compare",
        "Run a module a second time, with other code or settings, with the messages that the module gets, "
        "until Ctrl-C. What it publishes goes nowhere, but is compared with what the module publishes, apart "
        "from the stamps in headers. Its publications and answers reach nobody. Its Python code is kept "
        "from devices, foreign files and the network; C code that it loads is not. Messages that come too "
        "fast for it are dropped and counted. With a recording, it gets the messages "
        "in that, as fast as it goes. Exit code 0: both publish the same; 1: they do not, or the shadow "
        "died; 2: its code or settings are wrong.",
        [
            "robbie shadow mapping --with ~/fixed",
            "robbie shadow mapping --set resolution_m=0.1 --for 10s --json",
            "robbie shadow mapping --with ~/fixed/mapping.py --log recording",
        ],
    )
    name = parser.add_argument("module", help="name of the module")
    name.completer = completers.modules  # type: ignore[attr-defined]
    log = parser.add_argument(
        "--log", metavar="RECORDING", type=Path, help="take the messages of this recording instead of a run's"
    )
    log.completer = completers.logs  # type: ignore[attr-defined]
    add_variant_arguments(parser)
    parser.add_argument("--fresh", action="store_true", help="begin without the module's checkpoint")
    parser.add_argument(
        "--for", dest="duration", metavar="TIME", type=time_between(0), help="end after this time"
    )
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    add_run_argument(parser)
    parser.set_defaults(command=shadow)


def shadow(arguments: argparse.Namespace) -> int:
    """Run the shadow, and print what it has shown."""
    variant = variant_of(arguments)
    with signals_noted() as stopped:
        until_s = math.inf

        def begin() -> None:
            nonlocal until_s
            until_s = time.monotonic() + (math.inf if arguments.duration is None else arguments.duration)
            print(f"(the shadow of {arguments.module} runs; Ctrl-C ends it)", file=sys.stderr)

        def is_over() -> bool:
            return bool(stopped) or time.monotonic() > until_s

        run = _of_run if arguments.log is None else _of_log
        report = run(arguments, variant, is_over, begin)
    if arguments.json:
        print(json.dumps(report.as_data(), indent=2))
    else:
        _print(report)
    return 0 if report.is_equal else DIFFERENT


def _of_run(
    arguments: argparse.Namespace, variant: Variant, is_over: Callable[[], bool], begin: Callable[[], None]
) -> ShadowReport:
    run = choose_run(arguments.run)
    try:
        plan = RunPlan.load(run.folder)
    except FileNotFoundError:
        raise RunNotControlled(f"run {run.run_id} is just starting, or has ended") from None
    spec = variant.applied(planned_module(plan, arguments.module))
    others = [one for one in plan.modules if one.name != spec.name]
    spec = checked(spec, others, Path(plan.workspace))
    _refuse_devices(spec)
    return ShadowOfRun(run, spec, is_fresh=arguments.fresh).watch(is_over, begin)


def _of_log(
    arguments: argparse.Namespace, variant: Variant, is_over: Callable[[], bool], begin: Callable[[], None]
) -> ShadowReport:
    workspace = enclosing_workspace(Path.cwd()) or Path.cwd()
    with closing(open_log(arguments.log)) as log:
        spec = checked(variant.applied(recorded_module(log, arguments.module)), [], workspace)
        begin()
        return shadow_of_log(log, begin_of(spec, str(workspace)), is_over)


def _refuse_devices(spec: ModuleSpec) -> None:
    for setting, device in named_devices([replace(spec, code="")]):
        raise refuse(f"{setting} is {device}: a shadow must not open a device that the module itself uses")


def _print(report: ShadowReport) -> None:
    table = PlainTable()
    for heading, left_out in (("topic", 0), ("type", 1)):
        table.add_column(heading, left_out=left_out, shrinks=True, no_wrap=True)
    for heading in ("equal", "different", "only module", "only shadow"):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in report.channels:
        bad = (one.different, one.only[Side.MODULE], one.only[Side.SHADOW])
        table.add_row(
            one.name.topic,
            one.name.type_name,
            str(one.equal),
            *(Text(str(count), "bold red" if count else "") for count in bad),
        )
    console().print(table)
    for one in report.channels:
        _print_differences(one)
        if one.is_unseen:
            what = one.name.topic or one.name.type_name
            print(one_line(f"{what}: nothing was compared; that takes more than {2 * WAIT_S:g} s"))
    for who, times in (("module", report.module_times), ("shadow", report.shadow_times)):
        if times is not None and times.count:
            print(f"time for a message, {who}: {_times(times)}")
    print(_counts(report))
    if report.end:
        print(one_line(f"the shadow has ended: {report.end}"))
    elif not report.handled:
        print("nothing was compared: the shadow has handled no message; it may need more time (--for)")
    elif report.is_equal:
        print(f"equal: {sum(one.equal for one in report.channels)} messages")


def _print_differences(one: ChannelResult) -> None:
    what = one.name.topic or one.name.type_name
    if first := one.first:
        text = f"{what}: pair {first.index}: {first.field}: {first.a} in the module, {first.b} in the shadow"
        print(one_line(text))
    ordered = sorted(one.amounts.items(), key=lambda entry: -entry[1].messages)
    for name, amount in ordered[:MOST_AMOUNTS]:
        print(
            one_line(
                f"{what}: {name} differs in {amount.messages}, by {amount.mean:.3g} on average, "
                f"at most {amount.largest:.3g}"
            )
        )


def _times(times: Distribution) -> str:
    parts = (("median", times.p50_s), ("p99", times.p99_s), ("longest", times.max_s))
    return ", ".join(f"{name} {value * 1e3:.3g} ms" for name, value in parts if value is not None)


def _counts(report: ShadowReport) -> str:
    parts = [f"messages: {report.handled} handled, {report.lost} lost"]
    if report.replaced:
        parts.append(f"{report.replaced} replaced by newer ones")
    if report.unhandled:
        parts.append(f"{report.unhandled} not handled at the end")
    if report.calls:
        parts.append(f"{report.calls} calls that nobody answered")
    return ", ".join(parts)
